"""What a laser is and can do, as the bench file says it."""

import math
from dataclasses import dataclass

from daq.timing.errors import PulsesRefused

TRIGGER_US = 10.0  # width of what only has to be an edge


@dataclass(frozen=True, slots=True)
class LaserHead:
    """What the laser is and can do; from the bench file.

    Parameters
    ----------
    max_rate_hz : float
        Pairs a second.
    min_dt_us, max_dt_us : float
        Of two pulses; a single cavity cannot do less than its pump allows.
    lamp_to_q_switch_us : (2,) tuple of float or None
        Of each cavity, for full energy; None without lamps.
    q_switch_to_light_us : (2,) tuple of float
        From the trigger to the light, of each cavity.
    pulse_us : float
        Width of the Q-switch triggers; for a modulated diode the time of the light itself.
    lamp_rate_hz : float or None
        The only rate at which the lamps may run; None if any up to `max_rate_hz` will do.
    max_duty : float
        Largest share of the period in which the light may be on; matters for diodes.
    """

    max_rate_hz: float
    min_dt_us: float = 0.0
    max_dt_us: float = 1e6
    lamp_to_q_switch_us: tuple[float, float] | None = None
    q_switch_to_light_us: tuple[float, float] = (0.0, 0.0)
    pulse_us: float = TRIGGER_US
    lamp_rate_hz: float | None = None
    max_duty: float = 0.5

    def require_rate(self, rate_hz: float) -> None:
        """Refuse pairs a second that the laser cannot give; PulsesRefused."""
        if not (math.isfinite(rate_hz) and rate_hz > 0.0):
            raise PulsesRefused(f"a rate of {rate_hz} pairs/s: say a number above 0")
        if rate_hz > self.max_rate_hz:
            raise PulsesRefused(f"{rate_hz:g} pairs/s are more than the laser's {self.max_rate_hz:g}")
        if self.lamp_rate_hz is not None and not math.isclose(rate_hz, self.lamp_rate_hz, rel_tol=1e-6):
            raise PulsesRefused(f"the lamps run at {self.lamp_rate_hz:g} Hz and at no other rate ({rate_hz:g})")
