"""The particle-shift experiment: printed particles, moved by a known way between two frames.

    experiment: shift
    views: [clear, glass]                 # the clear pairs are the reference without glass
    displacements:
      - {along: [1.0, 1.0, 0.0], px: 14.0}    # any axis or diagonal; px of the bare view on the plane
      - {along: [0.0, 0.0, -1.0], mm: 0.5}
    repeats: 3

Every displacement has a reference frame of its own, taken right before it, so that slow drift is not taken for
displacement; a step names its reference.  Through the glass, the displacement along z must not drive the sheet
into it.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

from pydantic import Field, model_validator

from daq.bench.bench_table import Bench
from daq.bench.elements import Vector
from daq.plans.plan_table import PlanTable, Pose, Question, View, px_per_mm
from daq.plans.steps import Step
from ground.config import Table, Triple
from ground.usual import Usual, question

DISPLACED_PX = Usual(0.1, 64.0)  # of the bare view: two windows


class DisplacementTable(Table):
    """A way along a direction."""

    along: Triple
    mm: float | None = None
    px: float | None = None

    @model_validator(mode="after")
    def _one_length(self) -> "DisplacementTable":
        if (self.mm is None) == (self.px is None):
            raise ValueError("give exactly one of mm and px")
        if not (self.mm or self.px):
            raise ValueError("a displacement of 0 measures nothing; set another length")
        if not math.hypot(*self.along) > 0.0:
            raise ValueError("along must not be zero in every direction")
        return self

    def vector_mm(self, scale_px_per_mm: float) -> Vector:
        """Displacement in the world."""
        length_mm = self.mm if self.mm is not None else (self.px or 0.0) / scale_px_per_mm
        norm = math.hypot(*self.along)
        x, y, z = (length_mm * part / norm for part in self.along)
        return (x, y, z)


class ShiftPlan(PlanTable):
    """A shift experiment."""

    experiment: Literal["shift"]
    views: Annotated[list[View], Field(min_length=1, max_length=2)]
    displacements: Annotated[list[DisplacementTable], Field(min_length=1, max_length=1000)]
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1

    @model_validator(mode="after")
    def _views_differ(self) -> "ShiftPlan":
        if len(set(self.views)) != len(self.views):
            raise ValueError("views names a view twice")
        return self

    @property
    def shows(self) -> str:
        """The particle sheet."""
        return "particles"

    def poses(self, bench: Bench) -> Iterator[Pose]:
        """Yield a reference and a displaced pose for every displacement, repeat and view."""
        scale, count = px_per_mm(bench), 0
        for view in self.views:
            for repeat in range(self.repeats):
                for number, displacement in enumerate(self.displacements):
                    name = f"particles_{view}_d{number}_r{repeat}"
                    yield Pose(f"{name}_a", view=view)
                    yield Pose(f"{name}_b", displacement.vector_mm(scale), view, reference=count)
                    count += 2

    def questions(self, bench: Bench, steps: Sequence[Step]) -> Iterator[Question]:
        """Ask about ways that no window follows."""
        for number, displacement in enumerate(self.displacements):
            *sideways, _ = displacement.vector_mm(px_per_mm(bench))
            moved_px = max(map(abs, sideways)) * px_per_mm(bench)
            if moved_px and (said := question("moved_px", moved_px, DISPLACED_PX)):
                yield ("displacements", number), f"displacements.{number + 1}: in px of the picture: {said}"
