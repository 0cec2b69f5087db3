"""Pulses that a step asks of a laser, and checks of laser and camera of the bench; nothing is open."""

from dataclasses import dataclass

from daq.bench.bench_table import Bench, trigger_is_software
from daq.bench.pairs_section import SPACING_RATIO, PairsSection
from daq.errors import PlanError
from daq.timing.pulses import ANY_RATE_HZ, LaserHead, PairExposures, PulseTiming, Role, schedule_of
from daq.timing.timing_table import TimingTable

SHARED = ("shape", "dead_us", "start_delay_us", "second_exposure_us")  # of cameras on one trigger line


@dataclass(frozen=True, slots=True)
class PulseOrder:
    """Pairs of light pulses for a step.

    Parameters
    ----------
    laser : str or None
        Device of the bench; None where an external synchroniser triggers laser and camera.
    dt_us, rate_hz : float
        Between the pulses of a pair, and pairs a second.
    chunk : int
        Pairs that are fired in one go, or taken in one go from an external synchroniser.
    warm_up_s : float
        Least time that the lamps run before the first pair.
    lost_at_most : float
        Share of the fired pairs that may be lost, 0 to 1.
    is_background : bool
        Before the seeding is opened.
    dt_measured_us, dt_sigma_us : float, optional
        Measured value, such as with a photodiode, and its standard deviation.
    """

    laser: str | None
    dt_us: float
    rate_hz: float
    chunk: int
    warm_up_s: float = 0.0
    lost_at_most: float = 0.1
    is_background: bool = False
    dt_measured_us: float | None = None
    dt_sigma_us: float | None = None

    @property
    def timing(self) -> PulseTiming:
        """The same as the laser wants it; PulsesRefused if it makes no sense."""
        return PulseTiming(self.dt_us, self.rate_hz)


def pairs_section(bench: Bench) -> PairsSection:
    """Return how the camera of a bench gives pairs; PlanError if its file does not say it."""
    section = bench.table.camera.pairs
    if section is None:
        raise PlanError(
            f"{bench.path}: camera has no pairs, which distinguishes exposure A from exposure B; add "
            "camera.pairs with shape, marker and dead_us (docs/files.md)"
        )
    return section


def pair_exposures(section: PairsSection, exposure_us: float) -> PairExposures:
    """The exposures of a pair as pulses are placed by.

    Parameters
    ----------
    section : PairsSection
        How pairs come.
    exposure_us : float
        Of exposure A, and of B where the section says nothing else.
    """
    return PairExposures(
        exposure_us,
        section.second_exposure_us or exposure_us,
        section.dead_us,
        section.start_delay_us,
        section.margin_us,
        section.most_hz or float("inf"),
        two_triggers=section.shape == "straddling",
    )


def check_pulses(bench: Bench, order: PulseOrder) -> None:
    """Refuse what laser and camera of a bench cannot do; nothing is open and nothing is fired.

    Raises
    ------
    PlanError
        The bench has no such laser, does not say how pairs come, or nothing would tell A from B.
    PulsesRefused
        dt, rate and exposures do not go together.
    """
    section, camera = pairs_section(bench), bench.table.camera
    lasers = {name: one.section for name, one in bench.more.items() if isinstance(one.section, TimingTable)}
    timing = None if order.laser is None else lasers.get(order.laser)
    if order.laser is not None and timing is None:
        raise PlanError(
            f"{bench.path}: devices has no timing unit {order.laser!r}; there are {', '.join(lasers) or 'none'}"
        )
    if order.laser is None and lasers:
        raise PlanError(
            f"{bench.path}: the plan names no laser, and the bench has {', '.join(lasers)}; name it (laser: "
            f"{next(iter(lasers))}), or take it out of the bench file if another synchroniser triggers the camera"
        )
    settings = camera.settings
    if settings.get("TriggerMode") != "On" or trigger_is_software(settings):
        raise PlanError(
            f"{bench.path}: the frames of a flow are triggered by the timing unit; set TriggerMode: On and "
            "TriggerSource to the line that it is wired to"
        )
    exposure_us = settings.get("ExposureTime", settings.get("ExposureTimeAbs"))
    if not isinstance(exposure_us, int | float) or isinstance(exposure_us, bool):
        raise PlanError(f"{bench.path}: camera.settings lacks ExposureTime, so no pulse can be placed")
    exposures = pair_exposures(section, float(exposure_us))
    head = LaserHead(max_rate_hz=ANY_RATE_HZ) if timing is None else timing.head
    schedule_of(order.timing, head, exposures)
    check_marker(section, float(exposure_us), order.rate_hz)
    if timing is None:
        return
    if section.shape == "straddling" and Role.CAMERA_B not in timing.wiring:
        raise PlanError(f"{bench.path}: frames of shape straddling need a trigger for B; wire channel camera_b")
    if section.shape != "straddling" and Role.CAMERA_B in timing.wiring:
        raise PlanError(
            f"{bench.path}: channel camera_b would trigger unwanted exposures; frames of shape "
            f"{section.shape} have one trigger a pair"
        )
    most = int(timing.chunk_s * order.rate_hz + 1e-9)
    if not 1 <= order.chunk <= most:
        raise PlanError(
            f"a chunk of {order.chunk} pairs at {order.rate_hz:g} Hz: 1 to {most} fit into the "
            f"{timing.chunk_s:g} s of {order.laser}"
        )


def check_same_trigger(bench: Bench, name: str, order: PulseOrder) -> None:
    """Refuse a further camera that cannot take the same pairs from the same trigger pulses; PlanError."""
    beside = bench.as_seen_by(name)
    check_pulses(beside, order)
    first, second = pairs_section(bench), pairs_section(beside)
    settings, others = bench.table.camera.settings, beside.table.camera.settings
    exposures = [each.get("ExposureTime", each.get("ExposureTimeAbs")) for each in (settings, others)]
    apart = [key for key in SHARED if getattr(first, key) != getattr(second, key)]
    apart += ["ExposureTime"] if exposures[0] != exposures[1] else []
    if apart:
        raise PlanError(
            f"{bench.path}: camera and {name} share one trigger line, and pulses are placed into the exposures "
            f"of both; give them the same {', '.join(apart)}"
        )


def check_marker(section: PairsSection, exposure_us: float, rate_hz: float) -> None:
    """Refuse a marker that would tell nothing at this rate; PlanError."""
    gap_us, period_us = exposure_us + section.dead_us, 1e6 / rate_hz
    if section.effective_marker == "spacing" and period_us - gap_us < SPACING_RATIO * gap_us:
        raise PlanError(
            f"A to B takes {gap_us:g} us and B to A {period_us - gap_us:g} us at {rate_hz:g} Hz: their spacing "
            "does not mark A; use another marker, or A to B shorter by more than 10 %"
        )
