"""Whether a frame can be there in time at all: exposure, readout and transfer against `timeout_s`.

With too little patience every frame comes after its timeout, and a run would end after its first triggers with
words about the link.  The camera tells what it needs by its settings, so this is said before anything moves.  Only
what a camera tells is counted: one that tells nothing is never refused.

    ExposureTime                [us]; ExposureTimeAbs before SFNC 2
    SensorReadoutTime           [us]
    PayloadSize                 [byte], over DeviceLinkThroughputLimit, or DeviceLinkSpeed, or GevLinkSpeed
    1 / ResultingFrameRate      a frame takes that long at least, whatever limits it
    1 / AcquisitionFrameRate    of a camera that runs by itself: the next frame may be that far away
"""

import math
from collections.abc import Iterator, Mapping

from daq.bench.bench_table import trigger_is_software
from daq.cameras.camera import Setting
from daq.cameras.link import first_of, told_bytes_s
from daq.errors import RunUsageError

EXPOSURES_US = ("ExposureTime", "ExposureTimeAbs")
READOUTS_US = ("SensorReadoutTime",)
RATES_HZ = ("ResultingFrameRate", "AcquisitionResultingFrameRate", "ResultingFrameRateAbs")
ASKED_HZ = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")


def require_patience(timeout_s: float, settings: Mapping[str, Setting]) -> None:
    """Refuse a timeout that no frame can meet.

    Parameters
    ----------
    timeout_s : float
        How long a frame is waited for.
    settings : mapping
        What the camera read back when it was set up.

    Raises
    ------
    RunUsageError
        It is too short; says how long it has to be.
    """
    parts = dict(_parts_s(settings))
    frame_s = sum(parts.values())
    least_s = max(frame_s, _period_s(settings, RATES_HZ))
    if least_s > frame_s:
        parts = {"one frame at the camera's rate": least_s}
    runs_by_itself = settings.get("TriggerMode", "Off") == "Off" and not trigger_is_software(settings)
    if runs_by_itself and settings.get("AcquisitionFrameRateEnable", True) is True:
        between_s = _period_s(settings, ASKED_HZ)
        if between_s:
            parts["time between frames"] = between_s
    needed_s = sum(parts.values())
    if timeout_s < needed_s:
        told = " + ".join(f"{what} {part_s:.3g} s" for what, part_s in parts.items())
        raise RunUsageError(
            f"timeout_s = {timeout_s:g} is shorter than a frame takes ({told}); set timeout_s of the camera to "
            f"more than {math.ceil(1e3 * needed_s) / 1e3:g}"
        )


def _parts_s(settings: Mapping[str, Setting]) -> Iterator[tuple[str, float]]:
    for what, names in (("exposure", EXPOSURES_US), ("readout", READOUTS_US)):
        microseconds = first_of(settings, names)
        if microseconds:
            yield what, microseconds * 1e-6
    payload_bytes, bytes_s = first_of(settings, ("PayloadSize",)), told_bytes_s(settings)
    if payload_bytes and bytes_s:
        yield "transfer", payload_bytes / bytes_s


def _period_s(settings: Mapping[str, Setting], names: tuple[str, ...]) -> float:
    rate_hz = first_of(settings, names)
    return 1.0 / rate_hz if rate_hz else 0.0
