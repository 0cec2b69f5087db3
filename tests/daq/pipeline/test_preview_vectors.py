"""Vectors of the last pair: right, recent, never waited for, and silent about pairs that are none."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from daq.pipeline import preview_vectors
from daq.pipeline.job import Job
from daq.pipeline.pipeline import Pipeline
from daq.pipeline.preview_vectors import PreviewVectors
from daq.pipeline.stats import LiveVectors, PipelineStats
from daq.plans.pulse_order import PulseOrder
from daq.plans.steps import Step
from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder
from tests.daq.pipeline.test_pipeline import Doubler, Memory
from tests.daq.small_run import PLACES, about_run, planned
from tests.piv.conftest import make_pair


def a_step(group=2, first=0):
    return Step(0, "flow", (), 0.0, first, 100, "glass", "particles", True, group=group)


@pytest.fixture(scope="module")
def frames():
    a, b = make_pair(lambda u, v: (5.0 + 0 * u, -3.0 + 0 * u), shape=(384, 384))
    a, b = a.astype(np.float32), b.astype(np.float32)
    a[:60], b[:60] = np.nan, np.nan
    return a, b


def wait_for(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


def test_a_pair_is_measured_with_v_up(frames):
    flow = PipelineStats()
    pairs = PreviewVectors(flow)
    for number, frame in enumerate(frames):
        pairs.see(a_step(), number, frame, time.monotonic_ns())
    assert wait_for(lambda: flow.vectors is not None)
    pairs.close()
    assert flow.vectors.median_px == pytest.approx((5.0, 3.0), abs=0.05)
    assert flow.vectors.largest_px == pytest.approx(np.hypot(5, 3), abs=0.2)
    assert flow.vectors.valid_share > 0.9
    assert flow.vectors_live == 1
    assert "median +5.0" in flow.vectors.sentence()


def test_what_is_no_pair_is_not_measured(frames):
    flow = PipelineStats()
    pairs = PreviewVectors(flow)
    a, b = frames
    for step, number, frame in (
        (a_step(group=1), 0, a), (a_step(group=1), 1, b),  # not taken as pairs
        (a_step(), 1, b), (a_step(), 2, a), (a_step(), 5, b),  # partners skipped
        (a_step(first=3), 4, b), (a_step(first=3), 3, a),  # another parity, wrong order
    ):  # fmt: skip
        pairs.see(step, number, frame, time.monotonic_ns())
    time.sleep(0.2)
    pairs.close()
    assert flow.vectors is None


def test_a_background_without_particles_has_no_vectors(frames):
    flow = PipelineStats()
    pairs = PreviewVectors(flow)
    background = replace(a_step(), pulses=PulseOrder("laser", 80.0, 10.0, 1, is_background=True))
    for number, frame in enumerate(frames):
        pairs.see(background, number, frame, time.monotonic_ns())
    time.sleep(0.2)
    pairs.close()
    assert flow.vectors is None


def test_a_share_is_said_of_what_it_is():
    assert LiveVectors(0, 0.0, (1.0, 2.0), 3.0, 0.14).sentence().endswith("14 % of the windows measured")


def test_vectors_take_no_more_than_their_share(monkeypatch):
    def slow(pair):
        end_s = time.thread_time() + 0.05
        while time.thread_time() < end_s:
            pass
        return LiveVectors(pair.number, 0.0)

    monkeypatch.setattr(preview_vectors, "MOST_PER_S", 1000.0)
    monkeypatch.setattr(preview_vectors, "_measure", slow)
    flow, frame = PipelineStats(), np.zeros((8, 8), np.float32)
    pairs, begun_s, elapsed_s = PreviewVectors(flow), time.monotonic(), 0.0
    number = 0
    while elapsed_s < 0.8 or (flow.vectors_live < 2 and elapsed_s < 30.0):  # others may hold up a low priority
        pairs.see(a_step(), number, frame, time.monotonic_ns())
        time.sleep(0.005)
        number, elapsed_s = number + 1, time.monotonic() - begun_s
    pairs.close()
    elapsed_s = time.monotonic() - begun_s
    assert 2 <= flow.vectors_live <= 1.5 + preview_vectors.PREVIEW_DUTY * elapsed_s / 0.05


@pytest.mark.parametrize("bad", [np.zeros((384, 384)), np.full((384, 384), np.nan), np.zeros((10, 10))])
def test_frames_that_show_nothing_say_so_in_a_sentence(bad):
    flow = PipelineStats()
    pairs = PreviewVectors(flow)
    for number in range(2):
        pairs.see(a_step(), number, bad.astype(np.float32), time.monotonic_ns())
    assert wait_for(lambda: flow.vectors is not None)
    pairs.close()
    assert flow.vectors.sentence().startswith("none: ")
    assert len(flow.vectors.remark) > 10


def test_a_newer_pair_takes_the_place_of_one_that_waits(monkeypatch):
    gate, seen = threading.Event(), []

    def slow(pair):
        seen.append(pair.number)
        gate.wait(10.0)
        return LiveVectors(pair.number, 0.0)

    monkeypatch.setattr(preview_vectors, "_measure", slow)
    flow = PipelineStats()
    pairs = PreviewVectors(flow)
    frame, begun = np.zeros((8, 8), np.float32), time.monotonic()
    for number in range(40):
        pairs.see(a_step(), number, frame, 0)
        if number == 1:
            assert wait_for(lambda: seen == [0])
    assert time.monotonic() - begun < 5.0  # nobody waited
    gate.set()
    assert wait_for(lambda: flow.vectors_live == 2)
    pairs.close()
    assert seen == [0, 38]


def test_the_threads_lose_nothing_to_vectors_that_never_end(tmp_path, monkeypatch):
    """Every raw frame is written and every frame corrected while the measurement of a pair hangs."""
    gate = threading.Event()
    monkeypatch.setattr(
        preview_vectors, "_measure", lambda pair: gate.wait(60.0) and LiveVectors(pair.number, 0.0)
    )
    folder = RunFolder.create(tmp_path, "p", about_run([planned(0, "t", frames=40)]))
    journal, memory, corrections = Journal(folder.journal_path), Memory(), Doubler()
    pipeline = Pipeline(folder, journal, corrections, live_queue=40)
    for number in range(40):
        pipeline.submit(Job(a_step(), number, memory.frame(number), dict(PLACES)))
        time.sleep(0.005)
    pipeline.flush()
    assert wait_for(lambda: len(corrections.made) + len(pipeline.stats.skipped) == 40)
    assert pipeline.stats.written == 40
    assert not memory.out
    gate.set()
    pipeline.close()
    journal.close()
    assert pipeline.stats.corrected == len(corrections.made)


@pytest.mark.parametrize("live_queue", [1, 2, 4])
def test_a_lane_at_half_the_needed_speed_still_gives_vectors(tmp_path, monkeypatch, live_queue):
    """What is left out is left out in pairs: nearly every frame that is corrected serves a vector."""
    monkeypatch.setattr(preview_vectors, "_measure", lambda pair: LiveVectors(pair.number, 0.0))
    monkeypatch.setattr(preview_vectors, "MOST_PER_S", 1000.0)
    folder = RunFolder.create(tmp_path, "p", about_run([planned(0, "t", frames=80)]))
    journal, memory, corrections = Journal(folder.journal_path), Memory(), Doubler(duration_s=0.02)
    pipeline = Pipeline(folder, journal, corrections, live_queue=live_queue)
    for number in range(80):
        pipeline.submit(Job(a_step(), number, memory.frame(number), dict(PLACES)))
        time.sleep(0.01)
    pipeline.flush()
    pipeline.close()
    journal.close()
    assert pipeline.stats.skipped
    assert not memory.out
    pairs_corrected = {number // 2 for number in corrections.made}
    assert len(corrections.made) == 2 * len(pairs_corrected)
    assert pipeline.stats.vectors_live >= 0.7 * len(pairs_corrected) >= 5


def test_warming_up_measures_something():
    preview_vectors.warm_up()
