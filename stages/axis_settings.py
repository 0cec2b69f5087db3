"""Settings of an axis, and checks that they make sense."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from ground.config import Pair, Table
from ground.usual import Usual
from stages.errors import StageUsageError
from stages.profile import Approach, Positive

LONGEST_TOLERANCE_UM = 10.0  # of a motor
# Of the difference of two places with a few decimals: 1.0 and 0.99 differ by at most 10 um
ROUNDING_UM = 1e-6
LONGEST_BY_HAND_UM = 500.0  # a ruler is read to a tenth of a millimetre or two


def _channel(value: object) -> object:
    """Text of a channel that a file numbers."""
    return str(value) if type(value) is int else value


class AxisSettings(Table):
    """Settings of an axis in the bench file; see `stages.config` for the meaning of each."""

    channel: Annotated[str, BeforeValidator(_channel, json_schema_input_type=str | int)]
    limits_mm: Pair
    speed_mm_s: Annotated[Positive, Usual(0.2, 250.0)]
    acceleration_mm_s2: Annotated[Positive, Usual(1.0, 5000.0)]
    steps_per_mm: Annotated[Positive | None, Usual(20.0, 1e6)] = None
    sign: Literal[1, -1] = 1
    offset_mm: float = 0.0
    approach: Approach | None = None
    settle_s: Annotated[Annotated[float, Field(ge=0.0, le=60.0)], Usual(0.0, 5.0)] = 0.1
    in_position_um: Annotated[Annotated[float, Field(gt=0.0, le=LONGEST_BY_HAND_UM)], Usual(0.2, 500.0)] = 10.0
    retries: Annotated[int, Field(ge=0, le=10)] = 2
    home_timeout_s: Annotated[Annotated[float, Field(gt=0.0, le=3600.0)], Usual(10.0, 1200.0)] = 180.0
    reading_um: Annotated[Annotated[float, Field(gt=0.0, le=1000.0)] | None, Usual(0.5, 500.0)] = None

    @model_validator(mode="after")
    def _makes_sense(self) -> "AxisSettings":
        low, high = self.limits_mm
        if not low < high:
            raise StageUsageError(f"limits_mm must rise, not {low} to {high}; (0, 0) never means no limit")
        longest_um = LONGEST_TOLERANCE_UM if self.reading_um is None else LONGEST_BY_HAND_UM
        if self.in_position_um > longest_um:
            raise StageUsageError(f"in_position_um must be above 0 and at most {longest_um:g}")
        if self.steps_per_mm is not None and 500.0 / self.steps_per_mm > self.in_position_um:
            raise StageUsageError("half a step is more than in_position_um; no target could be reached for sure")
        if self.approach and self.approach.speed_mm_s > self.speed_mm_s:
            raise StageUsageError(
                f"the approach at {self.approach.speed_mm_s:g} mm/s is faster than the axis at"
                f" {self.speed_mm_s:g} mm/s; is one of both speed_mm_s a slip?"
            )
        if self.approach and not self.approach.distance_mm < high - low:
            raise StageUsageError(
                "the approach distance must be positive and shorter than the way between the limits"
            )
        return self
