"""Signals of a run: once, twice, and every time after that."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from daq.runner.interrupts import Interrupts


@pytest.fixture
def said():
    return []


@pytest.fixture
def interrupts(said):
    with Interrupts(lambda: said.append(threading.current_thread())) as it:
        yield it


def wait_for(what):
    end_s = time.monotonic() + 20.0
    while not what():
        assert time.monotonic() < end_s
        time.sleep(0.002)


@pytest.mark.parametrize(
    "number", [signal.SIGINT, signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.posix("SIGHUP"))]
)
def test_once_finishes_the_step_twice_stops_from_another_thread(interrupts, said, number):
    signal.raise_signal(number)
    assert interrupts.is_end_wanted
    assert not interrupts.is_stopped
    time.sleep(0.3)
    assert said == []
    signal.raise_signal(number)
    assert interrupts.is_stopped
    wait_for(lambda: len(said) >= 4)  # at once, and three times more
    assert threading.main_thread() not in said


def test_different_signals_count_together(interrupts, said):
    signal.raise_signal(signal.SIGTERM)
    signal.raise_signal(signal.SIGINT)
    wait_for(lambda: said)


def test_every_further_press_stops_again(interrupts, said):
    """A stop that came too early for a command is not the last one that a person may press."""
    for presses in range(2, 7):
        while not interrupts.is_stopped:
            interrupts.press()
        before = len(said)
        interrupts.press()
        wait_for(lambda before=before: len(said) >= before + 4)
        assert len(said) >= 4 * (presses - 1)


@pytest.mark.posix("SIGQUIT")
def test_quit_stops_at_once(interrupts, said):
    signal.raise_signal(signal.SIGQUIT)
    assert interrupts.is_stopped
    wait_for(lambda: said)


def test_leaving_waits_until_everything_has_been_said(said):
    with Interrupts(lambda: said.append(0)) as it:
        it.stop()
    assert len(said) == 4


@pytest.mark.posix("SIGTSTP")
def test_a_pause_ends_by_a_press_and_by_a_second_ctrl_z(interrupts):
    signal.raise_signal(signal.SIGTSTP)
    assert interrupts.is_paused
    signal.raise_signal(signal.SIGTSTP)
    interrupts.wait()
    interrupts.pause()
    signal.raise_signal(signal.SIGINT)
    interrupts.wait()


@pytest.mark.posix("SIGTSTP")
def test_signals_in_the_middle_of_a_pause_never_lock_up(interrupts):
    """Handlers run between any two instructions of the main thread; none of them may wait for it."""
    ended = threading.Event()

    def hammer():
        while not ended.is_set():
            os.kill(os.getpid(), signal.SIGTSTP)
            time.sleep(0.0005)

    thread = threading.Thread(target=hammer)
    thread.start()
    for _ in range(25):
        interrupts.pause()
        interrupts.wait()
    ended.set()
    thread.join()


GONE = """
import os, signal, sys, time
from daq.runner.interrupts import Interrupts
with Interrupts(lambda: None) as it:
    os.write(1, b"here")
    while not it.is_end_wanted:
        time.sleep(0.01)
    for descriptor in (1, 2):
        os.write(descriptor, b"progress")
    os._exit(10)
"""


@pytest.mark.posix("SIGHUP")
def test_a_terminal_that_has_gone_does_not_end_the_run():
    """After a hangup every write to the terminal fails; the step is to be finished all the same."""
    main, terminal = os.openpty()
    child = subprocess.Popen([sys.executable, "-c", GONE], stdout=terminal, stderr=terminal)
    os.close(terminal)
    assert os.read(main, 100) == b"here"
    os.close(main)
    child.send_signal(signal.SIGHUP)
    assert child.wait(60) == 10


@pytest.mark.posix("SIGHUP")
def test_handlers_are_put_back_and_nohup_is_respected(said):
    numbers = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP]
    before_hangup = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        before = [signal.getsignal(number) for number in numbers]
        with Interrupts(lambda: said.append(0)) as it:
            signal.raise_signal(signal.SIGHUP)
            assert not it.is_end_wanted
        assert [signal.getsignal(number) for number in numbers] == before
    finally:
        signal.signal(signal.SIGHUP, before_hangup)
