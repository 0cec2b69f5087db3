"""Monitors of a scene during a run: the position of its glass, and motion of a sphere.

Rims: where the glass stands by its rims, beside where the scene has it, looked for in the last frame.  It takes a
second of a core.  Only frames in which the plane is seen through the glass are looked at (`words["rims"]`); with a
board in them the camera's place is found as well (``correction.alignment``).

Spheres: whether one has moved since it was calibrated, from particles of the flow that are seen twice.  Frames
of one pulse are looked at, so that what stands still in them is alike; the last ones count together
(``correction.self_check``).
"""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from correction.alignment.seen import Arrangement, Expected, find_arrangement
from correction.errors import CorrectionError
from correction.self_check.moved_sphere import RunningCheck
from correction.target import Chessboard
from daq.live.monitor import Monitor
from daq.pipeline.live_slot import SlotReader, Snapshot
from ground.config import Document, validate
from ground.errors import GroundError
from piv.errors import PivError
from tracer.board import Codes, Dots
from tracer.errors import SceneError
from tracer.scene.scene import Scene
from tracer.scene.scene_file import scene_from
from tracer.scene.scene_tables import SceneTable

RIMS_EVERY_S = 4.0
RIMS_OFF_MM, RIMS_SURE = (
    0.05,
    3.0,
)  # beside its place by more than this, and more standard deviations than that: said in red
HERE = Expected(np.zeros(3), np.zeros(3), np.zeros(3))


class RimMonitor(Monitor):
    """Looks for the rims of a scene.

    Parameters
    ----------
    slot : SlotReader
        Where frames are shown.
    scene : Scene
        Where the glass is believed to stand.
    board : Chessboard
        Object in the plane when a frame shows a chessboard.
    """

    def __init__(self, slot: SlotReader, scene: Scene, board: Chessboard) -> None:
        super().__init__(slot, RIMS_EVERY_S)
        self._scene, self._board = scene, board

    def see(self, snapshot: Snapshot) -> None:
        """Look for the rims, if the frame may show them where they are believed."""
        if not snapshot.words.get("rims"):
            return
        board = self._board if snapshot.words.get("shows") == "chessboard" else None
        try:
            self.said = in_words(find_arrangement(snapshot.pictures["raw"], self._scene, board, HERE))
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
    return [f"{x:+.2f}, {y:+.2f} mm, \u00b1 {sigma:.1g}", off > max(RIMS_OFF_MM, RIMS_SURE * sigma)]


MOVED_EVERY_S = 1.0


class SphereMonitor(Monitor):
    """Asks particles of a flow whether the spheres stand where the scene has them.

    Parameters
    ----------
    slot : SlotReader
        Where frames are shown.
    scene : Scene
        Fitted.
    """

    def __init__(self, slot: SlotReader, scene: Scene) -> None:
        super().__init__(slot, MOVED_EVERY_S)
        self._scene = scene
        self._check: RunningCheck | None = None
        self._can_tell = True

    def see(self, snapshot: Snapshot) -> None:
        """Take a frame of the first pulse, if it shows a flow behind the glass."""
        words = snapshot.words
        if not self._can_tell or words.get("shows") != "flow" or words.get("pulse") != 0 or not words.get("rims"):
            return
        try:
            self._check = self._check or RunningCheck(self._scene)
            self._check.add(np.asarray(snapshot.pictures["raw"], np.float32))
            found = self._check.found
        except (CorrectionError, PivError, SceneError) as error:
            self._can_tell, self.said = False, {"spheres": [str(error).split(";")[0], False]}
            return
        self.said = {"spheres": [found.sentence, bool(found.likely_moves)]}


def scene_told(text: str) -> Scene | None:
    """Scene of a scene file's text; None if it cannot be read here."""
    try:
        document = Document(Path("scene.yaml"), yaml.safe_load(text))
        return scene_from(document, validate(document, SceneTable))
    except (GroundError, SceneError, OSError):
        return None


def board_told(tree: dict[str, Any]) -> Chessboard:
    """Board of what JSON makes of its `asdict`: tuples come as lists."""

    def of_tuples(value: Any) -> Any:  # noqa: ANN401 - whatever a board holds
        return tuple(map(of_tuples, value)) if isinstance(value, list) else value

    words = {name: of_tuples(value) for name, value in tree.items()}
    parts = {name: tree[name] and kind(**tree[name]) for name, kind in (("codes", Codes), ("dots", Dots))}
    return Chessboard(**words | parts)


def begin(slot: SlotReader, scene: Scene, board: Chessboard) -> tuple[Monitor, ...]:
    """Begin to watch the balls of a scene; nothing if it has none."""
    if not scene.spheres:
        return ()
    monitors = RimMonitor(slot, scene, board), SphereMonitor(slot, scene)
    for monitor in monitors:
        monitor.start()
    return monitors
