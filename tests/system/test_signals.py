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
    try:
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
    finally:
        end(process)


@pytest.mark.parametrize("number", slow_but([*SIGNALS, signal.SIGKILL], signal.SIGHUP))
def test_stage_home(bench, number):
    process = bench.start("bench", "stage", "home", "rail_z")
    try:
        begun(bench, "rail_z", process)
        process.send_signal(number)
        process.wait(60)
        bench.rests()
        assert not bench.world.motors["rail_z"].is_closed("low")
        assert end(process)[0] == (-number if number == signal.SIGKILL else left_by(number))
    finally:
        end(process)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_acquire_while_homing(bench, number):
    """Before the run's own handlers are there."""
    (bench.folder / "plan.yaml").write_text(PLAN)
    write_frames(bench.folder / "frames_in", 8)
    process = bench.start("acquire", "plan.yaml", "--no-correct", "--home")
    try:
        begun(bench, "glass_z", process, 0.5)
        process.send_signal(number)
        process.wait(60)
        bench.rests()
        assert end(process)[0] == left_by(number)
        assert not bench.world.motors["glass_z"].is_closed("low")
    finally:
        end(process)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("presses", [1, 2, 5])
def test_acquire_between_its_steps(tmp_path, number, presses):
    """Once: the step is finished.  Twice, and five times: the axis that moves stands still at once."""

    def slower(text):
        fast = "limits_mm: [-45.0, 45.0], speed_mm_s: 10.0"
        return text.replace(fast, fast.replace("10.0", "2.0"))  # ten seconds for every step's way of 20 mm

    with served_bench(tmp_path, slower) as bench:
        (tmp_path / "plan.yaml").write_text(PLAN)
        write_frames(tmp_path / "frames_in", 8)
        bench.clock.set_speed(100.0)
        process = bench.start("acquire", "plan.yaml", "--no-correct", "--home")
        try:
            runs = tmp_path / "runs"

            def first_done():
                run = next(iter(runs.glob("*_plan")), None)
                return process.poll() is not None or (run and steps_on_disk(RunFolder(run).entries()))

            bench.wait_until(first_done, 300.0)
            bench.clock.set_speed(1.0)
            start_mm = bench.true_mm("target_x")
            bench.wait_until(lambda: bench.true_mm("target_x") > start_mm + 0.5)
            for _ in range(presses):  # two pending signals of one kind are one
                process.send_signal(number)
                time.sleep(0.1)
            if presses == 1:
                bench.clock.set_speed(100.0)
            process.wait(120)
            bench.rests()
            run = next(runs.glob("*_plan"))
            code, _, errors = end(process)
            # the last of five may meet a program that has closed everything and is about to end
            assert code == INTERRUPTED or (presses == 5 and code in (-number, 128 + number)), errors
            assert "go on with: rtpiv acquire --resume" in errors
            assert "Traceback" not in errors or presses == 5
            done = steps_on_disk(RunFolder(run).entries())
            if presses == 1:
                assert done == {0, 1}
            else:
                assert done == {0}
                assert bench.true_mm("target_x") < start_mm + 15.0
        finally:
            end(process)


@pytest.mark.slow
def test_a_terminal_that_goes_away_lets_the_step_end(tmp_path):
    """The window is closed: SIGHUP, and every further word to it fails."""
    with served_bench(tmp_path) as bench:
        (tmp_path / "plan.yaml").write_text(PLAN)
        write_frames(tmp_path / "frames_in", 8)
        main, terminal = os.openpty()
        bench.clock.set_speed(100.0)
        process = bench.start(
            "acquire", "plan.yaml", "--no-correct", "--home", stdin=terminal, stdout=terminal, stderr=terminal
        )
        os.close(terminal)
        try:
            runs = tmp_path / "runs"

            def first_done():
                os.set_blocking(main, False)
                with contextlib.suppress(BlockingIOError):
                    os.read(main, 65536)
                run = next(iter(runs.glob("*_plan")), None)
                return process.poll() is not None or (run and steps_on_disk(RunFolder(run).entries()))

            bench.wait_until(first_done, 300.0)
            os.close(main)
            process.send_signal(signal.SIGHUP)
            assert process.wait(120) == INTERRUPTED
            done = steps_on_disk(RunFolder(next(runs.glob("*_plan"))).entries())
            assert done in ({0}, {0, 1}, {0, 1, 2})
            ends = [entry for entry in RunFolder(next(runs.glob("*_plan"))).entries() if entry["kind"] == "end"]
            assert ends[-1]["why"] == "RunInterrupted"
        finally:
            if process.poll() is None:
                process.kill()
            process.wait(60)
