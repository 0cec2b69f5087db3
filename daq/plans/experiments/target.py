"""The target run: the bare target, the target behind glass, and z-stacks of either.

    experiment: target
    clear: {z_mm: [0.0, -10.0, -20.0]}    # without glass; 0 is the investigation plane
    glass: {z_mm: [0.0]}                  # through the glass; positive z would drive the target into it
    frames: 2
    settle_s: 0.2

The bare frames come first, so the glass moves out once and in once.
"""

from collections import Counter
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from daq.bench.bench_table import Bench
from daq.plans.plan_table import PlanTable, Pose
from daq.plans.steps import BEHIND_GLASS, CLEAR
from ground.config import Table


class StackTable(Table):
    """Places of the target along z."""

    z_mm: Annotated[list[float], Field(min_length=1, max_length=10_000)]

    @field_validator("z_mm")
    @classmethod
    def _no_height_twice(cls, heights_mm: list[float]) -> list[float]:
        twice = [z for z, count in Counter(f"{z:g}" for z in heights_mm).items() if count > 1]
        if twice:
            raise ValueError(f"names the height {twice[0]} twice; give frames: 2 for more frames of one height")
        return heights_mm


class TargetPlan(PlanTable):
    """A target run."""

    experiment: Literal["target"]
    clear: StackTable | None = None
    glass: StackTable | None = None

    @model_validator(mode="after")
    def _something_to_do(self) -> "TargetPlan":
        if self.clear is None and self.glass is None:
            raise ValueError("set at least one of clear and glass")
        return self

    @property
    def shows(self) -> str:
        """The chessboard."""
        return "chessboard"

    def poses(self, bench: Bench) -> Iterator[Pose]:
        """Yield the clear stack, then the one behind glass."""
        for view, stack in ((CLEAR, self.clear), (BEHIND_GLASS, self.glass)):
            for z_mm in stack.z_mm if stack is not None else []:
                place = f"_z{z_mm:+g}mm" if z_mm else ""
                yield Pose(f"target_{view}{place}", (0.0, 0.0, z_mm), view)
