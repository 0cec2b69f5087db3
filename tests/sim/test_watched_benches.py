"""The fixture that watches every test sees what happens on its benches: these tests fail if it does not."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from sim.mechanics.clock import VirtualClock
from sim.stages import SimulatedStages
from stages.stage import Stage
from tests.stages.benches import screws, stages_table

TESTS = Path(__file__).resolve().parents[1]
MAKES_BENCH = re.compile(
    r"from sim\.(stages|rehearsed|watched_world|witness)|Simulated(Stages|Bench)|[-\"]-simulate\b|simulate=True"
)
BEYOND = """
from sim.mechanics.clock import VirtualClock
from sim.stages import SimulatedStages
from tests.stages.benches import screws, stages_table
table, clock = stages_table("zaber_ascii"), VirtualClock()
world = SimulatedStages(table, clock, screws(table))
world.lines["box"].send(b"/1 1 move abs 49000\\n")
clock.sleep_s(100.0)
assert world.witness.judge()
"""


@pytest.fixture
def made():
    table, clock = stages_table("zaber_ascii"), VirtualClock()
    world = SimulatedStages(table, clock, screws(table))
    with world.in_process() as offered:
        yield world, clock, offered


def drive(world, clock, command):
    world.lines["box"].send(command)
    clock.sleep_s(100.0)


@pytest.mark.provokes("limit")
def test_a_motion_beyond_its_limits(made):
    world, clock, _ = made
    drive(world, clock, b"/1 1 move abs 49000\n")


@pytest.mark.provokes("limit")
def test_a_motion_in_another_process():
    subprocess.run([sys.executable, "-c", BEYOND], check=True)


@pytest.mark.provokes("stop")
def test_a_motion_after_a_stop(made):
    world, clock, offered = made
    with Stage.open(offered, clock) as stage:
        stage.stop()
        clock.sleep_s(1.0)
        drive(world, clock, b"/1 1 move abs 4000\n")


def test_a_motion_after_a_stop_that_is_cleared(made):
    world, clock, offered = made
    with Stage.open(offered, clock) as stage:
        stage.stop()
        clock.sleep_s(1.0)
        stage.clear_stop()
        drive(world, clock, b"/1 1 move abs 4000\n")


def test_a_stop_of_another_program_is_over_with_it(made):
    world, clock, offered = made
    with Stage.open(offered, clock) as stage:
        stage.stop()
        clock.sleep_s(1.0)
    with Stage.open(offered, clock):
        drive(world, clock, b"/1 1 move abs 4000\n")


def test_folders_with_benches_import_the_witness():
    watched = [path.parent for path in TESTS.rglob("conftest.py") if "witnesses" in path.read_text("utf-8")]
    making = [path for path in TESTS.rglob("test_*.py") if MAKES_BENCH.search(path.read_text("utf-8"))]
    unwatched = [str(path.relative_to(TESTS)) for path in making if not {*watched} & {*path.parents}]
    assert len(making) > 50
    assert not unwatched, "import tests.watched_benches.witnesses in the conftest.py of their folders"
