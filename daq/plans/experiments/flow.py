"""A flow, lit by a double-pulse laser: pairs of frames a short time apart.

    experiment: flow
    view: glass
    laser: laser                # name of the timing unit under `devices` of the bench file; left out, another
                                # program's synchroniser triggers laser and camera, and dt_us is what was set there
    pairs: 1000
    dt_us: 80.0                 # between the two pulses of a pair
    rate_hz: 10.0               # pairs a second
    cameras: [behind]           # further cameras of the bench that take the same pairs (plans.experiments.flow)
    chunk: 100                  # pairs fired in one go, at most 10 s: so many follow a computer that dies
    warm_up_s: 600.0            # at least; the laser's own time counts as well
    background: {pairs: 50}     # a short step before the seeding is opened
    target_z_mm: -30.0          # where the target waits, out of the light sheet
    glass_z_mm: 4.0             # how far the glass stands off its place in the scene, so that the sheet is free
    lost_at_most: 0.1           # share of the fired pairs that may be lost before the run is ended
    dt_measured_us: 80.2        # if it was measured at this setting, such as with a photodiode
    dt_sigma_us: 0.05

Only whole pairs that are sure are kept (runner.pair_finder).  A pair that was fired and lost is counted and fired
again, for a flow goes on; so a step has no gaps, and the time of every pair stands in its record.  The operator
types the code that the laser asks for once a run; it stands in no file.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field, model_validator

from daq.bench.bench_table import Bench
from daq.bench.elements import CAMERA
from daq.plans.plan_table import PlanTable, Pose, View
from daq.plans.pulse_order import PulseOrder, check_pulses, check_same_trigger
from ground.config import Name, Table
from ground.plain_words import slip
from ground.usual import Usual
from stages.profile import Positive

MOST_PAIRS = 1_000_000
LONGEST_CHUNK_S = 10.0


class BackgroundTable(Table):
    """Pairs before the seeding is opened."""

    pairs: Annotated[int, Field(ge=1, le=MOST_PAIRS)]


class FlowPlan(PlanTable):
    """A flow run."""

    experiment: Literal["flow"]
    view: View
    laser: Name | None = None
    cameras: Annotated[list[Name], Field(max_length=8)] = Field(default_factory=list)
    pairs: Annotated[int, Field(ge=1, le=MOST_PAIRS)]
    dt_us: Annotated[Positive, Usual(0.2, 1e5)]
    rate_hz: Annotated[Positive, Usual(0.2, 1e4)]
    chunk: Annotated[int, Field(ge=1, le=100_000)] | None = None
    warm_up_s: Annotated[Annotated[float, Field(ge=0.0, le=7200.0)], Usual(0.0, 3600.0)] = 0.0
    background: BackgroundTable | None = None
    target_z_mm: float = 0.0
    glass_z_mm: float = 0.0
    lost_at_most: Annotated[float, Field(ge=0.0, le=1.0)] = 0.1
    dt_measured_us: Positive | None = None
    dt_sigma_us: Annotated[float, Field(ge=0.0)] | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> "FlowPlan":
        if "frames" in self.model_fields_set:
            raise ValueError("a flow is planned in pairs; set pairs instead of frames")
        if self.laser is None and "warm_up_s" in self.model_fields_set:
            raise ValueError("warm_up_s belongs to a laser; leave it out where another program triggers it")
        if self.dt_sigma_us is not None and self.dt_measured_us is None:
            raise ValueError("dt_sigma_us belongs to a dt_measured_us; set both or none")
        if self.dt_measured_us is not None and not 0.5 <= self.dt_measured_us / self.dt_us <= 2.0:
            hint = slip("dt_measured_us", self.dt_measured_us, 0.5 * self.dt_us, 2.0 * self.dt_us)
            raise ValueError(
                f"dt_measured_us {self.dt_measured_us:g} is another time than dt_us {self.dt_us:g}{hint}"
            )
        if len(set(self.cameras)) < len(self.cameras) or CAMERA in self.cameras:
            raise ValueError(f"cameras names a camera twice; {CAMERA} is always included")
        return self

    @property
    def shows(self) -> str:
        """Whatever flows."""
        return "flow"

    @property
    def frames_together(self) -> int:
        """Two to a pair."""
        return 2

    @property
    def further_cameras(self) -> tuple[str, ...]:
        """As the plan says."""
        return tuple(self.cameras)

    @property
    def order(self) -> PulseOrder:
        """Pulses that are asked of the laser."""
        chunk = max(1, min(self.pairs, int(LONGEST_CHUNK_S * self.rate_hz))) if self.chunk is None else self.chunk
        return PulseOrder(
            self.laser, self.dt_us, self.rate_hz, chunk, self.warm_up_s, self.lost_at_most, False,
            self.dt_measured_us, self.dt_sigma_us,
        )  # fmt: skip

    def poses(self, bench: Bench) -> Iterator[Pose]:
        """Yield the background if there is one, then the flow."""
        order, target_mm, glass_mm = self.order, (0.0, 0.0, self.target_z_mm), (0.0, 0.0, self.glass_z_mm)
        check_pulses(bench, order)
        for name in self.cameras:
            check_same_trigger(bench, name, order)
        if self.background is not None:
            before = replace(order, is_background=True)
            tag, frames = f"background_{self.view}", 2 * self.background.pairs
            yield Pose(tag, target_mm, self.view, frames=frames, pulses=before, glass_mm=glass_mm)
        tag = f"flow_{self.view}"
        yield Pose(tag, target_mm, self.view, frames=2 * self.pairs, pulses=order, glass_mm=glass_mm)
