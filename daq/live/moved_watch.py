"""Whether a sphere has moved since it was calibrated, told by particles of the flow that are seen twice.

Frames of one pulse are looked at, so that what stands still in them is alike; the last ones count together
(``correction.self_check``).
"""

import numpy as np

from correction.errors import CorrectionError
from correction.self_check.moved_sphere import RunningCheck
from daq.live.watch import Watch
from daq.pipeline.live_slot import Moment, SlotReader
from piv.errors import PivError
from tracer.errors import SceneError
from tracer.scene.scene import Scene

EVERY_S = 1.0


class MovedWatch(Watch):
    """Asks particles of a flow whether the spheres stand where the scene has them.

    Parameters
    ----------
    slot : SlotReader
        Where frames are shown.
    scene : Scene
        Fitted.
    """

    def __init__(self, slot: SlotReader, scene: Scene) -> None:
        super().__init__(slot, EVERY_S)
        self._scene = scene
        self._check: RunningCheck | None = None
        self._can_tell = True

    def see(self, moment: Moment) -> None:
        """Take a frame of the first pulse, if it shows a flow behind the glass."""
        words = moment.words
        if not self._can_tell or words.get("shows") != "flow" or words.get("pulse") != 0 or not words.get("rims"):
            return
        try:
            self._check = self._check or RunningCheck(self._scene)
            self._check.add(np.asarray(moment.pictures["raw"], np.float32))
            found = self._check.found
        except (CorrectionError, PivError, SceneError) as error:
            self._can_tell, self.said = False, {"spheres": [str(error).split(";")[0], False]}
            return
        self.said = {"spheres": [found.sentence, bool(found.moved)]}
