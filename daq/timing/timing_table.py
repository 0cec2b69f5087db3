"""Section of a bench file for a timing unit and its laser; docs/laser.md shows the wiring."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from daq.timing.conditions import CLEAR_MM, Rules
from daq.timing.drivers_by_name import DRIVERS
from daq.timing.low_energy import LowEnergyRules
from daq.timing.pulses import LAMPS, Q_SWITCHES, LaserHead, NotNegative, PairExposures, Positive, Role
from daq.timing.switches import SwitchTable
from ground.config import Table
from ground.usual import Usual

OFF_BEST = 0.2  # share by which a Q-switch must be off its best delay to be called weak


class ExposuresTable(Table):
    """Exposures of a pair; see `PairExposures`."""

    exposure_a_us: Positive
    exposure_b_us: Positive
    gap_us: NotNegative
    start_delay_us: NotNegative = 0.0
    margin_us: NotNegative = 2.0
    max_rate_hz: Positive
    two_triggers: bool = False

    def exposures(self) -> PairExposures:
        """Return the same as pulses are placed by."""
        return PairExposures(**self.model_dump())


class TimingTable(Table):
    """The section of a device of kind `timing`, without `kind`."""

    box: str
    port: Annotated[str, Field(min_length=1)]
    baud: Annotated[int, Field(ge=300, le=4_000_000)] | None = None
    identity: str | None = None
    channels: dict[str, str]
    head: LaserHead
    exposures: ExposuresTable | None = None
    chunk_s: Annotated[float, Field(gt=0.0, le=10.0)] = 10.0
    clear_mm: Annotated[Annotated[float, Field(ge=0.0, le=1000.0)], Usual(0.5, 30.0)] = CLEAR_MM
    dark_us: Positive | None = None
    uncounted: bool = False
    align: LowEnergyRules | None = None
    switches: dict[str, SwitchTable] = {}  # noqa: RUF012 - pydantic copies it
    gate: Literal["high", "low"] | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> "TimingTable":
        if self.box not in DRIVERS and ":" not in self.box:
            raise ValueError(f"box: there is no timing unit {self.box!r}; there are {', '.join(DRIVERS)}")
        known = {role.value for role in Role}
        if unknown := [name for name in self.channels if name not in known]:
            raise ValueError(f"channels: {unknown[0]!r} is none of {', '.join(sorted(known))}")
        if len(set(self.channels.values())) < len(self.channels):
            raise ValueError("channels: two things are connected to one output")
        if Role.Q_SWITCH_1 not in self.channels or Role.CAMERA not in self.channels:
            raise ValueError("channels: set at least q_switch_1 and camera")
        has_lamps = [role in self.channels for role in LAMPS]
        if any(has_lamps) != (self.head.lamp_to_q_switch_us is not None):
            raise ValueError("lamp channels and head.lamp_to_q_switch_us belong together; set both or none")
        if self.box.startswith("pivlab") and not self.identity:
            raise ValueError("identity: set the name on the label of the synchroniser")
        if any(has_lamps) and has_lamps != [role in self.channels for role in Q_SWITCHES]:
            raise ValueError("channels: each lamp needs its Q-switch")
        if self.align is not None and (problem := _not_weak(self.align, self.head)):
            raise ValueError(problem)
        if self.head.min_dt_us > self.head.max_dt_us:
            raise ValueError("head.min_dt_us is larger than head.max_dt_us")
        return self

    @property
    def wiring(self) -> dict[Role, str]:
        """Output of the box by the device connected to it."""
        return {Role(name): output for name, output in self.channels.items()}

    def rules(self) -> Rules:
        """Requirements of the laboratory."""
        return Rules(
            warmup_s=self.head.warmup_s if self.head.lamp_to_q_switch_us is not None else 0.0,
            chunk_s=self.chunk_s,
            clear_mm=self.clear_mm,
            dark_us=self.dark_us,
            uncounted=self.uncounted,
            align=self.align,
        )


def _not_weak(align: LowEnergyRules, head: LaserHead) -> str | None:
    """Say what keeps alignment from being weak; None if nothing is known to."""
    if head.lamp_to_q_switch_us is None:
        if align.pulse_us is None or align.pulse_us >= head.pulse_us:
            return f"align.pulse_us: a laser without lamps is made weak by it; say less than {head.pulse_us:g}"
        return None
    delay_us = align.q_switch_delay_us
    if delay_us is None:
        return "align.q_switch_delay_us: a laser with lamps is made weak by it; say it"
    if any(abs(delay_us - best_us) < OFF_BEST * best_us for best_us in head.lamp_to_q_switch_us):
        return f"align.q_switch_delay_us: {delay_us:g} is within {OFF_BEST:.0%} of the best one; that is not weak"
    return None
