"""kill -9 at random times, then resume: nothing acknowledged is lost, nothing is doubled, the end is the same."""

import json
import os
import random
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from daq.runs.raw_frame import checksum, read_raw
from daq.runs.run_folder import RunFolder, frame_entries, steps_on_disk
from rtpiv.command_line.cli import DONE, main
from tests.daq.small_bench import write_bench

pytest.importorskip("harvesters", reason="the camera needs harvesters (extra rtpiv[camera])")

RING = 7  # frames that are replayed; a prime, so that a frame taken out of turn shows
PLAN = """experiment: shift
views: [glass]
displacements: [{{along: [1.0, 0.0, 0.0], mm: 0.5}}, {{along: [0.0, 1.0, 0.0], mm: 0.25}}]
repeats: {repeats}
"""


def prepare(folder, repeats):
    write_bench(folder, side_px=64, simulation="ring: ring", is_brisk=False)
    (folder / "ring").mkdir()
    for number in range(RING):
        image = np.random.default_rng(number).integers(0, 4095, (64, 64)).astype(np.uint16)
        np.save(folder / "ring" / f"{number}.npy", image)
    (folder / "plan.yaml").write_text(PLAN.format(repeats=repeats))


def start(folder, *arguments):
    environment = os.environ | {"TMPDIR": str(folder)}
    command = [sys.executable, "-m", "rtpiv.command_line.cli", *map(str, arguments), "--home"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, cwd=folder, env=environment, **quiet)


def sessions(path):
    return sum(entry["kind"] == "session" for entry in RunFolder(path).entries())


def wait_for_session(process, runs, before):
    """Return the run's folder once a session more is in its journal, or the process has ended."""
    while process.poll() is None:
        for path in runs.glob("*_plan"):
            if sessions(path) > before:
                return path
        time.sleep(0.01)
    found = next(runs.glob("*_plan"), None)
    assert found is not None, process.communicate()[1].decode()
    return found


def check_what_was_acknowledged(path):
    """Every frame of the journal is on the disk with its checksum; how many steps are finished, never fewer later.

    Frames may become fewer: those of a step that was not finished are discarded, and the step is done again.
    """
    run = RunFolder(path)
    entries = run.entries()
    assert steps_on_disk(entries) <= set(frame_entries(entries))  # one frame a step in this plan
    for number, entry in frame_entries(entries).items():
        assert checksum(read_raw(run.frame_path(number))[0]) == entry["crc32"]
    return len(steps_on_disk(entries))


def run_with_kills(folder, kills, seed, most_s, *options):
    """Acquire, kill, resume, kill, ... and let the last session end; return the run and the number of kills."""
    rng, done, progress = random.Random(seed), 0, []
    runs = folder / "runs"
    process = start(folder, "acquire", "plan.yaml", "-o", "runs", "--simulate", *options)
    path = wait_for_session(process, runs, 0)
    while done < kills and process.poll() is None:
        time.sleep(rng.uniform(0.0, most_s))
        if process.poll() is not None:
            break
        process.send_signal(signal.SIGKILL)
        process.communicate()
        done += 1
        progress.append(check_what_was_acknowledged(path))
        before = sessions(path)
        process = start(folder, "acquire", "--resume", path)
        wait_for_session(process, runs, before)
    _, errors = process.communicate(timeout=240)
    assert process.returncode == DONE, errors.decode()
    assert progress == sorted(progress)
    return RunFolder(path), done


def check_equal(run, whole):
    """The killed run ends as the uninterrupted one: same frames, same planned and true positions."""
    ours, theirs = frame_entries(run.entries()), frame_entries(whole.entries())
    assert sorted(ours) == sorted(theirs)
    lines = [entry["frame"] for entry in run.entries() if entry["kind"] == "frame"]
    discarded = [n for entry in run.entries() if entry["kind"] == "discard" for n in entry["frames"]]
    assert len(lines) == len(ours) + len(discarded)  # none doubled
    for number, entry in theirs.items():
        assert ours[number]["crc32"] == entry["crc32"], number
        assert np.array_equal(read_raw(run.frame_path(number))[0], read_raw(whole.frame_path(number))[0])
        for kind in ("planned_mm", "measured_mm", "true_mm"):
            assert ours[number][kind] == entry[kind]
    for path in (whole.path / "corrected").glob("*.tif"):
        assert (run.path / "corrected" / path.name).read_bytes() == path.read_bytes()
    files = {path.name for path in (run.path / "frames").iterdir()}
    assert files == {path.name for path in (whole.path / "frames").iterdir()}
    books = json.loads((run.path / "done.json").read_text())["conservation"]
    assert books["imbalance"] == 0
    assert books["written"] == len(theirs)


def whole_run(folder, repeats, *options):
    prepare(folder, repeats)
    files = [str(folder / "plan.yaml"), "--bench", str(folder / "bench.yaml"), "-o", str(folder / "runs")]
    assert main(["acquire", *files, "--simulate", "--home", *options]) == DONE
    return RunFolder(next((folder / "runs").glob("*_plan")))


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_kill_fifty_times(tmp_path):
    """Fifty kills, in as many runs as that takes, corrections included."""
    kills = 0
    whole = whole_run(tmp_path / "whole", 120)
    for seed in range(6):
        folder = tmp_path / f"killed{seed}"
        prepare(folder, 120)
        run, more = run_with_kills(folder, 50 - kills, seed, 1.0)
        check_equal(run, whole)
        kills += more
        if kills >= 50:
            return
    pytest.fail(f"only {kills} kills hit a running process; make the run longer")
