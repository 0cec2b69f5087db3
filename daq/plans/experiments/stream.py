"""The stream: frames as fast as the camera gives them, nothing moves; what a flow measurement is.

    experiment: stream
    view: glass
    frames: 1200

The rate is the camera's (AcquisitionFrameRate, or an outer trigger), and pairs are found by id and time stamp.
"""

from collections.abc import Iterator
from typing import Literal

from daq.bench.bench_file import Bench
from daq.plans.plan_table import PlanTable, Pose, View


class StreamPlan(PlanTable):
    """A stream of frames at one place."""

    experiment: Literal["stream"]
    view: View

    @property
    def shows(self) -> str:
        """Whatever flows; on the simulated bench the particle sheet."""
        return "particles"

    def poses(self, bench: Bench) -> Iterator[Pose]:
        """Yield the only pose."""
        yield Pose(f"stream_{self.view}", view=self.view)
