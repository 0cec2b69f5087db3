"""What a camera tells of itself between steps: its clock beside ours, and its temperature.

The clock is asked a few times, and the question that was answered soonest is kept: the latch of the clock lies
between the moments right before and behind it.  What a camera does not tell is left out, and one that does not
answer is found by whoever waits for its frames.
"""

import math
import time
from typing import Any

from daq.cameras.camera import Camera
from daq.errors import CameraError
from daq.runs.journal import utc_now

QUESTIONS = 5
TEMPERATURES = ("DeviceTemperature", "TemperatureAbs", "CCDTemperature")  # SFNC 2, an older name, adapters


def camera_facts(camera: Camera) -> dict[str, Any]:
    """What a line of the kind `camera` says; empty if there is nothing to say."""
    try:
        clock, told = ask_clock(camera), camera.read(TEMPERATURES)
    except CameraError:
        return {}
    facts: dict[str, Any] = {}
    if clock is not None:
        facts = {"monotonic_ns": [clock[0], clock[2]], "camera_ns": clock[1]}
    for name in TEMPERATURES:
        value = told.get(name)
        if isinstance(value, int | float) and math.isfinite(value):
            now_ns = time.monotonic_ns()
            facts = {"monotonic_ns": [now_ns, now_ns], **facts, "celsius": float(value)}
            break
    utc = utc_now()
    return {"utc": utc, **facts} if facts else {}


def ask_clock(camera: Camera) -> tuple[int, int, int] | None:
    """Ask for the clock; our clock before, the camera's, ours behind; None if it cannot be read."""
    found: tuple[int, int, int] | None = None
    for _ in range(QUESTIONS):
        before_ns = time.monotonic_ns()
        clock_ns = camera.clock_ns()
        after_ns = time.monotonic_ns()
        if clock_ns is None:
            return None
        if found is None or after_ns - before_ns < found[2] - found[0]:
            found = (before_ns, clock_ns, after_ns)
    return found
