"""kill -9 of a campaign and of its workers: the same command makes what is missing, same bytes."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rtpiv.command_line.cli import DEVICE, DONE, INTERRUPTED, main
from tests.rtpiv.analysis.campaign.small_campaign import content_of, two_runs
from tests.system.served import children_of, ends

ROOT = Path(__file__).resolve().parents[2]
SMALL = ("--first-window", "32", "--final-window", "16", "--chunk", "2")
CHUNKS = 12
# Where a quota ends a process's files at some size, Python's own would be cut as well, and stay so.
ENVIRONMENT = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return [str(run) for run in two_runs(tmp_path_factory.mktemp("runs"), (13, 10))]


@pytest.fixture(scope="module")
def whole(runs, tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    for words in (("run", *runs, *SMALL, "--workers", "1"), ("merge",)):
        assert main(["campaign", *words, "-o", str(out)]) == DONE
    return content_of(out)


def begun(out, *words):
    command = [sys.executable, "-m", "rtpiv.command_line.cli", "campaign", *words, "-o", str(out)]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, cwd=ROOT, env=ENVIRONMENT, **pipes)


def made(out):
    return len(list(out.glob("runs/*/chunks/*.json")))


def until_made(process, out, count, rng):
    """Wait until so many chunks are there, and a little longer; False if the process has ended by then."""
    end = time.monotonic() + 120.0
    while process.poll() is None and made(out) < count and time.monotonic() < end:
        time.sleep(0.01)
    time.sleep(rng.uniform(0.0, 0.3))
    return process.poll() is None


def finished(out, *by):
    """Give the same command again: it keeps the chunks that are there, and ends by itself."""
    kept = {file: file.stat().st_mtime_ns for file in out.glob("runs/*/chunks/*.json")}
    last = begun(out, "run", *by)
    said = last.communicate(timeout=240)[1]
    assert last.returncode == DONE, said
    assert main(["campaign", "merge", "-o", str(out)]) == DONE
    assert {file: file.stat().st_mtime_ns for file in kept} == kept


def killed_client(runs, out, rng):
    client = begun(out, "run", *runs, *SMALL, "--workers", "2")
    is_there = until_made(client, out, rng.randrange(CHUNKS), rng)
    workers = children_of(client.pid) if is_there else []
    client.kill()
    client.communicate()
    assert all(ends(worker) for worker in workers)
    finished(out, *runs, *SMALL, "--workers", rng.choice("12"))  # it may not have come to its plan
    return is_there


def killed_workers(runs, out, rng):
    """One of two: the command ends as interrupted."""
    client = begun(out, "run", *runs, *SMALL, "--workers", "2")
    is_there = until_made(client, out, 1 + rng.randrange(CHUNKS - 2), rng)
    victims = children_of(client.pid)[:1] if is_there else []
    try:
        for worker in victims:
            os.kill(worker, signal.SIGKILL)
    except ProcessLookupError:  # it had just ended
        victims = []
    text = client.communicate(timeout=240)[1]
    is_whole = made(out) == CHUNKS  # an idle worker may be killed after the last chunk
    assert client.returncode == INTERRUPTED or is_whole, text
    assert is_whole or "a process that evaluates was killed" in " ".join(text.split())
    assert "Traceback" not in text
    finished(out, "--workers", "1")
    return bool(victims)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_full_disk_ends_a_campaign_and_costs_nothing_else(runs, whole, tmp_path):
    """No file takes more than 8000 bytes, and a chunk of two pairs has 11 000; those of one pair are written."""
    out = tmp_path / "out"
    assert main(["campaign", "run", *runs, *SMALL, "--workers", "1", "-o", str(out)]) == DONE
    for file in out.glob("runs/*/chunks/*"):
        file.unlink()
    limit = "import resource, runpy; resource.setrlimit(resource.RLIMIT_FSIZE, (8000, 8000));"
    words = ("campaign", "run", "-o", str(out), "--workers", "2")
    command = [
        sys.executable,
        "-c",
        f"{limit} import sys; from rtpiv.command_line.cli import main; sys.exit(main({words}))",
    ]
    full = subprocess.run(command, cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True)
    assert full.returncode == DEVICE, full.stderr
    assert "file too large; make room" in " ".join(full.stderr.lower().split())  # whatever the terminal wraps
    assert "Traceback" not in full.stderr
    assert not list(out.rglob("*.part"))
    finished(out, "--workers", "2")
    assert content_of(out) == whole


@pytest.mark.slow
@pytest.mark.parametrize("kill", [killed_client, killed_workers])
@pytest.mark.timeout(7200)
def test_killed_at_random_times_the_bytes_are_the_same(runs, whole, tmp_path, kill):
    kills = int(os.environ.get("KILLS", "30"))
    rng, done, number = random.Random(3), 0, 0
    while done < kills:
        out = tmp_path / str(number)
        done += kill(runs, out, rng)
        assert content_of(out) == whole
        assert not list(out.rglob("*.part")), list(out.rglob("*.part"))
        number += 1
        assert number < 3 * kills
