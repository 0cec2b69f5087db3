"""Bandwidth check before the run: the frames of a step must fit through the camera's link.

A camera that is triggered faster than its cable carries drops triggers or frames, and a run would end after its
first pairs with words about the link.  What a frame needs is known from the bench file, and from the camera when
it is set up:

    bytes of a frame  x  frames a second  <=  what the link carries (cameras.link)

Frames that are asked for one at a time (software triggers) wait for the link and need no rate.  A link of which
is of unknown speed is believed; its need is only reported.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from daq.bench.bench_table import Bench, CameraSection, trigger_is_software
from daq.cameras.camera import Setting
from daq.cameras.formats import FORMATS
from daq.cameras.link import MBITS, first_of, link_capacity_bytes_s
from daq.errors import RunUsageError
from daq.plans.steps import Step

PACKED = "Mono12p"  # what wider pixels lose nothing by, for a sensor of 12 bits
ASKED_HZ = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")


@dataclass(frozen=True)
class LinkNeed:
    """Bandwidth that a step needs.

    Parameters
    ----------
    width, height : int
        Of a frame as it is sent [px].
    pixel_format : str
        SFNC name.
    frame_bytes : float
        Of a frame.
    rate_hz : float
        Of what the plan counts: pairs of a flow, else frames.
    frames : int
        Frames that are sent for one of those.
    """

    width: int
    height: int
    pixel_format: str
    frame_bytes: float
    rate_hz: float
    frames: int

    @property
    def bytes_s(self) -> float:
        """Data rate of the link [byte/s]."""
        return self.frame_bytes * self.frames * self.rate_hz

    @property
    def sentence(self) -> str:
        """Needed bandwidth, in words."""
        what = "frames/s" if self.frames == 1 else f"x {self.frames} frames/s"
        return (
            f"{self.width} x {self.height} px in {self.pixel_format} are {self.frame_bytes / 1e6:.2f} MB a frame, "
            f"{self.rate_hz:g} {what} need {self.bytes_s / 1e6:.1f} MB/s"
        )


def link_need(bench: Bench, step: Step, camera_settings: Mapping[str, Setting] | None = None) -> LinkNeed | None:
    """Return the bandwidth that a step needs; None if it has no rate, or the bench file names no format.

    Parameters
    ----------
    bench : Bench
        The bench.
    step : Step
        The step.
    camera_settings : mapping, optional
        What the camera read back; without it the bench file's word counts.
    """
    section = bench.table.camera
    settings = dict(section.settings) | dict(camera_settings or {})
    rate_hz, frames = _rate_hz(section, step, settings)
    form = FORMATS.get(str(settings.get("PixelFormat")))
    if not rate_hz or form is None:
        return None
    width, height = bench.scene.camera.sensor_px
    if section.pairs is not None and section.pairs.shape == "double_height":
        height *= 2
    width, height = int(settings.get("Width", width)), int(settings.get("Height", height))
    frame_bytes = first_of(settings, ("PayloadSize",)) or width * height * form.wire_bits / 8
    return LinkNeed(width, height, form.name, frame_bytes, rate_hz, frames)


def link_excess(bench: Bench, step: Step, camera_settings: Mapping[str, Setting] | None = None) -> str:
    """Return why a step does not fit through the link, with the cure; "" if it does, or if that is not known.

    Parameters
    ----------
    bench, step, camera_settings
        As for `link_need`.
    """
    need, section = link_need(bench, step, camera_settings), bench.table.camera
    carried = link_capacity_bytes_s(dict(section.settings) | dict(camera_settings or {}), section.link)
    if need is None or not carried or need.bytes_s <= carried:
        return ""
    by = f"{section.link} carries" if section.link else "the camera's link carries"
    return f"{need.sentence}, and {by} {carried / 1e6:.1f} MB/s: {_cure(need, carried)}"


def link_said(bench: Bench, steps: Iterable[Step]) -> str:
    """Describe the need of the most demanding step and the link; "" if no step has a rate."""
    needs = [need for step in steps if (need := link_need(bench, step)) is not None]
    if not needs:
        return ""
    most, section = max(needs, key=lambda need: need.bytes_s), bench.table.camera
    carried = link_capacity_bytes_s(section.settings, section.link)
    if carried:
        return f"link: {most.sentence} of {carried / 1e6:.1f}"
    fits = [name for name in MBITS if most.bytes_s <= link_capacity_bytes_s(section.settings, name)]  # type: ignore[arg-type]
    return f"link: {most.sentence}; Ethernet that carries it: {fits[0] if fits else 'none'} (set camera.link)"


def require_link(bench: Bench, steps: Iterable[Step], camera_settings: Mapping[str, Setting]) -> None:
    """Refuse, before anything moves, what the camera's link does not carry by what the camera tells of it.

    Raises
    ------
    RunUsageError
        With the cure.
    """
    for step in steps:
        if said := link_excess(bench, step, camera_settings):
            raise RunUsageError(f"step {step.index + 1} ({step.tag}): {said}")


def _rate_hz(section: CameraSection, step: Step, settings: Mapping[str, Setting]) -> tuple[float, int]:
    """Rate, and frames that are sent for each of what it counts."""
    if step.pulses is not None:
        return step.pulses.rate_hz, section.pairs.frames if section.pairs is not None else 2
    if trigger_is_software(settings):
        return 0.0, 1
    return first_of(settings, ASKED_HZ), 1


def _cure(need: LinkNeed, carried: float) -> str:
    bits, packed = FORMATS[need.pixel_format].wire_bits, FORMATS[PACKED]
    fewer = min(1.0, packed.wire_bits / bits)
    share = carried / (need.bytes_s * fewer)
    first = f"set PixelFormat to {PACKED} ({need.bytes_s * fewer / 1e6:.1f} MB/s)" if fewer < 1.0 else ""
    if share >= 1.0:
        return f"{first}, or use a faster link"
    rows, rate_hz = int(need.height * share) // 2 * 2, int(10.0 * need.rate_hz * share) / 10.0
    reach = f"Height of {rows} at most, or {rate_hz:g} Hz at most, or a faster link"
    return f"{first} with a {reach}" if first else f"set a {reach}"
