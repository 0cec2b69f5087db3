"""Things happen between two bytes, and what another thread would do happens when it could."""

import pytest

from sim.emulators.line import Line
from sim.emulators.zaber_ascii import ZaberEmulator
from sim.mechanics.clock import VirtualClock
from sim.mechanics.motion import Mechanics, Motor
from tests.loops import loop_over

ASK = b"/1 1 get pos\n"
ANSWER = b"@01 1 OK IDLE WR 0\r\n"


def new_line():
    clock = VirtualClock()
    return Line(ZaberEmulator({"1/1": Motor(Mechanics())}, clock, checksums=False), clock)


@pytest.fixture
def line():
    return new_line()


def ask(line):
    line.send(ASK)
    line.clock.sleep_s(0.002)
    return line.receive()


def test_counting(line):
    ask(line)
    ask(line)
    assert line.hooks.passed == {"write": 2, "byte": 26, "answer": 2, "answer byte": 40}


@loop_over("byte", range(1, 2 * len(ASK) + 1))
def test_a_box_restarts_at_any_byte_of_a_command(byte):
    """What came before is forgotten: only a command that comes as a whole is answered."""
    line = new_line()
    line.hooks.after(byte, "byte", lambda: line.power_cycle(0.0))
    heard = [ask(line), ask(line)]
    whole = [byte > len(ASK), byte <= len(ASK)]
    assert heard == [ANSWER if answered else b"" for answered in whole]
    assert ask(line) == ANSWER
    assert line.hooks.passed["byte"] == 3 * len(ASK)


def test_a_box_restarts_in_the_middle_of_an_answer(line):
    line.hooks.after(7, "answer byte", line.power_cycle)
    assert ask(line) == ANSWER[:7]
    line.clock.sleep_s(1.0)
    assert line.receive() == b""


def test_a_pulled_plug_keeps_the_rest_of_a_command(line):
    line.hooks.after(5, "byte", line.unplug)
    line.send(ASK)
    assert line.hooks.passed["byte"] == 5
    assert line.dead


def test_before_a_write_and_before_an_answer(line):
    seen = []
    line.hooks.after(1, "answer", lambda: seen.append(dict(line.hooks.passed)))
    line.hooks.after(2, "write", lambda: seen.append(dict(line.hooks.passed)))
    ask(line)
    ask(line)
    assert [(at["write"], at["byte"], at["answer byte"]) for at in seen] == [(1, 13, 0), (2, 13, 20)]


def test_another_thread_waits_for_the_end_of_a_write_and_for_its_gate(line):
    pressed, gate = [], [True]
    line.hooks.press(3, "byte", lambda: pressed.append(line.clock.now_s()), lambda: gate[0])
    line.send(ASK)
    assert not pressed
    line.receive()
    assert not pressed
    gate[0] = False
    line.clock.sleep_s(1.0)
    line.receive()
    line.receive()
    assert pressed == [1.0]


def test_forgotten_actions_do_not_happen(line):
    line.hooks.after(1, "byte", line.unplug)
    line.hooks.clear()
    ask(line)
    assert not line.dead
