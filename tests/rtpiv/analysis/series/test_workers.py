"""Worker processes that are killed: whoever started them must not wait for them for ever."""

import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from ground.errors import RtpivWarning
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


def warned(value):
    warnings.warn("the bench has no watchdog", RtpivWarning, stacklevel=1)
    return float(np.nanmedian([value, np.nan]))


def test_warnings_of_libraries_do_not_leave_a_worker(capfd):
    with worker_processes(1) as pool:
        assert np.isnan(pool.submit(warned, np.nan).result())
    said = capfd.readouterr().err
    assert "All-NaN" not in said
    assert "the bench has no watchdog" in said
