"""The watch over a burst: what switches off and how soon; a busy computer is no silent device."""

import math
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from daq.timing.conditions import Rules
from daq.timing.errors import LaserStopped
from daq.timing.pulses import LaserHead
from daq.timing.states import LaserState
from daq.timing.supervisor import BLIND_S, ON_TIME_S, SILENCE_S, LaserSupervisor
from sim.mechanics.clock import ScaledClock
from stages.clock import SYSTEM_CLOCK
from tests.daq.timing.armed_laser import GOOD, armed, conditions_with

ROOT = Path(__file__).resolve().parents[3]
AT_ONCE = {"rules": Rules(warmup_s=0.0), "head": LaserHead(max_rate_hz=1000.0)}


class JumpingClock:
    """The wall's clock of somebody who was not let run for a while: it jumps."""

    def __init__(self):
        self._ahead_s = 0.0

    def jump(self, by_s):
        self._ahead_s += by_s

    def now_s(self):
        return time.monotonic() + self._ahead_s

    def sleep_s(self, duration_s):
        time.sleep(duration_s)


def seconds_to_off():
    """Time from a lost condition to the end of the burst."""
    laser, box, clock = armed(ScaledClock(), **AT_ONCE)
    now = [GOOD]
    laser.fire(90)
    with LaserSupervisor(laser, lambda: now[0], clock, SYSTEM_CLOCK) as supervisor:
        time.sleep(0.3)
        assert laser.state is LaserState.FIRING
        now[0], lost_s = conditions_with(at_rest=False), time.monotonic()
        while box.burst is not None:
            time.sleep(0.001)
        took_s = time.monotonic() - lost_s
        with pytest.raises(LaserStopped, match="moves"):
            supervisor.wait()
    assert laser.state is LaserState.FAULT
    return took_s


def test_the_vigil_switches_off_within_50_ms_of_a_lost_condition():
    assert any(seconds_to_off() < 0.05 for _ in range(5))  # a busy machine is late, but not five times


def test_the_vigil_takes_silence_and_errors_for_lost(mocker):
    mocker.patch("daq.timing.supervisor.SILENCE_S", 0.1)

    def hangs():
        time.sleep(0.6)
        return GOOD

    def fails():
        raise OSError("no camera")

    for ask, words in ((hangs, "no state was reported"), (fails, "no camera")):
        laser, box, clock = armed(ScaledClock(), **AT_ONCE)
        laser.fire(50)
        with LaserSupervisor(laser, ask, clock, SYSTEM_CLOCK):
            time.sleep(0.4)
        assert words in laser.why
        assert box.burst is None


def test_leaving_the_vigil_switches_off():
    laser, box, clock = armed(ScaledClock(), **AT_ONCE)
    laser.fire(50)
    with LaserSupervisor(laser, lambda: GOOD, clock, SYSTEM_CLOCK):
        pass
    assert box.burst is None


def test_a_computer_that_had_no_time_is_not_a_silent_device():
    """Both threads are late by 3 s while a question is under way; the answer comes when they run again."""
    laser, box, clock = armed(ScaledClock(), **AT_ONCE)
    wall, asked, answers = JumpingClock(), threading.Event(), threading.Event()

    def ask():
        asked.set()
        answers.wait(5.0)
        return GOOD

    laser.fire(100)
    with LaserSupervisor(laser, ask, clock, wall):
        asked.wait(5.0)
        wall.jump(3.0 * SILENCE_S)
        time.sleep(0.1)
        assert laser.state is LaserState.FIRING
        answers.set()
        time.sleep(0.1)
        assert laser.state is LaserState.FIRING
        assert box.burst is not None


def test_a_computer_that_has_no_time_for_too_long_does_not_watch():
    laser, box, clock = armed(ScaledClock(), **AT_ONCE)
    wall, answers = JumpingClock(), threading.Event()

    def ask():
        answers.wait(5.0)
        return GOOD

    laser.fire(100)
    with LaserSupervisor(laser, ask, clock, wall):
        for _ in range(6):
            wall.jump(BLIND_S / 5.0)
            time.sleep(0.03)
        assert "too busy" in laser.why
        assert box.burst is None
        answers.set()


@pytest.mark.parametrize("late_s", [0.0, 0.05])
def test_a_device_that_says_nothing_is_not_excused_by_a_judge_who_is_late_now_and_then(mocker, late_s):
    mocker.patch("daq.timing.supervisor.SILENCE_S", 0.2)
    laser, box, clock = armed(ScaledClock(), **AT_ONCE)
    wall, answers = JumpingClock(), threading.Event()

    def ask():
        answers.wait(10.0)
        return GOOD

    laser.fire(100)
    with LaserSupervisor(laser, ask, clock, wall):
        while laser.state is LaserState.FIRING and clock.now_s() < 9.0:
            time.sleep(0.02)
            wall.jump(late_s)
        assert "camera or stages do not answer" in laser.why
        assert box.burst is None
        answers.set()


def test_answers_that_come_are_no_silence_however_long_it_fires():
    laser, _, clock = armed(ScaledClock(), **AT_ONCE)
    wall = JumpingClock()
    laser.fire(100)
    supervisor = LaserSupervisor(
        laser, lambda: GOOD, clock, wall
    )  # without its threads: asked and judged in turns
    for _ in range(math.ceil(3.0 * SILENCE_S / ON_TIME_S)):
        supervisor.ask()
        wall.jump(ON_TIME_S)
        supervisor.judge()
        assert laser.state is LaserState.FIRING, laser.why
    laser.stop("enough")


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_burst_goes_on_where_the_computer_has_no_time_for_us():
    """The adversary: the whole program is halted for 0.6 s again and again, with 4 ms between."""
    command = [sys.executable, "-m", "tests.daq.timing.starved_laser"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    asked, longest_s, what = done.stdout.split(maxsplit=2)
    assert what.strip() == "done", done.stdout
    assert int(asked) > 3
    assert float(longest_s) > 1.0, "no answer took longer than what a silent device is given: this shows nothing"
