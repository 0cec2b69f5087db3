"""The weak pulses by which a sheet is aligned: what makes them weak, how many, how fast.

Weak is what is left of the energy when the Q-switch opens far off its best delay after the lamp, or when a diode
is on for a short time. How much that is, only a power meter knows: the numbers are the laboratory's.
"""

from collections.abc import Container
from typing import Annotated

from pydantic import Field

from daq.timing.errors import PulsesRefused
from daq.timing.pulses import LAMPS, Q_SWITCHES, TRIGGER_US, LaserHead, Positive, Pulse, Role, Schedule
from ground.config import Table


class LowEnergyRules(Table):
    """Limits of the alignment mode.

    Parameters
    ----------
    max_rate_hz : float
        Pulses a second.
    max_s : float
        Longest time; the box counts to its end.
    q_switch_delay_us : float or None
        From lamp to Q-switch, off the optimum so that little energy is left; lasers with lamps need it.
    pulse_us : float or None
        Width of the pulse; a modulated diode is weak by it.
    """

    max_rate_hz: Positive = 10.0
    max_s: Annotated[float, Field(gt=0.0, le=60.0)] = 10.0
    q_switch_delay_us: Positive | None = None
    pulse_us: Positive | None = None


def low_energy_burst(
    rules: LowEnergyRules, head: LaserHead, wired: Container[Role], rate_hz: float, for_s: float
) -> tuple[Schedule, int]:
    """Return where the weak pulses lie in a period, and how many of them each Q-switch gets.

    Parameters
    ----------
    rules : LowEnergyRules
        What makes them weak, and their limits.
    head : LaserHead
        What the laser can do.
    wired : container of Role
        Devices connected to the box.
    rate_hz : float
        Pulses a second.
    for_s : float
        Length of the burst.

    Raises
    ------
    PulsesRefused
        A limit is broken, or a laser with lamps has no delay off its best one.
    """
    if not (0.0 < rate_hz <= rules.max_rate_hz and 0.0 < for_s <= rules.max_s):
        raise PulsesRefused(
            f"alignment at {rate_hz:g} Hz for {for_s:g} s: at most {rules.max_rate_hz:g} Hz and {rules.max_s:g} s"
        )
    head.require_rate(rate_hz)
    return _low_energy_schedule(rules, head, wired, rate_hz), max(1, int(rate_hz * for_s))


def _low_energy_schedule(
    rules: LowEnergyRules, head: LaserHead, wired: Container[Role], rate_hz: float
) -> Schedule:
    """Place weak pulses on every Q-switch that is wired, and none on camera or marker."""
    has_lamps = head.lamp_to_q_switch_us is not None
    width_us = head.pulse_us if rules.pulse_us is None else rules.pulse_us
    pulses: dict[Role, Pulse] = {}
    begin_us, apart_us = 0.0, 2.0 * width_us
    if has_lamps:
        if rules.q_switch_delay_us is None:
            raise PulsesRefused("a laser with lamps needs `q_switch_delay_us` for alignment")
        begin_us, apart_us = rules.q_switch_delay_us, 0.0
        pulses = {role: Pulse(0.0, TRIGGER_US) for role in LAMPS if role in wired}
    for number, role in enumerate(role for role in Q_SWITCHES if role in wired):
        pulses[role] = Pulse(begin_us + number * apart_us, width_us)
    return Schedule(1e6 / rate_hz, pulses, tuple(head.q_switch_to_light_us))
