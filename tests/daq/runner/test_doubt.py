"""A run with an ambiguous frame is never done: the journal says so at once, resuming is refused."""

import json
import time
from dataclasses import replace

import pytest

from daq.cameras import camera as waiting
from daq.cameras.files import FilesCamera
from daq.cameras.frame import Frame
from daq.errors import BadBalance, FrameDoubt, ResumeRefused
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin, reopen
from daq.runs.raw_frame import read_raw
from daq.runs.run_check import check_run
from daq.runs.run_folder import frame_entries
from sim.camera.config import CameraConfig, FaultPlan
from tests.daq.cameras.rigs import RIGS
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load, write_frames
from tests.slow_cases import slow_but


@pytest.fixture
def run(tmp_path):
    bench, plan = load(tmp_path, SHIFT, camera=FILES_CAMERA)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    return bench, plan, folder, write_frames(tmp_path / "frames_in", 40)


class Blind(FilesCamera):
    """Tells neither time nor ids; the frame of one trigger comes after its timeout."""

    late = 3

    def __init__(self, folder):
        super().__init__(folder)
        self.triggers = 0

    def clock_ns(self):
        return None

    def trigger(self):
        self.triggers += 1
        self.is_due_s = time.monotonic() + (0.4 if self.triggers == self.late else 0.0)
        super().trigger()

    def poll(self, timeout_s):
        if time.monotonic() + timeout_s < self.is_due_s:
            time.sleep(timeout_s)
            return None
        frame = super().poll(timeout_s)
        return frame and Frame(frame.pixels, replace(frame.meta, timestamp_ns=0, id_told=False))

    def disarm(self):
        due = self._due_ns
        counters = super().disarm()
        self.left_behind = due
        return counters

    def arm(self, buffers=24):
        super().arm(buffers)
        self._due_ns.extend(getattr(self, "left_behind", None) or ())  # what was under way outlives a disarming


def check_refused(folder):
    assert not folder.is_done
    with pytest.raises(ResumeRefused, match="begin a new run"):
        reopen(folder.path)
    findings = {finding.part: finding.sound for finding in check_run(folder.path).findings}
    assert not findings["account"]


def test_a_frame_that_nothing_assigns_ends_the_run_for_good(run):
    bench, plan, folder, files = run
    with files_bench(bench, files, Blind) as hardware:
        with pytest.raises(FrameDoubt, match="neither its time nor its id"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        entries = folder.entries()
        assert [entry["kind"] for entry in entries][-3:] == ["doubt", "counts", "end"]
        assert all("neither its time nor its id" in entry["doubt"] for entry in entries[-3:])
        assert len(frame_entries(entries)) == Blind.late - 1
        with pytest.raises(ResumeRefused, match="begin a new run"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    check_refused(folder)


class Miscounting(FilesCamera):
    """Says that it delivered a frame more than anybody got."""

    def disarm(self):
        counters = super().disarm()
        return replace(counters, delivered=counters.delivered + 1)


def test_books_that_do_not_balance_are_not_forgotten_by_resuming(run):
    """Before, the next session had nothing left to do and wrote done.json."""
    bench, plan, folder, files = run
    with files_bench(bench, files, Miscounting) as hardware:
        with pytest.raises(BadBalance, match="do not balance"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        counts, end = folder.entries()[-2:]
        assert (counts["kind"], end["kind"]) == ("counts", "end")
        assert "do not balance" in counts["doubt"]
        assert end["why"] == "BadBalance"
        with pytest.raises(ResumeRefused, match="do not balance"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    check_refused(folder)


@pytest.mark.parametrize("rig", slow_but(RIGS, "aravis", "memory"))  # test_late_frames has the other
@pytest.mark.parametrize("late_s", [{"1": 0.8, "4": 0.8}, pytest.param({"2": 0.8}, marks=pytest.mark.slow)])
def test_a_run_with_late_frames_is_right_and_whole(tmp_path, monkeypatch, rig, late_s):
    """Each frame carries its trigger, and each step's frame was triggered while that step was exposed."""
    monkeypatch.setattr(waiting, "PROBE_MIN_S", 10.0)  # a busy machine is no lost camera
    rig = RIGS[rig](tmp_path)
    bench, plan = load(tmp_path, SHIFT, camera=FILES_CAMERA + "  retakes: 20\n")
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    config = CameraConfig(width=64, height=16, row_time_us=20.0, faults=FaultPlan(late_s=late_s))
    camera = rig.make(config)
    try:
        with files_bench(bench, tmp_path, lambda folder: camera) as hardware:
            sent, real = {}, camera.trigger

            def trigger():
                sent[len(sent)] = runner.progress.step
                return real()

            camera.trigger = trigger
            runner = Runner(hardware, [RunCamera(hardware, folder)], plan.steps)
            done = runner.run()
    finally:
        rig.close()
    for number, entry in frame_entries(folder.entries()).items():
        assert sent[int(read_raw(folder.frame_path(number))[0][0, 0])] == entry["step"]
    books = done["conservation"]
    assert books["imbalance"] == 0
    assert books["triggered"] == len(sent), books
    assert books["triggered"] - books["written"] >= len(late_s), books
    assert json.loads((folder.path / "done.json").read_text())["frames"] == 8
