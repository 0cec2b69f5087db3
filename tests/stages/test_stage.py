"""Axes over a mix of controllers: orders, checks before motion, stopping everything, closing everything."""

from contextlib import suppress

import pytest

from ground.config import Document, validate
from ground.errors import ConfigError
from sim.mechanics.clock import VirtualClock
from sim.stages import SimulatedStages
from stages.config import StagesTable
from stages.errors import (
    DeviceLost,
    NotInPosition,
    NotReferenced,
    Obstructed,
    OutOfRange,
    PortUnavailable,
    StageError,
    StageUsageError,
)
from stages.stage import Stage
from stages.states import AxisState
from tests.loops import loop_over
from tests.stages.benches import screws
from tests.stages.mixed import paper_bench


@pytest.fixture
def paper():
    clock = VirtualClock()
    table = StagesTable.model_validate(paper_bench())
    world = SimulatedStages(table, clock, screws(table))
    with world.in_process() as offered, Stage.open(offered, clock) as stage:
        yield stage, world, clock


def test_the_stages_of_the_paper_home_in_order_and_go_where_they_are_sent(paper):
    stage, world, _ = paper
    homed = []
    for name, part in stage.axes.items():
        part.home = lambda name=name, home=part.home: (homed.append(name), home())
    stage.home()
    # the board homes its three axes with one command, when the first of them is due
    assert homed == ["glass_z", "glass_y", "glass_x", "target_z", "rail_z", "camera_x", "camera_y"]
    assert all(part.state is AxisState.READY for part in stage.axes.values())
    middle_mm = {name: 0.5 * sum(part.settings.limits_mm) for name, part in stage.axes.items()}
    stage.move(middle_mm)
    datum_mm = {name: world.true_mm(name) for name in stage.axes}
    moved_mm = {name: place + 12.345 for name, place in middle_mm.items()}
    arrivals = stage.move(moved_mm)
    for name, arrival in arrivals.items():
        assert world.true_mm(name) - datum_mm[name] == pytest.approx(12.345, abs=0.010)
        assert abs(arrival.error_um) <= 10.0
    assert stage.where_mm() == pytest.approx(moved_mm, abs=0.010)


def test_estimated_durations_are_those_of_the_simulated_world(paper):
    stage, _, clock = paper
    stage.home()
    stage.move({"rail_z": 100.0, "glass_x": 10.0})
    for targets_mm in ({"rail_z": 900.0}, {"glass_x": 60.0}, {"glass_x": 59.0}):
        here_mm = {name: place for name, place in stage.where_mm().items() if place is not None}
        begun_s = clock.now_s()
        stage.move(targets_mm)
        assert clock.now_s() - begun_s == pytest.approx(stage.duration_s(here_mm, targets_mm), rel=0.1, abs=0.35)


def test_nothing_moves_if_one_target_is_impossible(paper):
    stage, world, _ = paper
    stage.home()
    before_mm = {name: world.true_mm(name) for name in stage.axes}
    with pytest.raises(OutOfRange, match="camera_y"):
        stage.move({"rail_z": 500.0, "glass_x": 20.0, "camera_y": 101.0})
    with pytest.raises(StageUsageError, match="no axis 'camera_q'"):
        stage.move({"rail_z": 500.0, "camera_q": 1.0})
    assert {name: world.true_mm(name) for name in stage.axes} == before_mm


def test_one_lost_controller_stops_the_others_and_spares_their_references(paper):
    stage, world, _ = paper
    stage.home()
    world.lines["glass"].unplug()
    with pytest.raises(DeviceLost):
        stage.move({"camera_x": 20.0, "glass_x": 30.0})
    assert stage.axis("glass_x").state is AxisState.LOST
    assert stage.axis("camera_x").state is AxisState.READY
    stage.stop_quietly()
    stage.clear_stop()
    stage.move({"camera_x": 30.0})
    where_mm = stage.where_mm()
    assert where_mm["glass_x"] is None
    assert where_mm["camera_x"] == pytest.approx(30.0, abs=0.01)


def test_stop_reaches_every_controller_even_if_one_fails(paper, mocker):
    stage, _, _ = paper
    told = [mocker.patch.object(box, "stop") for box in stage.controllers.values()]
    told[0].side_effect = DeviceLost("gone")
    with pytest.raises(DeviceLost):
        stage.stop()
    assert all(call.call_count == 1 for call in told)


def test_a_board_that_homes_everything_must_be_asked_for_everything(paper):
    stage, world, _ = paper
    before_mm = world.true_mm("target_y")
    with pytest.raises(StageUsageError, match=r"also homes target_y, target_z"):
        stage.home(["target_x"])
    assert world.true_mm("target_y") == before_mm
    stage.home(["target_x", "target_y", "target_z"])
    assert stage.axis("target_y").state is AxisState.READY
    assert stage.axis("rail_z").state is AxisState.UNREFERENCED
    with pytest.raises(StageUsageError, match="there is no axis"):
        stage.home(["nobody"])


def test_a_guard_sees_the_whole_way_before_anything_moves(paper):
    stage, world, _ = paper
    seen = []

    class Guard:
        def check(self, way):
            seen.extend(way)
            raise Obstructed("a lens is in the way")

    stage.guard = Guard()
    with pytest.raises(NotReferenced, match="keep-out"):
        stage.move({"camera_x": 1.0})
    stage.guard = None
    stage.home()
    stage.move({"camera_x": 50.0, "glass_x": 50.0})
    stage.guard, before_mm = Guard(), world.true_mm("camera_x")
    with pytest.raises(Obstructed):
        stage.move({"glass_x": 40.0, "camera_x": 20.0})
    assert world.true_mm("camera_x") == before_mm
    assert [(piece.axis, round(piece.end_mm, 6)) for piece in seen] == [
        ("camera_x", 19.5), ("camera_x", 20.0), ("glass_x", 39.5), ("glass_x", 40.0),
    ]  # fmt: skip
    assert seen[2].others_mm["camera_x"] == 20.0


def test_ports_are_closed_whatever_happens(mocker):
    table = StagesTable.model_validate(paper_bench())
    clock = VirtualClock()
    world = SimulatedStages(table, clock, screws(table))
    with world.in_process() as offered:
        world.lines["target"].unplug()
        with pytest.raises(PortUnavailable):
            Stage.open(offered, clock)
        assert not any(line.is_opened for line in world.lines.values())
        world.lines["target"].plug_in()
        closed = []
        with pytest.raises(ZeroDivisionError), Stage.open(offered, clock) as stage:  # noqa: PT012
            for name, box in stage.controllers.items():
                mocker.patch.object(
                    box, "close", side_effect=lambda name=name, close=box.close: (closed.append(name), close())
                )
            _ = 1 / 0
    assert closed == ["target", "glass", "rail", "camera"]
    assert not any(line.is_opened for line in world.lines.values())


@loop_over(
    "change, sentence",
    [
        (lambda t: t["axes"]["rail_z"].pop("limits_mm"), "limits_mm' is missing"),
        (lambda t: t["axes"]["rail_z"].update(limits_mm=[0.0, 0.0]), "never means no limit"),
        (lambda t: t["axes"]["rail_z"].update(speed_mm=3.0), "did you mean 'speed_mm_s'"),
        (lambda t: t["axes"]["rail_z"].update(in_position_um=20.0), "in_position_um"),
        (lambda t: t["axes"]["rail_z"].update(controller="nobody"), "unknown controller 'nobody'"),
        (lambda t: t["axes"]["glass_x"].update(channel="2"), "shares its channel"),
        (lambda t: t["home_order"].pop(), "home_order must name every axis once"),
        (lambda t: t["controllers"]["rail"].update(driver="isel"), "driver 'isel' is unknown"),
        (lambda t: t["controllers"]["rail"].update(driver="math:sqrt"), "is not a Controller"),
        (lambda t: t["controllers"]["rail"].update(driver="no.such:Thing"), "cannot be imported"),
    ],
)
def test_a_bench_file_that_makes_no_sense_is_refused_in_one_sentence(change, sentence):
    tree = paper_bench()
    change(tree)
    with pytest.raises(ConfigError, match=sentence.replace("(", r"\(")):
        validate(Document("bench.yaml", tree), StagesTable)


def test_scales_are_demanded_and_refused_where_they_belong():
    tree = paper_bench()
    del tree["axes"]["rail_z"]["steps_per_mm"]
    with pytest.raises(StageError, match="needs steps_per_mm"):
        Stage(StagesTable.model_validate(tree))
    tree = paper_bench()
    tree["axes"]["glass_x"]["steps_per_mm"] = 1000.0
    with pytest.raises(StageError, match="remove steps_per_mm"):
        Stage(StagesTable.model_validate(tree))


@pytest.mark.parametrize("by_error", [False, True])
def test_leaving_the_bench_stops_what_another_thread_still_moves(bench, driver, by_error):
    """The block ends while something moves: by itself, or by an error."""
    made = bench(driver).homed({"a": 40.0})
    box, axis = made.controller, made.stage.axis("a").settings
    with suppress(ZeroDivisionError), made.stage:
        box.token = made.stage.latch.begin()
        far_mm = (110.0 - axis.offset_mm) * axis.sign
        box.start_move(axis.channel, far_mm, 20.0, 100.0)
        made.clock.sleep_s(0.5)
        if by_error:
            _ = 1 / 0
    left_mm = made.world.true_mm("a")
    made.clock.sleep_s(10.0)
    assert 41.0 < left_mm < 60.0
    assert made.world.true_mm("a") < left_mm + 5.0  # a short way of braking


def test_an_axis_that_rests_a_millimetre_off_has_not_arrived(bench, mocker):
    made = bench("zaber_ascii", in_position_um=10.0, retries=1).homed({"a": 40.0})
    known = made.controller.rest_position_mm
    for off_mm, arrives in ((0.006, True), (0.014, False), (1.0, False)):
        mocker.patch.object(
            made.controller, "rest_position_mm", side_effect=lambda channel, off=off_mm: known(channel) + off
        )
        if arrives:
            assert made.stage.move({"a": 45.0})["a"].error_um == pytest.approx(6.0, abs=3.0)
        else:
            with pytest.raises(NotInPosition, match="um from its target"):
                made.stage.move({"a": 50.0})
        mocker.stopall()
