"""The threads: raw never skips, live may and says so, memory goes back, latency is what it says."""

import itertools
import threading
import time

import numpy as np
import pytest

from daq.cameras.frame import Frame, FrameMeta
from daq.errors import DiskError
from daq.pipeline.corrections import correct_from_disk, frames_to_correct
from daq.pipeline.job import Job
from daq.pipeline.pipeline import Pipeline
from daq.plans.steps import Step
from daq.runs.journal import Journal, read_journal
from daq.runs.raw_frame import checksum
from daq.runs.run_folder import RunFolder
from piv.files.frame_file import read_frame, write_frame
from tests.daq.small_run import PLACES, about_run, planned

FRAMES = 24


class Doubler:
    """Stands for the correctors: doubles grey values, at a chosen speed."""

    def __init__(self, duration_s=0.0, gate=None):
        self.duration_s, self.gate, self.made = duration_s, gate, []

    def of(self, step):
        return self._correct if step.on_plane else None

    def _correct(self, pixels):
        if self.gate is not None:
            self.gate.wait(10.0)
        time.sleep(self.duration_s)
        self.made.append(int(pixels[0, 0]))
        return 2.0 * pixels.astype(np.float32)

    def write(self, path, corrected, step, source):
        write_frame(path, corrected, 1.0, {"source": source})


def a_step(on_plane=True):
    return Step(0, "t", (), 0.0, 0, FRAMES, "glass", "particles", on_plane)


class Memory:
    """Frames whose memory has to come back."""

    def __init__(self):
        self.out = set()

    def frame(self, number):
        self.out.add(number)
        pixels = np.full((8, 8), number, np.uint16)
        meta = FrameMeta(number, number, 0, time.monotonic_ns(), 100.0, "Mono12", 12)
        return Frame(pixels, meta, lambda: self.out.discard(number))


@pytest.fixture
def run(tmp_path):
    folder = RunFolder.create(tmp_path, "p", about_run([planned(0, "t", frames=FRAMES)]))
    journal = Journal(folder.journal_path)
    yield folder, journal
    journal.close()


def push(pipeline, step, memory, period_s=0.0):
    for number in range(FRAMES):
        pipeline.submit(Job(step, number, memory.frame(number), dict(PLACES)))
        time.sleep(period_s)
    pipeline.flush()


def test_every_frame_is_written_whatever_the_live_lane_does(run):
    folder, journal = run
    gate, memory = threading.Event(), Memory()
    corrections = Doubler(gate=gate)
    pipeline = Pipeline(folder, journal, corrections, live_queue=3)
    push(pipeline, a_step(), memory)
    assert pipeline.stats.written == FRAMES
    assert len(pipeline.stats.skipped) >= FRAMES - 5
    gate.set()
    pipeline.close()
    assert memory.out == set()
    live = pipeline.stats.corrected
    assert live + len(pipeline.stats.skipped) == FRAMES
    entries = [entry for entry in read_journal(folder.journal_path) if entry["kind"] == "frame"]
    assert sorted(entry["frame"] for entry in entries) == list(range(FRAMES))
    for entry in entries:
        assert entry["crc32"] == checksum(np.full((8, 8), entry["frame"], np.uint16))

    left = frames_to_correct(folder, Doubler(), [a_step()])
    assert len(left) == FRAMES - live
    for step, number in left:
        correct_from_disk(folder, Doubler(), step, number)
    for number in range(FRAMES):
        assert np.array_equal(
            read_frame(folder.correction_path(number)), np.full((8, 8), 2.0 * number, np.float32)
        )


def test_a_live_lane_that_falls_behind_skips_the_oldest(run):
    folder, journal = run
    gate, corrections = threading.Event(), Doubler()
    corrections.gate = gate
    pipeline = Pipeline(folder, journal, corrections, live_queue=2)
    memory = Memory()
    for number in range(FRAMES):  # one after another through the raw thread, however slow the disk is
        pipeline.submit(Job(a_step(), number, memory.frame(number), dict(PLACES)))
        pipeline.flush()
    gate.set()
    pipeline.close()
    assert corrections.made[-2:] == [FRAMES - 2, FRAMES - 1]
    assert sorted(corrections.made + pipeline.stats.skipped) == list(range(FRAMES))


def test_in_time_nothing_is_skipped_and_latency_is_that_of_the_correction(run):
    """Each frame comes when the one before is written and corrected, however long a busy computer takes."""
    folder, journal = run
    corrections, memory = Doubler(duration_s=0.005), Memory()
    pipeline = Pipeline(folder, journal, corrections)
    for number in range(FRAMES):
        pipeline.submit(Job(a_step(), number, memory.frame(number), dict(PLACES)))
        pipeline.flush()
        while len(corrections.made) <= number:
            time.sleep(0.001)
    pipeline.close()
    assert pipeline.stats.skipped == []
    assert len(pipeline.stats.latency_ms) == FRAMES
    assert min(pipeline.stats.latency_ms) >= 5.0
    assert pipeline.stats.summary()["latency_ms"]["p50"] < 100.0


def test_frames_off_the_plane_are_left_alone(run):
    folder, journal = run
    pipeline = Pipeline(folder, journal, Doubler())
    push(pipeline, a_step(on_plane=False), Memory())
    pipeline.close()
    assert pipeline.stats.corrected == 0
    assert list((folder.path / "corrected").iterdir()) == []


@pytest.mark.parametrize("bad", [0, 7, FRAMES - 1])
def test_a_frame_that_cannot_be_written_ends_everything_and_frees_memory(run, monkeypatch, bad):
    folder, journal = run
    numbers = itertools.count()

    def sometimes(path, pixels, about):
        if next(numbers) == bad:
            raise DiskError(f"{path}: No space left on device")

    monkeypatch.setattr("daq.pipeline.pipeline.write_raw", sometimes)
    memory = Memory()
    pipeline = Pipeline(folder, journal, Doubler())
    with pytest.raises(DiskError, match="No space left"):
        push(pipeline, a_step(), memory)
    pipeline.close()
    assert pipeline.stats.written < FRAMES
    assert memory.out == set()


def test_a_corrected_frame_that_cannot_be_stored_ends_the_run(run, monkeypatch):
    folder, journal = run

    class NoRoom(Doubler):
        def write(self, path, corrected, step, source):
            raise DiskError(f"{path}: No space left on device")

    pipeline = Pipeline(folder, journal, NoRoom())
    with pytest.raises(DiskError, match="corrected"):
        push(pipeline, a_step(), Memory(), period_s=0.01)
    pipeline.close()


def test_a_bug_in_a_lane_is_not_swallowed(run):
    folder, journal = run

    class Broken(Doubler):
        def _correct(self, pixels):
            raise ZeroDivisionError("a bug")

    pipeline = Pipeline(folder, journal, Broken())
    with pytest.raises(ZeroDivisionError):
        push(pipeline, a_step(), Memory(), period_s=0.01)
    pipeline.close()


def test_whoever_is_stuck_while_he_looks_holds_two_frames_and_nobody_up(run):
    folder, journal = run
    memory, gate, shown = Memory(), threading.Event(), []

    def show(job, corrected):
        shown.append((job.number, float(corrected[0, 0])))
        gate.wait(20.0)

    pipeline = Pipeline(folder, journal, Doubler(), show=show)
    push(pipeline, a_step(), memory, 0.005)
    assert pipeline.stats.written == FRAMES
    end_s = time.monotonic() + 20.0
    while len(memory.out) > 2 and time.monotonic() < end_s:
        time.sleep(0.01)
    assert len(memory.out) == 2
    gate.set()
    pipeline.close()
    assert pipeline.stats.corrected + len(pipeline.stats.skipped) == FRAMES
    assert not memory.out
    assert all(twice == 2.0 * number for number, twice in shown)
    assert shown[0][0] < shown[-1][0]


def test_a_page_that_breaks_ends_the_showing_and_not_the_run(run):
    folder, journal = run
    memory, shown = Memory(), []

    def show(job, corrected):
        shown.append(job.number)
        raise ValueError("mmap closed")

    def go() -> Pipeline:
        pipeline = Pipeline(folder, journal, Doubler(), show=show)
        push(pipeline, a_step(), memory, 0.005)
        pipeline.close()
        return pipeline

    with pytest.warns(RuntimeWarning, match="shows nothing any more.*mmap closed"):
        pipeline = go()
    assert len(shown) == 1
    assert pipeline.stats.written == FRAMES
    assert not memory.out
