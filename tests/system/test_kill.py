"""kill -9 at random times, then resume: nothing acknowledged is lost, nothing is doubled, the end is the same."""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from daq.runs.raw_frame import checksum, read_raw
from daq.runs.run_check import check_run
from daq.runs.run_folder import RunFolder, frame_entries, steps_on_disk
from rtpiv.command_line.cli import DEVICE, DONE, main
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
def test_kill_twice(tmp_path):
    whole = whole_run(tmp_path / "whole", 10, "--no-correct")
    prepare(tmp_path / "killed", 10)
    run, kills = run_with_kills(tmp_path / "killed", 2, 1, 0.3, "--no-correct")
    assert kills >= 1
    check_equal(run, whole)


STREAM = """camera:
  backend: harvesters
  settings: {PixelFormat: Mono12p, ExposureTime: 100.0, TriggerMode: "Off", AcquisitionFrameRate: 60.0}
  buffers: 40
  timeout_s: 20.0
"""


def prepare_stream(folder, frames):
    write_bench(folder, 64, "ring: ring\nrow_time_us: 1.0", STREAM)
    (folder / "ring").mkdir()
    np.save(folder / "ring" / "0.npy", np.random.default_rng(0).integers(0, 4095, (64, 64)).astype(np.uint16))
    (folder / "plan.yaml").write_text(f"experiment: stream\nview: clear\nframes: {frames}\ngaps_at_most: 1.0\n")


def camera_processes(process):
    """Numbers of the camera's processes that a process has started."""
    found = []
    for number in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split():
        with contextlib.suppress(FileNotFoundError):  # it has ended meanwhile
            if b"harvesters_process" in Path(f"/proc/{number}/cmdline").read_bytes():
                found.append(int(number))
    return found


def stream_with_kills(folder, kills, seed, most_s, of_camera):
    """Kill a stream, or its camera's process, again and again; return the run, and what it kept at each kill."""
    rng, kept, runs = random.Random(seed), [], folder / "runs"
    process = start(folder, "acquire", "plan.yaml", "-o", "runs", "--simulate", "--no-correct")
    path = wait_for_session(process, runs, 0)
    while len(kept) < kills:
        time.sleep(rng.uniform(0.0, most_s))
        if process.poll() == DONE:
            break
        if process.poll() is not None:  # the camera was killed while it was set up, before its first frame
            errors = process.communicate()[1].decode()
            assert of_camera, errors
            assert "camera is lost" in errors
            before = sessions(path)
            process = start(folder, "acquire", "--resume", path)
            wait_for_session(process, runs, before)
            continue
        kept.append(set(frame_entries(RunFolder(path).entries())))
        if of_camera:
            for number in camera_processes(process):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(number, signal.SIGKILL)
            continue
        process.send_signal(signal.SIGKILL)
        process.communicate()
        before = sessions(path)
        process = start(folder, "acquire", "--resume", path)
        wait_for_session(process, runs, before)
    _, errors = process.communicate(timeout=240)
    if process.returncode == DEVICE and of_camera:
        process = start(folder, "acquire", "--resume", path)
        _, errors = process.communicate(timeout=240)
    assert process.returncode == DONE, errors.decode()
    return RunFolder(path), kept


def check_stream(run, kept, frames):
    entries = run.entries()
    present = frame_entries(entries)
    assert all(some <= set(present) for some in kept)
    assert not [entry for entry in entries if entry["kind"] == "discard"]
    lines = [entry["frame"] for entry in entries if entry["kind"] == "frame"]
    assert len(lines) == len(set(lines)) == len(present)  # none doubled
    done = json.loads((run.path / "done.json").read_text())
    never = {n for step in done.get("gaps", ()) for first, last in step["gaps"] for n in range(first, last + 1)}
    assert never.isdisjoint(present)
    assert never | set(present) == set(range(frames))
    assert all(entry["frame"] % 2 == 0 for entry in entries if entry["kind"] == "arm")
    assert check_run(run.path).is_sound, check_run(run.path).findings


@pytest.mark.parametrize("of_camera", [pytest.param(False, marks=pytest.mark.slow), True])
@pytest.mark.slow
def test_a_stream_keeps_what_it_has(tmp_path, of_camera):
    prepare_stream(tmp_path, 150)
    run, kept = stream_with_kills(tmp_path, 2, 1, 1.0, of_camera)
    assert kept
    check_stream(run, kept, 150)


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("of_camera", [False, True])
def test_a_stream_keeps_what_it_has_whenever_it_is_killed(tmp_path, of_camera):
    kills = 0
    for seed in range(12):
        folder = tmp_path / str(seed)
        folder.mkdir()
        prepare_stream(folder, 600)
        run, kept = stream_with_kills(folder, 35 - kills, seed, 1.5, of_camera)
        check_stream(run, kept, 600)
        kills += len(kept)
        if kills >= 35:
            return
    pytest.fail(f"only {kills} kills hit a running process; make the stream longer")


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
