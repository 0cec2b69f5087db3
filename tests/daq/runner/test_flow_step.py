"""A flow on the simulated bench, over protocols and transports: whole pairs of one pulse each, and books."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import tifffile

from daq.errors import FrameDoubt, FramesLost, PlanError, ResumeRefused, RunUsageError
from daq.runner import flow_step, pair_writer
from daq.runner.laser_session import LaserSession, exposure_of, require_rate
from daq.runner.pair_finder import BrightnessSign
from daq.runs.pairs import pairs_of
from daq.runs.run_check import check_run
from daq.runs.run_folder import RunFolder, frame_entries
from daq.timing.pulses import Role
from rtpiv.verbs.operator import operator_of
from rtpiv.verbs.resume import resume
from sim import world
from sim.timing import SimulatedTiming
from tests.daq.cameras.rigs import need_aravis, need_harvesters
from tests.daq.flow_bench import DIODES, LAMPS, ToldLight, acquire_simulated, shows_particles, told, write_flow

ROOT = Path(__file__).resolve().parents[4]
FAULTS = "first_skipped: 3, skipped: [19, 50], doubled: [24], dropped: [30]"


@pytest.fixture(autouse=True)
def told_light(monkeypatch):
    need_harvesters()
    monkeypatch.setattr(world, "LitFlow", ToldLight)


def run(folder, **changes):
    """Acquire; the run folder."""
    bench, plan = write_flow(folder, **changes)
    return acquire_simulated(plan, bench, folder / "runs")


def chunks(path):
    return [entry for entry in RunFolder.open(path).entries() if entry["kind"] == "chunk"]


def judge(path, pairs):
    """Every pair is whole, lit once in each frame by the two pulses of one pair; the books of pairs balance."""
    found = pairs_of(path)
    assert found.alone == ()
    assert len(found.pairs) == pairs
    shown = []
    for pair in found.pairs:
        first, second = (told(tifffile.imread(frame)) for frame in pair.frames)
        assert (first[0], first[2]) == (1, 0), "exposure A shows light 1 alone"
        assert (second[0], second[2]) == (1, 1), "exposure B shows light 2 alone"
        assert first[1] == second[1], "a pair of two different pulses"
        assert shows_particles(tifffile.imread(pair.frames[0])) != pair.is_background
        shown.append(first[1])
    assert shown == sorted(set(shown))
    for chunk in chunks(path):
        assert chunk["fired"] == chunk["pairs"] + chunk["surplus"] + chunk["lost"]
        frames = 2 * chunk["pairs"] + sum(chunk["dropped"].values()) + chunk["never_came"]
        assert frames == 2 * chunk["triggers"]
    times = [pair.time_s for pair in found.pairs]
    assert times == sorted(times)
    return found


@pytest.mark.parametrize(("shape", "channels", "faults", "backend"), [
    ("two_blocks", LAMPS, FAULTS, "harvesters"),
    pytest.param("straddling", DIODES, FAULTS, "aravis", marks=pytest.mark.slow),
    pytest.param("double_height", LAMPS, FAULTS, "harvesters", marks=pytest.mark.slow),
    pytest.param("double_height", DIODES, "", "aravis", marks=pytest.mark.slow),
    pytest.param("burst", DIODES, FAULTS, "harvesters", marks=pytest.mark.slow),
    pytest.param("burst", LAMPS, "", "aravis", marks=pytest.mark.slow),
    pytest.param("two_blocks by spacing", DIODES, FAULTS, "harvesters", marks=pytest.mark.slow),
])  # fmt: skip
def test_a_flow_keeps_whole_pairs_of_one_pulse_each(tmp_path, capsys, shape, channels, faults, backend):
    if backend == "aravis":
        need_aravis()
    dt_us = 19700.2 if shape == "straddling" else 100.2
    more = f"background: {{pairs: 4}}\nlost_at_most: 0.9\ndt_measured_us: {dt_us}\ndt_sigma_us: 0.1\n"
    path = run(tmp_path, shape=shape, channels=channels, faults=faults, backend=backend, more=more, chunk=15)
    found = judge(path, 24)
    assert [pair.is_background for pair in found.pairs] == [True] * 4 + [False] * 20
    assert {(round(1e6 * pair.dt_s, 6), pair.dt_sigma_s) for pair in found.pairs} == {(dt_us, 0.1e-6)}
    assert check_run(path).is_sound
    assert "24 are kept" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_a_marker_on_exposure_b_of_even_frames_ends_the_run_in_doubt(tmp_path, monkeypatch):
    need_aravis()
    listen, half_s = SimulatedTiming.listen, 0.02

    def later(self, role, hear):
        def late(pulse):
            hear(pulse._replace(rises_s=pulse.rises_s + half_s, falls_s=pulse.falls_s + half_s))

        listen(self, role, late if role is Role.MARKER else hear)

    monkeypatch.setattr(SimulatedTiming, "listen", later)
    with pytest.raises(FrameDoubt, match="ended with a frame that the marker calls A"):
        run(tmp_path, shape="straddling", channels=DIODES, backend="aravis", pairs=30, chunk=15)


@pytest.mark.slow
def test_the_end_may_be_asked_for_and_the_run_goes_on_with_whole_pairs(tmp_path, monkeypatch):
    """A frame is lost from the disk's records as by a kill between the two frames of a pair."""
    bench, plan = write_flow(tmp_path, channels=DIODES, pairs=12, chunk=6)
    kept = flow_step.FlowStep._keep
    count = 0

    def cut_off(self, *arguments):
        nonlocal count
        count += 1
        if count == 9:
            raise OSError("as if somebody pulled the plug")
        kept(self, *arguments)

    monkeypatch.setattr(flow_step.FlowStep, "_keep", cut_off)
    with pytest.raises(OSError, match="pulled the plug"):
        acquire_simulated(plan, bench, tmp_path / "runs")
    (path,) = (tmp_path / "runs").glob("*_plan-flow")
    lines = path.joinpath("steps.jsonl").read_bytes().splitlines(keepends=True)
    last = max(at for at, line in enumerate(lines) if line.startswith(b'{"kind":"frame"'))
    path.joinpath("steps.jsonl").write_bytes(b"".join(lines[:last]))
    before = {file.name: file.read_bytes() for file in (path / "frames").iterdir()}
    monkeypatch.setattr(flow_step.FlowStep, "_keep", kept)
    monkeypatch.setattr(pair_writer, "exposure_of", lambda settings: 300.0)
    with pytest.raises(ResumeRefused, match=r"exposed for 400 us .frame 0. and the camera is at 300 us now"):
        resume(path, home=True, operator="test")
    monkeypatch.setattr(pair_writer, "exposure_of", exposure_of)
    resume(path, home=True, operator="test")
    found = pairs_of(path)
    exposed = [entry["exposure_us"] for entry in frame_entries(RunFolder.open(path).entries()).values()]
    assert sorted(set(exposed)) == [192.0, 400.0]
    assert (len(found.pairs), found.alone) == (12, ())
    for pair in found.pairs:
        first, second = (told(tifffile.imread(frame)) for frame in pair.frames)
        assert first[1:] == (second[1], 0)
    same = [name for name, data in before.items() if (path / "frames" / name).read_bytes() == data]
    assert len(same) >= 14  # seven pairs at least stayed as they were
    assert check_run(path).is_sound


@pytest.mark.slow
@pytest.mark.parametrize("frames", [1, 3, 8, 14, 21, 30])
def test_a_flow_that_was_killed_goes_on_with_whole_pairs(tmp_path, frames):
    bench, plan = write_flow(tmp_path, channels=DIODES, pairs=24, chunk=8, more="background: {pairs: 4}\n")
    command = [sys.executable, "-m", "tests.daq.flow_child", bench, plan, tmp_path / "runs"]
    child = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while child.poll() is None and len(list((tmp_path / "runs").glob("*/frames/*.tif"))) < frames:
        time.sleep(0.001)
    child.send_signal(signal.SIGKILL)
    child.wait()
    (path,) = (tmp_path / "runs").glob("*_plan-flow")
    before = {file.name: file.read_bytes() for file in (path / "frames").glob("*.tif")}
    assert before
    resume(path, home=True, operator="test")
    found, shown = pairs_of(path), []
    assert (len(found.pairs), found.alone) == (28, ())
    for pair in found.pairs:
        first, second = (told(tifffile.imread(frame)) for frame in pair.frames)
        assert ((first[0], first[2]), (second[0], second[2]), first[1]) == ((1, 0), (1, 1), second[1])
        assert shows_particles(tifffile.imread(pair.frames[0])) != pair.is_background
        shown.append(first[1])
    assert len(set(shown)) == len(shown)  # a bench that goes on shows no pair again
    same = sum((path / "frames" / name).read_bytes() == data for name, data in before.items())
    assert same >= len(before) - 4  # what stood alone was taken again, nothing else
    assert check_run(path).is_sound


@pytest.mark.slow
def test_a_marker_that_nobody_wired_fires_one_chunk_and_ends(tmp_path):
    """Line 3 is never high: no frame is an A."""
    bench, plan = write_flow(tmp_path, channels=DIODES, pairs=20, chunk=10)
    bench.write_text(bench.read_text().replace("line: 2", "line: 3"))
    with pytest.raises(FramesLost, match=r"0 of 10 pairs that were fired are sure .20 frames without its partner"):
        acquire_simulated(plan, bench, tmp_path / "runs")


@pytest.mark.slow
def test_a_flip_ends_the_run_in_doubt(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(BrightnessSign, "is_flipped", lambda self, a, b: calls.append(1) or len(calls) == 4)
    bench, plan = write_flow(tmp_path, channels=DIODES, pairs=12, chunk=12)
    with pytest.raises(FrameDoubt, match="A and B have changed places"):
        acquire_simulated(plan, bench, tmp_path / "runs")
    (path,) = (tmp_path / "runs").glob("*_plan-flow")
    with pytest.raises(ResumeRefused, match="changed places"):
        resume(path, home=True, operator="test")


def test_nothing_is_fired_where_nobody_says_the_word(tmp_path, monkeypatch):
    bench, plan = write_flow(tmp_path, channels=DIODES)
    began = []
    monkeypatch.setattr("daq.timing.laser.Laser.fire", lambda self, pairs: began.append(pairs))
    with pytest.raises(RunUsageError, match="the code that arms the laser cannot be typed"):
        acquire_simulated(plan, bench, tmp_path / "runs", operator=None)
    watched, shown, prepare = [], [], LaserSession.prepare
    monkeypatch.setattr(
        LaserSession,
        "prepare",
        lambda self, order, settings, tell: prepare(
            self, order, settings, lambda doing: (shown.append(doing), tell(doing))
        ),
    )
    mistyped = lambda self, challenge, words: watched.append(words) or "wrong"  # noqa: E731
    monkeypatch.setattr("rtpiv.verbs.operator.ScriptOperator.confirmation_code", mistyped)
    with pytest.raises(RunUsageError, match="type the code"):
        acquire_simulated(plan, bench, tmp_path / "runs2")
    assert began == []
    assert "it was never proven on this bench" in shown[0], "what the live page says meanwhile"
    (words,) = watched
    assert "you alone watch them" in words
    assert "it was never proven on this bench (rtpiv laser prove)" in words


def test_a_script_cannot_answer_for_a_real_laser(tmp_path):
    with pytest.raises(RunUsageError, match="simulated laser only"):
        operator_of("me", simulate=False)


def test_what_the_camera_says_is_asked_before_anything_fires():
    require_rate({"ResultingFrameRate": 50.0}, 2, 25.0)
    with pytest.raises(RunUsageError, match="25 pairs/s are 50 frames/s, and the camera can take 40"):
        require_rate({"ResultingFrameRate": 40.0}, 2, 25.0)
    assert exposure_of({"ExposureTimeAbs": 40.0}) == 40.0
    with pytest.raises(PlanError, match="does not report its ExposureTime"):
        exposure_of({"ExposureTime": "long"})
