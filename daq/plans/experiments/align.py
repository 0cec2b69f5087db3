"""The alignment: look at the glass, bring it to its place, look again.

    experiment: align
    target: true              # the board hangs in the picture; without it glass is brought before the camera
    moves: 3                  # at most; 0 looks once and says what it would do
    back_mm: 3.0              # the glass stands so far off the target at the first look
    frames: 1                 # at each look; more lower the noise

Only the first look is where the plan has it, off the target, because the glass may be off in depth as well. Where
the others are is decided by what was seen (runner.alignment_loop), each move judged before it is made.
"""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from daq.bench.bench_table import Bench
from daq.bench.elements import GLASS
from daq.errors import PlanError
from daq.plans.plan_table import PlanTable, Pose
from daq.plans.steps import BEHIND_GLASS
from ground.usual import Usual

LOOK = "look"


class AlignPlan(PlanTable):
    """An alignment."""

    experiment: Literal["align"]
    target: bool = True
    moves: Annotated[int, Field(ge=0, le=10)] = 3
    back_mm: Annotated[Annotated[float, Field(ge=0.0, le=100.0)], Usual(0.5, 20.0)] = 3.0
    frames: Annotated[int, Field(ge=1, le=100)] = 1

    @property
    def shows(self) -> str:
        """The chessboard, where the target hangs."""
        return "chessboard" if self.target else "particles"

    def poses(self, bench: Bench) -> Iterator[Pose]:
        """Yield the first look, and as many as there may be moves; they are aimed later.

        Raises
        ------
        PlanError
            The scene has no glass, or no axis carries any.
        """
        axes = bench.table.axes_of(GLASS)
        if not axes or not bench.scene.spheres:
            raise PlanError("an alignment needs spheres in the scene and axes that carry the glass")
        back = self.back_mm if any(axis.along == "z" for axis in axes.values()) else 0.0
        for number in range(self.moves + 1):
            yield Pose(f"{LOOK}_{number}", view=BEHIND_GLASS, glass_mm=(0.0, 0.0, back))
