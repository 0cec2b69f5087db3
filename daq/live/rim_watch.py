"""Where the glass stands by its rims, beside where the scene has it: looked for in the last frame, now and then.

It takes a second of a core.  Only frames in which the plane is seen through the glass are looked at
(`words["rims"]`); with a board in them the camera's place is found as well (``correction.alignment``).
"""

from typing import Any

import numpy as np

from correction.alignment.seen import Arrangement, Expected, find_arrangement
from correction.errors import CorrectionError
from correction.target import Chessboard
from daq.live.watch import Watch
from daq.pipeline.live_slot import Moment, SlotReader
from piv.errors import PivError
from tracer.errors import SceneError
from tracer.scene.scene import Scene

EVERY_S = 4.0
OFF_MM, SURE = 0.05, 3.0  # beside its place by more than this, and more standard deviations than that: said in red
HERE = Expected(np.zeros(3), np.zeros(3), np.zeros(3))


class RimWatch(Watch):
    """Looks for the rims of a scene.

    Parameters
    ----------
    slot : SlotReader
        Where frames are shown.
    scene : Scene
        Where the glass is believed to stand.
    board : Chessboard
        What hangs on the plane when a frame shows a chessboard.
    """

    def __init__(self, slot: SlotReader, scene: Scene, board: Chessboard) -> None:
        super().__init__(slot, EVERY_S)
        self._scene, self._board = scene, board

    def see(self, moment: Moment) -> None:
        """Look for the rims, if the frame may show them where they are believed."""
        if not moment.words.get("rims"):
            return
        board = self._board if moment.words.get("shows") == "chessboard" else None
        try:
            self.said = in_words(find_arrangement(moment.pictures["raw"], self._scene, board, HERE))
        except (CorrectionError, PivError, SceneError) as error:
            self.said = {"rims": [str(error).split(";")[0], False]}  # what to do about it has no room here


def in_words(seen: Arrangement) -> dict[str, list[Any]]:
    """Counters for the page; without a board the camera is believed, and glass is off its outline only."""
    knows = seen.camera_mm is not None
    rows = {f"glass beside its {'place' if knows else 'outline'}": _row(seen.glass_mm, seen.sigma_mm)}
    if seen.camera_mm is not None and seen.camera_sigma_mm is not None:
        rows["camera beside its place"] = _row(seen.camera_mm, seen.camera_sigma_mm)
    for number, remark in enumerate(seen.remarks, start=1):
        rows[f"to be seen, {number}"] = [remark, False]
    return rows


def _row(off_mm: Any, sigma_mm: Any) -> list[Any]:  # noqa: ANN401 - three numbers each
    (x, y, _), (sx, sy, _) = np.asarray(off_mm).tolist(), np.asarray(sigma_mm).tolist()
    off, sigma = float(np.hypot(x, y)), max(sx, sy)
    return [f"{x:+.2f}, {y:+.2f} mm, \u00b1 {sigma:.1g}", off > max(OFF_MM, SURE * sigma)]
