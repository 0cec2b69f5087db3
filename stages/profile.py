"""Motion profiles of an axis: legs, approach side, durations.  Pure functions, used by axes and plans.

A screw with play delivers its position only when its last motion had the same direction as the last motion of
every other measurement. So an axis with an `Approach` always ARRIVES in one direction: if the way to the target
already runs in that direction for at least the approach distance, it goes straight; otherwise it goes past the
target by that distance first and comes back at the approach speed. This is the only place where backlash is
compensated; switch compensation off in the controller.

(The meaning is that of BDST and BVEL in the EPICS motor record; here a short move in the right direction is
also made in two legs, because the play need not be taken up yet.)
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from ground.config import Table
from ground.usual import Usual

Positive = Annotated[float, Field(gt=0.0, le=1e7)]


class Approach(Table):
    """From which side an axis arrives, from how far, how fast.

    Parameters
    ----------
    side : str
        From below, the axis arrives while the coordinate grows.
    distance_mm : float
        Length of the last leg; several times the play.
    speed_mm_s : float
        Speed of the last leg.
    """

    side: Literal["from_below", "from_above"]
    distance_mm: Annotated[Positive, Usual(0.06, 4.9)]
    speed_mm_s: Annotated[Positive, Usual(0.02, 50.0)]

    @property
    def upwards(self) -> bool:
        """Return whether the axis arrives while the coordinate grows."""
        return self.side == "from_below"

    def before_mm(self, target_mm: float) -> float:
        """Start of the last leg to a target."""
        return target_mm - self.distance_mm if self.upwards else target_mm + self.distance_mm


@dataclass(frozen=True, slots=True)
class Leg:
    """One straight motion of one axis."""

    start_mm: float
    end_mm: float
    speed_mm_s: float


def legs(start_mm: float, target_mm: float, speed_mm_s: float, approach: Approach | None) -> tuple[Leg, ...]:
    """Return the motions that bring an axis from `start_mm` to `target_mm`, arriving from the right side.

    Parameters
    ----------
    start_mm, target_mm : float
        Positions.
    speed_mm_s : float
        Speed of long legs.
    approach : Approach or None
        None for a screw without play.
    """
    if approach is None:
        return (Leg(start_mm, target_mm, speed_mm_s),)
    before_mm = approach.before_mm(target_mm)
    already_outside = start_mm <= before_mm if approach.upwards else start_mm >= before_mm
    if already_outside:
        return (Leg(start_mm, target_mm, speed_mm_s),)
    return (Leg(start_mm, before_mm, speed_mm_s), Leg(before_mm, target_mm, approach.speed_mm_s))


def duration_s(distance_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> float:
    """Time of a motion with a trapezoid of speed: d/v + v/a, or 2 sqrt(d/a) if v is never reached."""
    distance_mm = abs(distance_mm)
    if distance_mm * acceleration_mm_s2 >= speed_mm_s**2:
        return distance_mm / speed_mm_s + speed_mm_s / acceleration_mm_s2
    return 2.0 * math.sqrt(distance_mm / acceleration_mm_s2)
