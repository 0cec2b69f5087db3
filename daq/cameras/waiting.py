"""Waiting for a frame, the same for every backend: first for the frame, then for a sign of life."""

import time
from contextlib import suppress

from daq.cameras.camera import Camera
from daq.cameras.frame import Frame
from daq.errors import CameraTimeout, FrameIncomplete

PROBE_MIN_S = 0.5


def probe_s(timeout_s: float) -> float:
    """How long a camera may take to answer after a frame did not come; a wait lasts half as long again at most."""
    return max(PROBE_MIN_S, timeout_s / 2)


def wait_for_frame(camera: Camera, timeout_s: float) -> Frame:
    """Wait for the next complete frame; incomplete ones are left to the counters.

    Raises
    ------
    CameraTimeout
        None came, and the camera answers.
    CameraLost
        None came, and it does not.
    """
    deadline_s = time.monotonic() + timeout_s
    while True:
        try:
            frame = camera.poll(max(0.0, deadline_s - time.monotonic()))
        except FrameIncomplete:
            continue
        if frame is not None:
            return frame
        if time.monotonic() >= deadline_s:
            break
    camera.probe(probe_s(timeout_s))
    with suppress(FrameIncomplete):
        frame = camera.poll(0.0)  # the probe may have let a late one through
        if frame is not None:
            return frame
    raise CameraTimeout(f"no frame within {timeout_s:g} s; the camera answers, so look at its trigger")
