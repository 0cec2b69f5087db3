"""The stream: frames as fast as the camera gives them, nothing moves; what a flow measurement is.

    experiment: stream
    view: glass
    frames: 1200
    group: 2                # frames that belong together: 2 for pairs
    gaps_at_most: 0.1       # share of the frames that may be lost before the stream is ended

The rate is the camera's (AcquisitionFrameRate, or an outer trigger), and pairs are found by id and time stamp.

A flow cannot be had again, so a stream keeps every frame that it has: what is lost stays an empty place, and a
stream that was interrupted goes on behind its last frame, with a whole group.  Pairs stay pairs by that, and one
that lost a frame is found by its gap.  When more is lost at one go than `gaps_at_most`, something is wrong with
link, disk or computer: the stream ends with the reason, and can be resumed when that is cured.  With
``gaps_at_most: 0`` it has to be whole, and is taken again from the start.
"""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from daq.bench.bench_table import Bench
from daq.plans.plan_table import PlanTable, Pose, View


class StreamPlan(PlanTable):
    """A stream of frames at one place."""

    experiment: Literal["stream"]
    view: View
    group: Annotated[int, Field(ge=1, le=1000)] = 2
    gaps_at_most: Annotated[float, Field(ge=0.0, le=1.0)] = 0.1

    @property
    def shows(self) -> str:
        """Whatever flows; on the simulated bench the particle sheet."""
        return "particles"

    @property
    def frames_together(self) -> int:
        """As the plan says."""
        return self.group

    @property
    def share_of_gaps(self) -> float:
        """As the plan says."""
        return self.gaps_at_most

    def poses(self, bench: Bench) -> Iterator[Pose]:
        """Yield the only pose."""
        yield Pose(f"stream_{self.view}", view=self.view)
