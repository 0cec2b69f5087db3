"""Test of a camera's trigger: settings kept, triggers arrive, exposures as long as set.

    set up, read back -> arm -> a few frames, asked for or waited for -> what each says of itself

Frames of a software trigger are asked for; any others have to be triggered by the timing unit meanwhile, with the
laser off.  The exposure is judged by what the camera sends with its frames (chunk ExposureTime), for what reads
back is only what was set; a camera that sends no such chunk leaves it open, which is reported.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise

from daq.bench.bench_table import CameraSection
from daq.cameras.camera import Camera
from daq.cameras.frame import Frame, FrameMeta
from daq.errors import CameraTimeout, FrameIncomplete, SettingRefused
from daq.runner.camera_session import CameraSession
from daq.runs.laser_proof import Trial

FRAMES = 6
CHUNK = "ExposureTime"
EXPOSURE_OFF = 0.02  # share by which an exposure may differ; cameras round it to their rows
ROUNDED_US = 2.0


def try_trigger(
    camera: Camera, section: CameraSection, frames: int = FRAMES, rendering_s: Callable[[], float] = lambda: 0.0
) -> list[Trial]:
    """Take a few frames as the bench file sets the camera up, and judge them.

    Parameters
    ----------
    camera : Camera
        Open.
    section : CameraSection
        How it is set up.
    frames : int
        How many.
    rendering_s : callable, optional
        Seconds in which a simulation drew pictures, up to now.

    Raises
    ------
    CameraError
        It does not take its settings, or is lost.
    """
    sends = _sends_exposures(camera, section)
    asked = [*section.chunks, *([CHUNK] if sends and CHUNK not in section.chunks else [])]
    exposures = CameraSession(camera, section.model_copy(update={"chunks": asked}), rendering_s=rendering_s)
    settings = exposures.set_up()
    found = [Trial("settings", True, f"{len(section.settings)} read back as they were set")]
    metas: list[FrameMeta] = []
    why = ""
    exposures.begin()
    try:
        exposures.make_ready()
        for _ in range(frames):
            if exposures.software:
                camera.trigger()
            with _next(exposures) as frame:
                metas.append(frame.meta)
    except (CameraTimeout, FrameIncomplete) as error:
        why = str(error)
    finally:
        exposures.end()
    source = settings.get("TriggerSource") if settings.get("TriggerMode") == "On" else "its own clock"
    if why:
        cure = "look at the wire, its level and TriggerActivation"
        return [
            *found,
            Trial("trigger", False, f"{len(metas)} of {frames} frames by {source}: {why}; {cure}"),
        ]
    ignored = camera.counters.ignored_triggers
    said = f"{frames} of {frames} frames by {source}{_rate(metas)}"
    said += f", {ignored} triggers were ignored while it began and ended" if ignored else ""
    found.append(Trial("trigger", True, said))
    second_us = None if section.pairs is None else section.pairs.second_exposure_us
    return [*found, *_exposures(metas, settings.get(CHUNK, settings.get("ExposureTimeAbs")), second_us)]


def _next(exposures: CameraSession) -> Frame:
    """Next whole frame; one with pixels missing is left to the camera's counters."""
    deadline_s = exposures.now_s() + exposures.section.timeout_s
    while True:
        with suppress(FrameIncomplete):
            return exposures.wait_until(deadline_s)


def _sends_exposures(camera: Camera, section: CameraSection) -> bool:
    try:
        camera.configure(section.settings, chunks=[CHUNK])
    except SettingRefused:
        return False
    return True


def _rate(metas: list[FrameMeta]) -> str:
    times = [meta.timestamp_ns for meta in metas if meta.timestamp_ns]
    if len(times) < 2 or times[-1] <= times[0]:
        return ""
    apart_ms = [1e-6 * (after - before) for before, after in pairwise(times)]
    return f", {min(apart_ms):.3f} to {max(apart_ms):.3f} ms apart"


def _exposures(metas: list[FrameMeta], asked: object, second_us: float | None) -> Iterator[Trial]:
    """Judge what came with the frames; exposure B of a double frame may be another."""
    exposures_us = [meta.chunks[CHUNK] for meta in metas if CHUNK in meta.chunks]
    if len(exposures_us) < len(metas):
        yield Trial("exposure", None, "the camera sends none with its frames, so only what reads back is known")
        return
    shortest, longest = min(exposures_us), max(exposures_us)
    is_one = math.isclose(shortest, longest, rel_tol=1e-6)
    said = f"{shortest:g} us" if is_one else f"{shortest:g} to {longest:g} us"
    if not isinstance(asked, int | float):
        yield Trial("exposure", None, f"{said}; what it was set to reads not back")
        return
    wanted = [asked] if second_us is None else [asked, second_us]
    is_right = all(any(_is_near(each, one) for one in wanted) for each in exposures_us)
    yield Trial("exposure", is_right, f"{said}, set to {' and '.join(f'{one:g}' for one in wanted)} us")


def _is_near(told_us: float, asked_us: float) -> bool:
    return abs(told_us - asked_us) <= max(ROUNDED_US, EXPOSURE_OFF * asked_us)
