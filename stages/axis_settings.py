"""Settings of an axis, and checks that they make sense."""

import math
from dataclasses import dataclass

from stages.errors import StageUsageError
from stages.profile import Approach

LONGEST_TOLERANCE_UM = 10.0  # of a motor
ROUNDING_UM = (
    1e-6  # of the difference of two places with a few decimals: 1.0 and 0.99 differ by no more than 10 um
)
LONGEST_BY_HAND_UM = 500.0  # a ruler is read to a tenth of a millimetre or two


@dataclass(frozen=True, slots=True)
class AxisSettings:
    """Settings of an axis in the bench file; see `stages.config` for the meaning of each."""

    channel: str
    limits_mm: tuple[float, float]
    speed_mm_s: float
    acceleration_mm_s2: float
    sign: int = 1
    offset_mm: float = 0.0
    steps_per_mm: float | None = None
    approach: Approach | None = None
    settle_s: float = 0.1
    in_position_um: float = LONGEST_TOLERANCE_UM
    retries: int = 2
    home_timeout_s: float = 180.0
    reading_um: float | None = None  # of an axis that a person turns and reads: standard deviation of a reading

    def __post_init__(self) -> None:
        low, high = self.limits_mm
        numbers = (low, high, self.speed_mm_s, self.acceleration_mm_s2, self.offset_mm, self.settle_s)
        if not all(map(math.isfinite, numbers)):
            raise StageUsageError("every number of an axis must be finite")
        if not low < high:
            raise StageUsageError(f"limits_mm must rise, not {low} to {high}; (0, 0) never means no limit")
        if self.sign not in (1, -1) or self.speed_mm_s <= 0 or self.acceleration_mm_s2 <= 0 or self.settle_s < 0:
            raise StageUsageError("sign must be 1 or -1, speed and acceleration positive, settle_s not negative")
        longest_um = LONGEST_TOLERANCE_UM if self.reading_um is None else LONGEST_BY_HAND_UM
        if not 0 < self.in_position_um <= longest_um:
            raise StageUsageError(f"in_position_um must be above 0 and at most {longest_um:g}")
        if self.steps_per_mm is not None and 500.0 / self.steps_per_mm > self.in_position_um:
            raise StageUsageError("half a step is more than in_position_um; no target could be reached for sure")
        if self.approach and self.approach.speed_mm_s > self.speed_mm_s:
            raise StageUsageError(
                f"the approach at {self.approach.speed_mm_s:g} mm/s is faster than the axis at"
                f" {self.speed_mm_s:g} mm/s; is one of both speed_mm_s a slip?"
            )
        if self.approach and not 0 < self.approach.distance_mm < high - low:
            raise StageUsageError(
                "the approach distance must be positive and shorter than the way between the limits"
            )
