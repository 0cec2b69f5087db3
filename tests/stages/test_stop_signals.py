"""Every end that a program can have, with real signals to real programs, judged by the simulated carriage."""

import signal
import socket
import threading
import time

import pytest

from stages.drivers_by_name import DRIVERS
from stages.stop_signals import SIGNALLED, StopThread
from tests.slow_cases import slow, slow_but
from tests.stages.children import MOVE, end, go, served

APART = f"threading.Thread(target=lambda: {MOVE}, daemon=True).start(); time.sleep(1.0)"
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT]


def left_by(number):
    """Exit status: Python repeats a KeyboardInterrupt that nobody takes as the signal itself."""
    return -number if number == signal.SIGINT else SIGNALLED + number


ENDS = [(box, number) for box in DRIVERS for number in SIGNALS]
FAST_ENDS = {("isel_dnc", signal.SIGINT), ("isel_dnc", signal.SIGTERM)}


@pytest.mark.parametrize(("box", "number"), [end if end in FAST_ENDS else slow(*end) for end in ENDS])
def test_a_signal_in_motion_stops_and_ends_the_program(box, number):
    with served(box) as world:
        child = world.start_motion()
        child.send_signal(number)
        child.wait(60)
        assert end(child)[0] == left_by(number)
        assert world.rest_mm() < 60.0


@pytest.mark.slow
@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_while_homing(driver, number):
    with served(driver, home_timeout_s=300.0) as world:
        child = world.start("said('homing'); stage.home(['a', 'b'])")
        motor = world.world.motors["a" if driver == "grbl" else "b"]
        begun_mm = motor.carriage_mm
        go(child)
        world.wait_until(lambda: world.true_mm() and abs(motor.carriage_mm - begun_mm) > 0.5)
        child.send_signal(number)
        child.wait(60)
        assert end(child)[0] == left_by(number)
        world.rest_mm()
        assert not motor.is_closed("low")
        assert not motor.is_closed("high")


@pytest.mark.parametrize(
    ("code", "status"),
    [
        slow(APART, 0),
        ("threading.Timer(1.0, stage.close).start(); " + MOVE, 1),
        (APART + "; 1/0", 1),
        slow(APART + "; sys.exit(7)", 7),
    ],
    ids=["end of the block", "closed by another thread", "exception", "SystemExit"],
)  # fmt: skip
def test_ends_without_a_signal(code, status):
    """A thread moves, the block ends: what it has begun must not outlive the block."""
    with served("zaber_ascii") as world:
        child = world.start("import threading; " + code)
        go(child)
        child.wait(60)
        assert end(child)[0] == status
        assert 11.0 < world.rest_mm() < 80.0


def test_after_one_signal_the_axis_still_knows_where_it_is():
    """The conversation with a controller is not torn apart: isel is mute until the end of its motion."""
    code = f"""
try:
    {MOVE}
except KeyboardInterrupt:
    said(stage.is_held)
    where = stage.where_mm()["a"]
    try:
        stage.move({{"a": 20.0}})
    except Exception as error:
        said(type(error).__name__)
    stage.clear_stop()
    stage.move({{"a": 20.0}})
    said(where)
"""
    with served("isel_dnc") as world:
        child = world.start(code)
        begun_mm = world.true_mm()
        go(child)
        world.wait_until(lambda: abs(world.true_mm() - begun_mm) > 3.0)
        child.send_signal(signal.SIGINT)
        assert child.stdout.readline() == "True\n"
        assert child.stdout.readline() == "MotionStopped\n"
        where_mm = float(child.stdout.readline())
        child.wait(60)
        assert end(child)[0] == 0
        assert 12.0 < where_mm < 60.0
        assert abs(world.rest_mm() - 20.0 - (begun_mm - 10.0)) < 0.02


def test_a_second_signal_does_not_wait():
    """A controller that never says that it has stopped cannot keep the program."""
    code = f"""
stage.controllers["box"].moving = lambda channel: True
{MOVE}
"""
    with served("zaber_ascii") as world:
        child = world.start_motion(code)
        child.send_signal(signal.SIGTERM)
        rest_mm = world.rest_mm()
        assert rest_mm < 60.0
        assert child.poll() is None
        child.send_signal(signal.SIGTERM)
        child.wait(60)
        assert end(child)[0] == SIGNALLED + signal.SIGTERM
        assert world.rest_mm() == rest_mm


def test_a_signal_at_rest_ends_the_program_at_once():
    with served("zaber_ascii") as world:
        child = world.start("said('here'); time.sleep(300.0)")
        go(child)
        assert child.stdout.readline() == "here\n"
        child.send_signal(signal.SIGTERM)
        child.wait(60)
        assert end(child)[0] == SIGNALLED + signal.SIGTERM


def test_under_nohup_a_hangup_is_ignored():
    code = "said('here'); sys.stdin.readline(); said('still here')"
    with served("zaber_ascii") as world:
        child = world.start(code, preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
        go(child)
        assert child.stdout.readline() == "here\n"
        child.send_signal(signal.SIGHUP)
        time.sleep(0.2)
        go(child)
        assert child.stdout.readline() == "still here\n"
        child.wait(60)
        assert end(child)[0] == 0


def test_ctrl_z_in_motion_stops_the_axis_at_rest_it_suspends():
    code = f"""
try:
    {MOVE}
except KeyboardInterrupt:
    said("stopped")
sys.stdin.readline()
said("woken")
"""
    with served("zaber_ascii") as world:
        child = world.start_motion(code)
        child.send_signal(signal.SIGTSTP)
        assert child.stdout.readline() == "stopped\n"
        assert world.rest_mm() < 60.0
        child.send_signal(signal.SIGTSTP)
        world.wait_until(lambda: state(child.pid) == "T")
        child.send_signal(signal.SIGCONT)
        go(child)
        assert child.stdout.readline() == "woken\n"
        child.wait(60)
        assert end(child)[0] == 0


@pytest.mark.parametrize("number", slow_but(SIGNALS, signal.SIGTERM))
def test_a_main_thread_that_is_stuck_in_c_does_not_keep_the_stop_away(number):
    """No handler runs while a window waits for events, or here: a lock that is taken twice."""
    code = f"""
import ctypes, threading
threading.Thread(target=lambda: {MOVE}, daemon=True).start()
library, lock = ctypes.CDLL(None), ctypes.create_string_buffer(64)
library.pthread_mutex_init(lock, None)
library.pthread_mutex_lock(lock)
library.pthread_mutex_lock(lock)
"""
    with served("zaber_ascii") as world:
        child = world.start_motion(code)
        child.send_signal(number)
        assert world.rest_mm() < 60.0
        assert child.poll() is None
        end(child)


def test_a_signal_to_a_forked_child_stops_nothing_here():
    """It has our handlers and the descriptor that wakes us; a pool of workers is ended with SIGTERM."""
    code = """
import os
pid = os.fork()
if pid == 0:
    time.sleep(300.0)
    os._exit(0)
stopper = __import__("threading").Timer(0.5, lambda: os.kill(pid, 15))
stopper.start()
stage.move({"a": 30.0})
os.waitpid(pid, 0)
said(stage.is_held)
"""
    with served("zaber_ascii") as world:
        child = world.start(code)
        go(child)
        assert child.stdout.readline() == "False\n"
        child.wait(60)
        assert end(child)[0] == 0


def test_the_descriptor_of_somebody_else_is_given_back():
    from stages.stop_signals import StopSignals

    theirs, near = socket.socketpair()
    near.setblocking(False)
    before = signal.set_wakeup_fd(near.fileno(), warn_on_full_buffer=False)
    try:
        bench = StopSignals(lambda why: None)
        bench.enter()
        handler = signal.signal(signal.SIGUSR1, lambda number, frame: None)
        signal.raise_signal(signal.SIGUSR1)
        signal.signal(signal.SIGUSR1, handler)
        theirs.settimeout(20.0)
        assert theirs.recv(1) == bytes([signal.SIGUSR1])
        with bench.leaving(stop=False):
            pass
        assert signal.set_wakeup_fd(near.fileno(), warn_on_full_buffer=False) == near.fileno()
    finally:
        signal.set_wakeup_fd(before)
        theirs.close()
        near.close()


def state(pid):
    with open(f"/proc/{pid}/stat", encoding="ascii") as stream:  # noqa: PTH123
        return stream.read().rpartition(")")[2].split()[0]


@pytest.mark.posix("SIGHUP")
def test_handlers_are_put_back_and_others_stay():
    from stages.stop_signals import StopSignals

    before = {number: signal.getsignal(number) for number in SIGNALS}
    one, two = StopSignals(lambda why: None), StopSignals(lambda why: None)
    one.enter()
    two.enter()
    assert all(signal.getsignal(number) is not before[number] for number in SIGNALS)
    with one.leaving(stop=False):
        pass
    assert all(signal.getsignal(number) is not before[number] for number in SIGNALS)
    with two.leaving(stop=False):
        pass
    assert {number: signal.getsignal(number) for number in SIGNALS} == before


def test_a_signal_stops_every_open_bench_and_reaches_the_handler_that_was_there():
    from stages.stop_signals import StopSignals

    stopped, heard = [], []
    before = signal.signal(signal.SIGTERM, lambda number, frame: heard.append(number))
    one, two = (StopSignals(lambda why, name=name: stopped.append((name, why))) for name in "12")
    try:
        one.enter()
        two.enter()
        with one.turn():
            signal.raise_signal(signal.SIGTERM)
            assert heard == []  # it waits for the end of the motion
        assert heard == [signal.SIGTERM]
        with two.leaving(stop=False):
            signal.raise_signal(signal.SIGTERM)
            assert heard == [signal.SIGTERM]
        assert heard == [signal.SIGTERM, signal.SIGTERM]
        with one.leaving(stop=False):  # what is due from the signals is said
            before_leaving = len(stopped)
        three = StopSignals(lambda why: stopped.append(("3", why)))
        three.enter()
        with three.leaving(stop=True):
            pass
    finally:
        signal.signal(signal.SIGTERM, before)
    assert set(stopped[:before_leaving]) == {("1", "SIGTERM"), ("2", "SIGTERM")}
    assert stopped[before_leaving:] == [("3", "the program has left the bench")] * 4


def test_stop_is_said_again_and_again_even_if_it_fails():
    said, gate = [], threading.Event()

    def stop():
        said.append(time.monotonic())
        gate.set()
        raise OSError("the cable is out")

    thread = StopThread(stop)
    thread.press()
    assert gate.wait(20.0)
    thread.end()
    assert len(said) == 4
    assert said[-1] - said[0] >= 0.2
    thread = StopThread(stop)
    for _ in range(5):
        thread.press()
    thread.end()
    assert len(said) >= 4 + 5 + 3  # each at once, the repeats after the last
