"""kill -9 while a series is evaluated, then the same command again: the same bytes as if nothing had happened."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rtpiv.command_line.cli import DONE, INTERRUPTED, main
from tests.rtpiv.analysis.series.small_series import content_of, flow_run

ROOT = Path(__file__).resolve().parents[2]
WINDOWS = ("--first-window", "32", "--final-window", "16")
PAIRS = 70  # five chunks


def begun(run, out, workers):
    command = [
        sys.executable,
        "-m",
        "rtpiv.command_line.cli",
        "evaluate",
        str(run),
        "-o",
        str(out),
        *WINDOWS,
        "--workers",
        workers,
    ]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def children_of(number):
    """Processes that a process has started, from the system's own table."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == number:
                found.append(int(folder.name))
    return found


def ends(number, within_s=20.0):
    """Whether a process is gone before long."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        try:
            if (Path("/proc") / str(number) / "stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.05)
    return False


def finished(run, out, whole, rng, kills):
    """Evaluate with kills until it ends by itself; return how many there were."""
    done = 0
    while done < kills:
        shutdown = begun(run, out, "2")
        chunks = len(list(out.glob("chunks/*.json")))
        if rng.random() < 0.3:  # at any time; else while vectors are made
            time.sleep(rng.uniform(0.0, 6.0))
        else:
            while shutdown.poll() is None and len(list(out.glob("chunks/*.json"))) == chunks < 4:
                time.sleep(0.02)
            time.sleep(rng.uniform(0.0, 1.0))
        workers = children_of(shutdown.pid)
        if shutdown.poll() is None:
            os.kill(shutdown.pid, signal.SIGKILL)
            done += 1
        shutdown.wait()
        shutdown.stderr.close()
        assert all(ends(worker) for worker in workers)
        if len(list(out.glob("chunks/*.json"))) == 5:
            break
    last = begun(run, out, rng.choice("12"))
    said = last.communicate(timeout=240)[1]
    assert last.returncode == DONE, said
    assert content_of(out) == whole
    assert not list(out.rglob("*.part"))
    return done


def undisturbed(tmp_path):
    run = flow_run(tmp_path, PAIRS)
    assert main(["evaluate", str(run), "-o", str(tmp_path / "whole"), *WINDOWS, "--workers", "1"]) == DONE
    return run, content_of(tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.timeout(2400)
def test_killed_at_thirty_random_times_the_bytes_are_the_same(tmp_path):
    run, whole = undisturbed(tmp_path)
    rng, kills, number = random.Random(1), 0, 0
    while kills < 30:
        kills += finished(run, tmp_path / f"killed{number}", whole, rng, 30 - kills)
        number += 1


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_worker_that_is_killed_is_one_sentence_and_leaves_nobody_behind(tmp_path):
    run, whole = undisturbed(tmp_path)
    out = tmp_path / "out"
    process = begun(run, out, "2")
    while not list(out.glob("chunks/*.json")):
        time.sleep(0.02)
    workers = sorted(children_of(process.pid))[-2:]  # begun last: what draws is there before them
    os.kill(workers[0], signal.SIGKILL)
    said = process.communicate(timeout=120)[1]
    assert process.returncode == INTERRUPTED
    assert "a process that evaluates was killed" in said
    assert "Traceback" not in said
    assert all(ends(worker) for worker in workers)
    again = begun(run, out, "2")
    assert (again.communicate(timeout=240), again.returncode)[1] == DONE
    assert content_of(out) == whole
