"""The camera of a run: two ways of taking frames, told apart by the camera's settings.

* **software** (single_frames): one trigger, one frame, nothing in between.  A frame that does not arrive whole is
  taken again, a few times.
* **stream** (streaming): the camera, or an outer clock, decides; it is armed for the step only, and frames keep
  the place that their id gives them.

Both hand over only frames that were exposed when they should have been (trigger_match), in the format that was
set (frame_format); what they ask of the camera is in armed_camera.
"""

from collections.abc import Generator

from daq.cameras.frame import Frame
from daq.runner.armed_camera import ArmedCamera
from daq.runner.single_frames import single_frames
from daq.runner.streaming import stream


class Exposures(ArmedCamera):
    """The camera of a run, and its frames one after the other."""

    def frames(self, count: int, begin: int = 0, may_lose: int = 0) -> Generator[tuple[int, Frame], None, None]:
        """Yield (place in the step, frame), in rising order.

        Parameters
        ----------
        count : int
            Places of the step.
        begin : int
            First place that is to be filled.
        may_lose : int
            Places that may stay empty where frames come by themselves.

        Raises
        ------
        FramesLost
            A frame could not be had, or a stream has more gaps than it may.
        FrameDoubt
            A frame came, and nothing tells which trigger it answers.
        CameraTimeout
            A stream has ended before its time.
        CameraLost
            The camera is gone; see `reopen`.
        MotionStopped
            The bench was stopped.
        """
        self.begin()
        places = range(begin, count)
        return single_frames(self, places) if self.software else stream(self, places, may_lose)
