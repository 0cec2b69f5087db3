"""Pulses of a double-pulse laser (`LaserHead`) and a double-frame camera: which there are, and when.

    T0      |                                                                      period = 1 / rate
    lamp 1  |__#_________________________________    pumps the rod of cavity 1
    Q 1     |__________#_________________________    opens it: light `q_switch_to_light` later
    lamp 2  |______#_____________________________
    Q 2     |______________#_____________________    dt behind the light of Q 1
    camera  |_____#______________________________    exposures begin `start_delay` later
             A    |=======|                          light 1 must fall in here
             B             ||===================|    and light 2 in here; between them lies `gap`
    marker  |____##########______________________    covers exposure A alone, so that the camera can tell A from B

Light 1 may lie anywhere in A and light 2 anywhere in B, each `margin` away from the ends. With dt fixed this
leaves an interval for light 1; its point nearest to the symmetric place about the gap is taken. An empty
interval means that dt does not fit into the frames, and is refused with the numbers that would.

The energy of a flash-lamp pumped pulse depends on the delay from lamp to Q-switch; it is a number of the laser,
not of the experiment. Lasers without lamps (diode pumped, PIVlab's diodes) have none, and their pulse may be as
wide as the light is to last. Sources: Raffel et al., Particle Image Velocimetry, ch. 2.4 (lasers), 4.2 (frame
straddling); docs/laser.md.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

from pydantic import Field

from daq.timing.errors import PulsesRefused
from ground.config import Pair, Table
from ground.usual import Usual

TRIGGER_US = 10.0  # width of what only has to be an edge
ANY_RATE_HZ = 1e12  # of a laser of which nothing is known
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


class LaserHead(Table):
    """Properties and limits of a laser; from the bench file.

    Parameters
    ----------
    max_rate_hz : float
        Pairs a second.
    min_dt_us, max_dt_us : float
        Of two pulses; a single cavity cannot do less than its pump allows.
    lamp_to_q_switch_us : (2,) list of float or None
        Of each cavity, for full energy; None without lamps.
    q_switch_to_light_us : (2,) list of float
        From the trigger to the light, of each cavity.
    pulse_us : float
        Width of the Q-switch triggers; for a modulated diode the time of the light itself.
    lamp_rate_hz : float or None
        The only rate at which the lamps may run; None if any up to `max_rate_hz` will do.
    max_duty : float
        Largest share of the period in which the light may be on; matters for diodes.
    warmup_s : float
        How long lamps run before the first pulse.
    """

    max_rate_hz: Annotated[Positive, Usual(0.5, 1e4)]
    min_dt_us: Annotated[NotNegative, Usual(0.0, 1e3)] = 0.0
    max_dt_us: Annotated[Positive, Usual(1.0, 1e6)] = 1e6
    lamp_to_q_switch_us: Annotated[Pair | None, Usual(40.0, 1e3)] = None
    q_switch_to_light_us: Annotated[Pair, Usual(0.0, 0.9)] = [0.0, 0.0]  # noqa: RUF012 - pydantic copies it
    pulse_us: Annotated[Positive, Usual(0.5, 90.0)] = TRIGGER_US
    lamp_rate_hz: Annotated[Positive | None, Usual(0.5, 200.0)] = None
    max_duty: Annotated[float, Field(gt=0.0, le=0.5)] = 0.5
    warmup_s: Annotated[NotNegative, Usual(0.0, 3600.0)] = 600.0

    def require_rate(self, rate_hz: float) -> None:
        """Refuse pairs a second that the laser cannot give; PulsesRefused."""
        if not (math.isfinite(rate_hz) and rate_hz > 0.0):
            raise PulsesRefused(f"a rate of {rate_hz} pairs/s: use a number above 0")
        if rate_hz > self.max_rate_hz:
            raise PulsesRefused(f"{rate_hz:g} pairs/s are more than the laser's {self.max_rate_hz:g}")
        if self.lamp_rate_hz is not None and not math.isclose(rate_hz, self.lamp_rate_hz, rel_tol=1e-6):
            raise PulsesRefused(f"the lamps run at {self.lamp_rate_hz:g} Hz and at no other rate ({rate_hz:g})")


class Role(StrEnum):
    """Device connected to an output of the unit."""

    LAMP_1 = "lamp_1"
    LAMP_2 = "lamp_2"
    Q_SWITCH_1 = "q_switch_1"
    Q_SWITCH_2 = "q_switch_2"
    CAMERA = "camera"
    CAMERA_B = "camera_b"  # second trigger of a camera that takes one frame a trigger, on the same wire
    MARKER = "marker"


LAMPS = (Role.LAMP_1, Role.LAMP_2)
Q_SWITCHES = (Role.Q_SWITCH_1, Role.Q_SWITCH_2)  # a modulated diode laser has only the first, with two pulses


@dataclass(frozen=True, slots=True)
class PulseTiming:
    """Timing that an experiment asks for.

    Parameters
    ----------
    dt_us : float
        From light 1 to light 2.
    rate_hz : float
        Pairs a second.

    Raises
    ------
    PulsesRefused
        One of them is not above 0, or dt does not fit into the period.
    """

    dt_us: float
    rate_hz: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.dt_us) and self.dt_us > 0.0):
            raise PulsesRefused(f"dt of {self.dt_us} us: use a number above 0")
        if not (math.isfinite(self.rate_hz) and self.rate_hz > 0.0):
            raise PulsesRefused(f"a rate of {self.rate_hz} pairs/s: use a number above 0")
        if self.dt_us >= self.period_us:
            raise PulsesRefused(
                f"dt of {self.dt_us:g} us is longer than the {self.period_us:g} us from pair to pair at "
                f"{self.rate_hz:g} Hz"
            )

    @property
    def period_us(self) -> float:
        """From pair to pair."""
        return 1e6 / self.rate_hz


@dataclass(frozen=True, slots=True)
class PairExposures:
    """Exposures of a camera that takes two frames at one trigger, or at two.

    Parameters
    ----------
    exposure_a_us, exposure_b_us : float
        The two exposures.
    gap_us : float
        Dead time between them: interline transfer, or period - exposure of a camera that straddles frames.
    start_delay_us : float
        From the trigger to the beginning of exposure A.
    margin_us : float
        Kept between light and either end of an exposure: jitter, pulse length, build-up of the light.
    max_rate_hz : float
        Pairs a second that it can take and send.
    two_triggers : bool
        Whether B has a trigger of its own, `exposure_a_us + gap_us` behind that of A.
    """

    exposure_a_us: float
    exposure_b_us: float
    gap_us: float
    start_delay_us: float = 0.0
    margin_us: float = 2.0
    max_rate_hz: float = math.inf
    two_triggers: bool = False

    @property
    def dt_range_us(self) -> tuple[float, float]:
        """Smallest and largest dt that both exposures can hold."""
        return (
            self.gap_us + 2.0 * self.margin_us,
            self.exposure_a_us + self.gap_us + self.exposure_b_us - 2.0 * self.margin_us,
        )

    @property
    def length_us(self) -> float:
        """From the trigger to the end of exposure B."""
        return self.start_delay_us + self.exposure_a_us + self.gap_us + self.exposure_b_us


@dataclass(frozen=True, slots=True)
class Pulse:
    """One pulse a period: when it begins after T0, and how long it is."""

    delay_us: float
    width_us: float

    @property
    def end_us(self) -> float:
        """Time of its end after T0."""
        return self.delay_us + self.width_us


@dataclass(frozen=True)
class Schedule:
    """Every pulse of one period; what a box is loaded with, and what it says that it has.

    Parameters
    ----------
    period_us : float
        From T0 to T0.
    pulses : mapping
        By role.
    light_delay_us : (2,) tuple of float
        From either Q-switch to its light.
    """

    period_us: float
    pulses: Mapping[Role, Pulse]
    light_delay_us: tuple[float, ...] = field(default=(0.0, 0.0))

    @property
    def dt_us(self) -> float:
        """From light 1 to light 2, as these pulses give it.

        Raises
        ------
        KeyError
            It has not both Q-switches.
        """
        first, second = (self.pulses[role].delay_us for role in Q_SWITCHES)
        return second + self.light_delay_us[1] - first - self.light_delay_us[0]

    @property
    def rate_hz(self) -> float:
        """Pairs a second."""
        return 1e6 / self.period_us

    def only(self, *roles: Role) -> "Schedule":
        """Return the same with some of its pulses only."""
        return Schedule(
            self.period_us, {role: p for role, p in self.pulses.items() if role in roles}, self.light_delay_us
        )


def schedule_of(timing: PulseTiming, head: LaserHead, exposures: PairExposures) -> Schedule:
    """Place every pulse of a pair, all of them at or after T0.

    Parameters
    ----------
    timing : PulseTiming
        What is asked for.
    head : LaserHead
        What the laser can do.
    exposures : PairExposures
        What the camera can do.

    Returns
    -------
    Schedule
        Pulses by role; the earliest begins at T0.

    Raises
    ------
    PulsesRefused
        A limit of laser or camera is broken; the message says which, and what would do.
    """
    _require_limits(timing, head, exposures)
    light_1_us = _first_light_us(timing.dt_us, exposures)  # after the camera's trigger
    lights = (light_1_us, light_1_us + timing.dt_us)
    begins: dict[Role, tuple[float, float]] = {Role.CAMERA: (0.0, TRIGGER_US)}
    if exposures.two_triggers:
        begins[Role.CAMERA_B] = (exposures.exposure_a_us + exposures.gap_us, TRIGGER_US)
    # half the gap beyond A, and the trigger that begins it, so that a camera that looks at either end sees it
    marker_end_us = exposures.start_delay_us + exposures.exposure_a_us + exposures.gap_us / 2.0
    begins[Role.MARKER] = (0.0, marker_end_us)
    for number in (0, 1):
        q_switch_us = lights[number] - head.q_switch_to_light_us[number]
        begins[Q_SWITCHES[number]] = (q_switch_us, head.pulse_us)
        if head.lamp_to_q_switch_us is not None:
            begins[LAMPS[number]] = (q_switch_us - head.lamp_to_q_switch_us[number], TRIGGER_US)
    first_us = min(begin for begin, _ in begins.values())
    pulses = {role: Pulse(begin - first_us, width) for role, (begin, width) in begins.items()}
    last_us = max(pulse.end_us for pulse in pulses.values())
    if last_us >= timing.period_us:
        raise PulsesRefused(
            f"the pulses of a pair take {last_us:g} us, longer than the {timing.period_us:g} us from pair to pair"
        )
    return Schedule(timing.period_us, pulses, tuple(head.q_switch_to_light_us))


def _require_limits(timing: PulseTiming, head: LaserHead, exposures: PairExposures) -> None:
    head.require_rate(timing.rate_hz)
    if timing.rate_hz > exposures.max_rate_hz:
        raise PulsesRefused(f"{timing.rate_hz:g} pairs/s are more than the camera's {exposures.max_rate_hz:g}")
    if not head.min_dt_us <= timing.dt_us <= head.max_dt_us:
        raise PulsesRefused(
            f"dt of {timing.dt_us:g} us is not within the laser's {head.min_dt_us:g} to {head.max_dt_us:g} us"
        )
    if exposures.length_us >= timing.period_us:
        raise PulsesRefused(
            f"two exposures take {exposures.length_us:g} us, longer than the {timing.period_us:g} us from pair to "
            "pair"
        )
    low_us, high_us = exposures.dt_range_us
    if not low_us <= timing.dt_us <= high_us:
        raise PulsesRefused(
            f"dt of {timing.dt_us:g} us does not fit into the two exposures of the camera: {low_us:g} to "
            f"{high_us:g} us would"
        )
    if head.pulse_us >= timing.dt_us and head.pulse_us > TRIGGER_US:
        raise PulsesRefused(f"pulses of {head.pulse_us:g} us run into each other at a dt of {timing.dt_us:g} us")
    if head.pulse_us > TRIGGER_US and 2.0 * head.pulse_us > head.max_duty * timing.period_us:
        raise PulsesRefused(
            f"two pulses of {head.pulse_us:g} us are more than {head.max_duty:.0%} of {timing.period_us:g} us"
        )


def _first_light_us(dt_us: float, exposures: PairExposures) -> float:
    """Time of light 1 after the camera's trigger: as symmetric about the gap as both exposures allow."""
    margin_us = exposures.margin_us
    begin_a_us = exposures.start_delay_us
    end_a_us = begin_a_us + exposures.exposure_a_us
    begin_b_us = end_a_us + exposures.gap_us
    end_b_us = begin_b_us + exposures.exposure_b_us
    earliest_us = max(begin_a_us, begin_b_us - dt_us) + margin_us
    latest_us = min(end_a_us, end_b_us - dt_us) - margin_us
    if earliest_us > latest_us:
        raise PulsesRefused(
            f"no moment for light 1 is {margin_us:g} us away from the ends of both exposures with a dt of "
            f"{dt_us:g} us; lengthen the exposures"
        )
    symmetric_us = (end_a_us + begin_b_us) / 2.0 - dt_us / 2.0
    return min(max(symmetric_us, earliest_us), latest_us)
