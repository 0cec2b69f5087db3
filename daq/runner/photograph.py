"""One look of a bench that is open in a person's or a script's hands.

with open_session("bench.yaml", home=True) as bench:
    bench.move(target_z=-5.0)
    pixels = photograph(bench)
"""

from typing import cast

import numpy as np
from numpy.typing import NDArray

from daq.bench.bench_session import BenchSession
from daq.bench.elements import CAMERA
from daq.cameras.camera import Camera
from daq.errors import RunUsageError
from daq.runner.camera_session import CameraSession


def photograph(bench: BenchSession, camera: str = CAMERA) -> NDArray[np.uint16]:
    """Take one frame with the settings of the bench file; nothing moves.

    Parameters
    ----------
    bench : BenchSession
        Open.
    camera : str
        Name of the camera, if the bench has several.

    Returns
    -------
    NDArray
        Pixels (H, W) uint16.

    Raises
    ------
    RunUsageError
        There is no such camera, or it waits for a signal that does not come.
    CameraError
        It is not there, or gives no frame.
    MotionStopped
        A stop holds the bench.
    """
    device = bench.device(camera)
    if not hasattr(device, "next_frame"):
        raise RunUsageError(f"{camera} takes no frames; name a camera of the bench")
    section = bench.camera_section(camera)
    exposures = CameraSession(cast("Camera", device), section, bench.stage.latch, rendering_s=bench.rendering_s)
    exposures.set_up()
    try:
        for _, frame in exposures.frames(1):
            with frame:
                pixels = frame.pixels.copy()
    finally:
        exposures.end()
    return pixels
