"""A stop holds, wherever it falls: between legs, while settling, between retries, while another waits its turn."""

import threading

import pytest

from sim.emulators.faults import Fault
from sim.mechanics.clock import VirtualClock
from sim.stages import SimulatedStages
from stages.config import StagesTable
from stages.errors import MotionStopped, NoReply, Obstructed, StageError
from stages.stage import Stage
from stages.states import NEXT, AxisState, Event, after
from stages.stop_latch import StopLatch
from tests.slow_cases import slow
from tests.stages.benches import screws
from tests.stages.mixed import paper_bench

pytestmark = pytest.mark.filterwarnings("ignore:.* is moved by:RuntimeWarning")


def moments(first_s, last_s, count):
    """So many moments, every second of which is left to the slow suite."""
    every = [first_s + (last_s - first_s) * n / (count - 1) for n in range(count)]
    return [slow(after_s) if number % 2 else after_s for number, after_s in enumerate(every)]


@pytest.mark.parametrize("after_s", moments(0.0, 3.2, 25))
def test_nothing_moves_after_a_stop_at_any_moment_of_a_move(bench, kind, after_s):
    """Two axes, two legs each, settling in between; from the other axis' first leg to the end."""
    made = bench(kind, settle_s=0.5).homed({"a": 40.0, "b": 40.0})
    stopped_s = made.clock.now_s() + after_s
    made.clock.at(stopped_s, made.stage.stop)
    try:
        made.stage.move({"a": 25.0, "b": 25.0})
        ended = True
    except MotionStopped:
        ended = False
    assert not ended
    assert made.clock.now_s() - stopped_s < 0.6  # braking from 20 mm/s takes 0.2 s
    rests_mm = made.world.true_mm("a"), made.world.true_mm("b")
    for again in (
        lambda: made.stage.move({"b": 30.0}),
        made.stage.home,
        lambda: made.stage.axis("a").move_by(1.0),
    ):
        with pytest.raises(MotionStopped, match="clear"):
            again()
    made.clock.sleep_s(20.0)
    assert (made.world.true_mm("a"), made.world.true_mm("b")) == rests_mm
    made.stage.clear_stop()
    made.stage.move({"a": 30.0, "b": 30.0})


def test_a_stop_ends_the_retries(bench, kind, mocker):
    made = bench(kind).homed()
    mocker.patch.object(
        made.controller, "rest_position_mm", side_effect=lambda channel: 1.0
    )  # never where it was sent
    begin, begun = made.controller.start_move, []

    def third_is_stopped(*motion):
        begun.append(motion)
        if len(begun) == 3:  # the second attempt
            made.stage.stop()
        begin(*motion)

    mocker.patch.object(made.controller, "start_move", side_effect=third_is_stopped)
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 40.0})
    assert len(begun) == 3


def test_a_halt_ends_what_has_begun_and_no_more(bench, kind):
    made = bench(kind).homed()
    made.clock.at(made.clock.now_s() + 0.5, made.stage.halt)
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 100.0, "b": 40.0})
    made.stage.move({"a": 40.0})


def test_no_byte_that_moves_is_written_between_a_stop_and_its_clearing(bench, driver, mocker):
    """The stop falls between the look at the latch and the write: the gate has to hold it up, or the byte."""
    made = bench(driver).homed()
    latch, order, stoppers = made.stage.latch, [], []
    gate_held = threading.Event()
    written = made.controller.port.write

    def slow_write(data):
        if latch._gate._is_owned():  # a byte that moves is under way: another thread stops right now
            stoppers.append(threading.Thread(target=stop))
            stoppers[-1].start()
            gate_held.wait(1.0)
            order.append("moves")
            written(data)
            return
        written(data)

    def stop():
        gate_held.set()
        latch.stop()
        order.append("stop")

    mocker.patch.object(made.controller.port, "write", side_effect=slow_write)
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 40.0})
    for stopper in stoppers:
        stopper.join()
    assert order == ["moves", "stop"]


@pytest.fixture
def paper():
    clock = VirtualClock()
    table = StagesTable.model_validate(paper_bench())
    world = SimulatedStages(table, clock, screws(table))
    with world.in_process() as offered, Stage.open(offered, clock) as stage:
        yield stage, world


class NeverBothHigh:
    """Keep-out in one line: glass_x and camera_x must never both be beyond 50 mm."""

    def check(self, way):
        for piece in way:
            at_mm = {**piece.others_mm, piece.axis: piece.end_mm}
            if at_mm["glass_x"] > 50.0 and at_mm["camera_x"] > 50.0:
                raise Obstructed("both are high")


@pytest.mark.parametrize("direct", [False, True])
def test_two_moves_at_once_are_judged_one_after_the_other(paper, direct):
    """Each is allowed from where things are, both together are not; also for whoever takes an axis by itself."""
    stage, world = paper
    stage.home()
    for _ in range(5):
        stage.guard = None
        stage.move({"glass_x": 10.0, "camera_x": 10.0})
        stage.guard = NeverBothHigh()
        failures, start = [], threading.Barrier(2)

        def go(name, failures=failures, start=start):
            start.wait()
            try:
                if direct:
                    stage.axis(name).move_to(90.0)
                else:
                    stage.move({name: 90.0})
            except StageError as failure:
                failures.append(failure)

        threads = [threading.Thread(target=go, args=(name,)) for name in ("glass_x", "camera_x")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(failures) == 1
        assert isinstance(failures[0], Obstructed)
        assert sum(world.true_mm(name) > 50.5 for name in ("glass_x", "camera_x")) == 1


def test_a_stop_ends_a_move_that_waits_its_turn(paper):
    stage, world = paper
    stage.home()
    before_mm, failures = world.true_mm("camera_x"), []

    def wait_and_move():
        try:
            stage.move({"camera_x": 90.0})
        except MotionStopped as failure:
            failures.append(failure)

    with stage._turn.lock:  # somebody moves
        waiting = threading.Thread(target=wait_and_move)
        waiting.start()
        while waiting.is_alive() and not stage.latch.count:
            stage.stop()
        stage.clear_stop()
    waiting.join()
    assert failures or world.true_mm("camera_x") == pytest.approx(90.0, abs=0.1)
    if failures:
        assert world.true_mm("camera_x") == before_mm


def test_the_latch_is_a_latch():
    latch = StopLatch()
    token = latch.begin()
    latch.check(token)
    latch.halt()
    with pytest.raises(MotionStopped, match="halted"):
        latch.check(token)
    token = latch.begin()
    latch.stop("a person said so")
    for ask in (latch.begin, lambda: latch.check(token), lambda: latch.gate(token).__enter__()):
        with pytest.raises(MotionStopped, match="a person said so"):
            ask()
    latch.clear()
    with pytest.raises(MotionStopped):
        latch.check(token)  # what was begun before the stop stays ended
    with latch.gate(latch.begin()):
        pass


def test_the_table_of_states_is_whole():
    assert set(NEXT) == set(AxisState)
    for state in AxisState:
        assert after(state, Event.CUT) is AxisState.LOST
        for event in Event:
            if event is not Event.CUT and event not in NEXT[state]:
                with pytest.raises(ValueError, match=state.value):
                    after(state, event)
    reachable, new = set(), {AxisState.LOST}
    while new:
        reachable |= new
        new = {state for known in reachable for state in NEXT[known].values()} - reachable
    assert reachable == set(AxisState)


def test_a_stop_that_overtakes_a_command_is_said_again_although_no_answer_comes(bench):
    """On a Grbl board a cancel before the jog line is read does nothing; here the answer is two seconds late."""
    made = bench("grbl").homed({"a": 60.0})
    begin = made.controller._transact

    def stop_behind_the_jog(data, *rest, **named):
        if data.startswith(b"$J"):
            made.line.hooks.press(len(data), "byte", made.stage.stop, lambda: made.stage.latch._gate._is_owned())
            made.line.faults.strike(Fault("late", delay_s=2.0))
        return begin(data, *rest, **named)

    made.controller._transact = stop_behind_the_jog
    here_mm = made.world.true_mm("a")
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 10.0})
    assert abs(made.world.true_mm("a") - here_mm) < 0.5


@pytest.mark.parametrize("after_s", [0.02, 0.3, 0.7])
def test_a_stop_at_a_mute_box_whose_one_word_is_lost_is_a_stop(bench, after_s):
    """An isel says nothing but the end of a motion: a person stops it, and the character is lost."""
    made = bench("isel_dnc").homed({"a": 40.0})

    def pressed():
        made.line.faults.strike(Fault("lost", 2.0))
        made.line.emulator.person_stops()

    made.clock.at(made.clock.now_s() + after_s, pressed)
    with pytest.raises(MotionStopped, match="stopped short of its target"):
        made.stage.move({"a": 20.0})
    rests_mm = made.world.true_mm("a")
    made.clock.sleep_s(30.0)
    assert made.world.true_mm("a") == rests_mm
    assert made.stage.is_held
    made.stage.clear_stop()
    made.stage.move({"a": 20.0})


def test_a_question_unanswered_before_a_move_is_no_stop(bench, mocker):
    """Nothing was sent that moves: a place that homing has left behind says nothing of a person."""
    made = bench("isel_dnc").homed({"a": 40.0})
    made.stage.home()
    confirm_reference, lost = made.controller.confirm_reference, [NoReply("lost"), None]

    def once_mute(channel):
        if failure := lost.pop(0) if lost else None:
            raise failure
        confirm_reference(channel)

    mocker.patch.object(made.controller, "confirm_reference", once_mute)
    made.stage.move({"a": 60.0})
    assert made.stage.where_mm()["a"] == pytest.approx(60.0, abs=0.01)
    assert not made.stage.is_held


def test_one_look_at_rest_after_a_stop_is_not_believed(bench, kind, mocker):
    """A command that was under way begins behind the first look: it has to be stopped again."""
    made = bench(kind).homed()
    axis, token = made.stage.axis("a"), made.stage.latch.begin()
    looks = [False, False, True, False, False, False]  # it begins to move behind the second look
    asked, stops = [], []
    mocker.patch.object(made.controller, "moving", side_effect=lambda channel: (asked.append(1), looks.pop(0))[1])
    mocker.patch.object(made.controller, "stop", side_effect=lambda: stops.append(1))
    made.stage.latch.stop("a person")
    with pytest.raises(MotionStopped):
        axis._wait(5.0, token)
    assert (len(asked), len(stops)) == (6, 6)
