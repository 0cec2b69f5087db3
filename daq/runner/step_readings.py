"""Readings at every step of a run beside its frames: gauges of the lab, and the state of the camera.

Gauges are read, shown, and said once when one falls silent.

A camera tells its clock beside ours, and its temperature.  The clock is asked a few times, and the question that
was answered soonest is kept: the latch of the clock lies between the moments right before and behind it.  What a
camera does not tell is left out, and one that does not answer is found where its frames are waited for.
"""

import math
import time
from collections.abc import Collection, Mapping
from typing import Any

from daq.bench.reading import Gauge, Reading
from daq.cameras.camera import Camera
from daq.errors import CameraError, ReadingMissing
from daq.runner.progress import Progress
from daq.runs.journal import utc_now

QUESTIONS = 5
TEMPERATURES = ("DeviceTemperature", "TemperatureAbs", "CCDTemperature")  # SFNC 2, an older name, adapters


class Gauges:
    """Readings of an open bench.

    Parameters
    ----------
    devices : mapping
        Every device that is open, by name; those that can be read are taken.
    needed : collection of str
        Names of those without which no step is taken.
    """

    def __init__(self, devices: Mapping[str, object], needed: Collection[str] = ()) -> None:
        self._gauges: dict[str, Gauge] = {
            name: device for name, device in devices.items() if isinstance(device, Gauge)
        }
        self._needed = frozenset(needed)
        self._silent: set[str] = set()

    def read(self, progress: Progress) -> dict[str, dict[str, Any]]:
        """Read all of them, for a line of the journal.

        Raises
        ------
        ReadingMissing
            One that is needed shows nothing.
        """
        found = {name: gauge.reading() for name, gauge in self._gauges.items()}
        for name, reading in found.items():
            progress.readings[name] = "-" if reading.missing else f"{reading.value:g} {reading.unit}"
            self._judge(name, reading, progress)
        return {name: reading.to_dict() for name, reading in found.items()}

    def _judge(self, name: str, reading: Reading, progress: Progress) -> None:
        if not reading.missing:
            self._silent.discard(name)
            return
        if name in self._needed:
            raise ReadingMissing(
                f"no reading of {name}, which the plan needs: {reading.missing}; see to it, then"
                " rtpiv acquire --resume"
            )
        if name not in self._silent:
            self._silent.add(name)
            progress.remarks.append(f"no reading of {name}: {reading.missing}; the run goes on without")


def camera_facts(camera: Camera) -> dict[str, Any]:
    """Contents of a line of the kind `camera`; empty if there is nothing to record."""
    try:
        clock, values = ask_clock(camera), camera.read(TEMPERATURES)
    except CameraError:
        return {}
    facts: dict[str, Any] = {}
    if clock is not None:
        facts = {"monotonic_ns": [clock[0], clock[2]], "camera_ns": clock[1]}
    for name in TEMPERATURES:
        value = values.get(name)
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
