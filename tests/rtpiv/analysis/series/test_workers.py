"""Worker processes that are killed: whoever started them must not wait for them for ever."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from ground.errors import RtpivWarning
from ground.rows import run_rows
from rtpiv.analysis.series import workers
from rtpiv.analysis.series.workers import worker_processes

ROOT = Path(__file__).resolve().parents[4]


def who(_: object) -> int:
    """Number of the process, which takes long enough for the other one to take the next job."""
    time.sleep(0.1)
    return os.getpid()


def leave_behind_a_kill(victim: int) -> None:
    """Kill one of two workers that have nothing to do, and leave."""
    with worker_processes(2) as pool:
        workers: set[int] = set()
        while len(workers) < 2:
            workers |= set(pool.map(who, range(4)))
        time.sleep(0.3)  # one reads the queue, the other waits for its lock
        os.kill(sorted(workers)[victim], signal.SIGKILL)


@pytest.mark.parametrize("victim", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_worker_killed_with_the_lock_of_the_queue_holds_nobody_up(victim: int) -> None:
    code = f"from tests.rtpiv.analysis.series.test_workers import leave_behind_a_kill as f; f({victim})"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, timeout=60.0, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


LOADED: list[str] = []  # filled by a parent: who is forked from it has it, who is spawned has not


def state_of_worker(_: object) -> tuple[bool, bool, int, str]:
    time.sleep(0.05)
    plain = signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    run_rows(lambda first, last: None, 100, 10)
    return bool(LOADED), plain, threading.active_count(), os.environ["RTPIV_THREADS"]


def fork_and_spawn() -> None:
    """Print the states of workers of a process with idle threads of kernels, then of one with a busy thread."""
    LOADED.append("map")
    signal.signal(signal.SIGTERM, lambda number, frame: None)
    run_rows(lambda first, last: None, 100, 10, threads=3)
    states = []
    for count in (2, 1):
        with worker_processes(count) as pool:
            states.append(list(pool.map(state_of_worker, range(4))))
        run_rows(lambda first, last: None, 100, 10, threads=3)  # its own threads begin anew
        ended = threading.Event()
        threading.Thread(target=ended.wait, daemon=True).start()
    print(json.dumps(states))


@pytest.mark.slow
def test_a_process_of_one_thread_is_forked_and_any_other_spawns():
    code = "from tests.rtpiv.analysis.series.test_workers import fork_and_spawn as f; f()"
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, timeout=60.0, capture_output=True, text=True, check=True,
        env=environment,
    )  # fmt: skip
    forked, spawned = json.loads(done.stdout)
    can_fork = sys.platform == "linux"
    assert forked == [[can_fork, True, 2, "1"]] * 4  # its first thread, and the one that watches its parent
    assert spawned == [[False, True, 2, "1"]] * 4


def sleep_apart(_: object) -> None:
    os.write(1, f"{os.getpid()}\n".encode())  # in one piece: forked workers share their output
    time.sleep(60.0)


def begin_long_work() -> None:
    with worker_processes(3) as pool:
        list(pool.map(sleep_apart, range(3)))


def test_workers_end_with_a_parent_that_is_killed():
    code = "from tests.rtpiv.analysis.series.test_workers import begin_long_work as f; f()"
    command, environment = [sys.executable, "-c", code], os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=environment) as parent:
        assert parent.stdout is not None
        pids = {int(parent.stdout.readline()) for _ in range(3)}
        parent.kill()
        assert parent.stdout.read() == ""  # comes when no process has it open any more
    assert len(pids) == 3


def warned(value):
    warnings.warn("the bench has no watchdog", RtpivWarning, stacklevel=1)
    return float(np.nanmedian([value, np.nan]))


@pytest.mark.slow
def test_warnings_of_libraries_do_not_leave_a_worker(capfd, monkeypatch):
    monkeypatch.setattr(workers, "can_fork", lambda: False)  # pytest records warnings of forked processes
    with worker_processes(1) as pool:
        assert np.isnan(pool.submit(warned, np.nan).result())
    said = capfd.readouterr().err
    assert "All-NaN" not in said
    assert "the bench has no watchdog" in said
