"""Real signals to the verbs that move, over device files; judged by the simulated motors."""

import contextlib
import os
import signal
import time

import pytest

from daq.runs.run_folder import RunFolder, steps_on_disk
from rtpiv.command_line.cli import INTERRUPTED
from tests.daq.small_bench import write_frames
from tests.slow_cases import slow_but
from tests.system.served import end, served_bench

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT]
PLAN = "experiment: shift\nviews: [glass]\ndisplacements: [{along: [1.0, 0.0, 0.0], mm: 20.0}]\nrepeats: 3\n"


def left_by(number):
    return INTERRUPTED if number == signal.SIGINT else 128 + number


@pytest.fixture
def bench(tmp_path):
    with served_bench(tmp_path) as served:
        yield served


def begun(bench, axis, process, by_mm=3.0):
    """Wait until an axis has begun to move in real time."""
    start_mm = bench.true_mm(axis)
    bench.wait_until(lambda: abs(bench.true_mm(axis) - start_mm) > by_mm or process.poll() is not None)
    assert process.poll() is None, process.communicate()
    return start_mm


@pytest.mark.parametrize("number", slow_but([*SIGNALS, signal.SIGKILL], signal.SIGTERM))
def test_stage_move(bench, number):
    """The rail has half a minute to go; a signal leaves it where it is."""
    bench.clock.set_speed(100.0)
    process = bench.start("bench", "stage", "move", "--home", "rail_z=1000", "target_x=20")
    while process.stderr.readline() != "homing camera_x\n":  # the last one; the rail waits at its switch
        assert process.poll() is None
    bench.wait_until(lambda: bench.true_mm("rail_z") > -195.0)
    bench.clock.set_speed(1.0)
    process.send_signal(number)
    process.wait(60)
    bench.rests()
    rests_mm = bench.true_mm("rail_z")
    assert rests_mm < 950.0
    assert abs(bench.true_mm("target_x")) < 1.0
    code, _, errors = end(process)
    assert code == (-number if number == signal.SIGKILL else left_by(number)), errors
    assert "Traceback" not in errors


def acquiring(bench, **streams):
    """A run that begins with references."""
    (bench.folder / "plan.yaml").write_text(PLAN)
    write_frames(bench.folder / "frames_in", 8)
    return bench.start("acquire", "plan.yaml", "--no-correct", "--home", **streams)


def journal(bench):
    """What the run has written so far."""
    run = next((bench.folder / "runs").glob("*_plan"), None)
    return RunFolder(run).entries() if run else []


def until_a_step(bench, process, see=lambda: None):
    """Wait in haste for the first step of a run, and return to real time."""
    bench.clock.set_speed(100.0)
    bench.wait_until(lambda: see() or process.poll() is not None or steps_on_disk(journal(bench)), 300.0)
    bench.clock.set_speed(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_acquire_while_homing(bench, number):
    """Before the run's own handlers are there."""
    process = acquiring(bench)
    begun(bench, "glass_z", process, 0.5)
    process.send_signal(number)
    process.wait(60)
    bench.rests()
    assert end(process)[0] == left_by(number)
    assert not bench.world.motors["glass_z"].is_closed("low")


def slower(text):
    fast = "limits_mm: [-45.0, 45.0], speed_mm_s: 10.0"
    return text.replace(fast, fast.replace("10.0", "2.0"))  # ten seconds for every step's way of 20 mm


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("presses", [1, 2, 5])
def test_acquire_between_its_steps(tmp_path, number, presses):
    """Once: the step is finished.  Twice, and five times: the axis that moves stands still at once."""
    with served_bench(tmp_path, slower) as bench:
        process = acquiring(bench)
        until_a_step(bench, process)
        start_mm = bench.true_mm("target_x")
        bench.wait_until(lambda: bench.true_mm("target_x") > start_mm + 0.5)
        for _ in range(presses):  # two pending signals of one kind are one
            process.send_signal(number)
            time.sleep(0.1)
        if presses == 1:
            bench.clock.set_speed(100.0)
        process.wait(120)
        bench.rests()
        code, _, errors = end(process)
        # the last of five may meet a program that has closed everything and is about to end
        assert code == INTERRUPTED or (presses == 5 and code in (-number, 128 + number)), errors
        assert "go on with: rtpiv acquire --resume" in errors
        assert "Traceback" not in errors or presses == 5
        assert steps_on_disk(journal(bench)) == ({0, 1} if presses == 1 else {0})
        assert presses == 1 or bench.true_mm("target_x") < start_mm + 15.0


@pytest.mark.slow
def test_a_terminal_that_goes_away_lets_the_step_end(bench):
    """The window is closed: SIGHUP, and every further word to it fails."""
    main, terminal = os.openpty()
    process = acquiring(bench, **dict.fromkeys(("stdin", "stdout", "stderr"), terminal))
    os.close(terminal)

    def see():
        os.set_blocking(main, False)
        with contextlib.suppress(BlockingIOError):
            os.read(main, 65536)

    until_a_step(bench, process, see)
    os.close(main)
    process.send_signal(signal.SIGHUP)
    assert process.wait(120) == INTERRUPTED
    assert steps_on_disk(journal(bench)) in ({0}, {0, 1}, {0, 1, 2})
    assert [entry for entry in journal(bench) if entry["kind"] == "end"][-1]["why"] == "RunInterrupted"
