"""A bench of two axes on one controller, for any driver, with its simulated world."""

from contextlib import ExitStack
from dataclasses import dataclass, field

import pytest

from sim.emulators.faults import FaultSchedule
from sim.emulators.line import Line
from sim.mechanics.clock import VirtualClock
from sim.stages import SimulatedStages
from stages.config import StagesTable
from stages.controller import Controller
from stages.drivers_by_name import DRIVERS, FOREIGN
from stages.stage import Stage
from tests.stages.benches import beside_marks, screws, stages_table
from tests.watched_benches import witnesses  # noqa: F401 - a fixture


@dataclass
class Bench:
    """Stage, world and clock of a test."""

    stage: Stage
    world: SimulatedStages
    clock: VirtualClock
    line: Line
    table: StagesTable
    opened: list[Stage] = field(default_factory=list)

    @property
    def controller(self):
        return self.stage.controllers["box"]

    @property
    def sent(self):
        """How much has been said to the box: bytes, or motions asked of a library."""
        if isinstance(self.controller, Controller):
            return sum(len(chunk.data) for chunk in self.controller.port.trace if chunk.sent)
        return len(self.line.emulator.called)

    def homed(self, targets_mm: dict[str, float] | None = None) -> "Bench":
        """Home all axes, move to targets if there are some, and return the bench."""
        self.stage.home()
        if targets_mm:
            self.stage.move(targets_mm)
        return self

    def again(self) -> Stage:
        """A new program on the same devices."""
        self.stage.close()
        self.stage = Stage.open(self.table, self.clock)
        self.opened.append(self.stage)
        return self.stage


@pytest.fixture
def bench():
    """Factory of benches; every stage is closed at the end."""
    made: list[Bench] = []
    up = ExitStack()

    def make(
        driver: str,
        faults=(),
        seed: int = 0,
        backlash_um: float = 50.0,
        sim=None,
        firmware=None,
        box=None,
        **changes,
    ) -> Bench:
        clock = VirtualClock()
        table = stages_table(driver, box, **changes)
        built = screws(table, backlash_um=backlash_um, **(sim or {}))
        if "power_up_mm" not in (sim or {}):
            built = beside_marks(built, driver)
        schedule = faults if isinstance(faults, FaultSchedule) else FaultSchedule(faults, seed)
        world = SimulatedStages(table, clock, built, {"box": firmware or {}}, {"box": schedule})
        table = up.enter_context(world.in_process())
        stage = Stage(table, clock)
        result = Bench(stage, world, clock, world.lines["box"], table, [stage])
        made.append(result)
        stage.connect("box")
        return result

    yield make
    for result in made:
        for stage in result.opened:
            stage.close()
    up.close()


def pytest_generate_tests(metafunc):
    """`driver`: what speaks bytes; `kind`: whatever moves."""
    if "driver" in metafunc.fixturenames:
        metafunc.parametrize("driver", DRIVERS)
    if "kind" in metafunc.fixturenames:
        metafunc.parametrize("kind", [*DRIVERS, *FOREIGN])
