"""How things stand for a laser: every axis has to rest, not one of them, whichever was asked last."""

from types import SimpleNamespace

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.opened import OpenBench
from daq.runner.laser_session import LaserSession
from daq.timing.errors import NotArmed
from daq.timing.states import LaserState
from sim.mechanics.clock import VirtualClock
from tests.daq.small_bench import write_bench
from tests.daq.timing.armed_laser import armed


class Asked:
    """Axes that say where they are, or None while they move."""

    def __init__(self, places):
        self.places = dict(places)

    def where_mm(self, only=None):
        return {name: self.places[name] for name in (self.places if only is None else only)}


@pytest.fixture
def stage_and_light(tmp_path):
    bench = load_bench(write_bench(tmp_path))
    stage = Asked(bench.home_mm | {"target_z": -30.0})
    hardware = OpenBench(bench, {"stages": stage}, {}, VirtualClock(), None)
    return stage, LaserSession(hardware, SimpleNamespace(path=tmp_path), None, None)


def test_one_axis_that_moves_is_no_rest_whichever_it_is(stage_and_light):
    stage, light = stage_and_light
    assert light._conditions(lambda: True, True).at_rest
    for name, mm in stage.places.items():
        stage.places[name] = None
        found = light._conditions(lambda: True, True)
        assert not found.at_rest, name
        assert found.sheet_clearance_mm is None
        stage.places[name] = mm


def test_while_it_fires_every_axis_has_its_turn_and_what_it_said_is_kept(stage_and_light):
    stage, light = stage_and_light
    light._conditions(lambda: True, True)
    count, (first, *_) = len(stage.places), stage.places
    stage.places[first] = None
    found = [light._conditions(lambda: True, False).at_rest for _ in range(count)]
    assert found == [False] * count  # the first one asked; the others rest, and that is not enough
    stage.places[first] = 0.0
    assert light._conditions(lambda: True, False).at_rest
    last = list(stage.places)[-1]
    stage.places[last] = None
    found = [light._conditions(lambda: True, False).at_rest for _ in range(count)]
    assert not all(found)  # within one round


def test_a_motion_that_began_and_ended_while_the_box_was_asked_is_found_before_it_fires(stage_and_light):
    """Found by the fuzz: what was stated before the box was read back was believed after it."""
    stage, light = stage_and_light
    laser, box, _ = armed()
    laser.disarm()
    light._code = laser.challenge
    confirm = box.confirm

    def slow_confirm(*arguments, **options):
        confirm(*arguments, **options)
        stage.places["target_z"] = -0.5  # somebody has moved it into the sheet meanwhile, and it rests

    box.confirm = slow_confirm
    with pytest.raises(NotArmed, match="mm from the sheet"):
        light.fire(laser, 5, lambda: True)
    assert laser.state is LaserState.READY
    assert box.fired == 0
