"""The runner over byte protocols and a folder as camera: order, books, what comes between, and going on."""

import errno
import json
import threading
import time

import pytest

from daq.bench.rehearsal import Rehearsal
from daq.cameras.files import FilesCamera
from daq.errors import CameraLost, DiskError, FramesLost, ResumeRefused, RunDamaged, RunInterrupted
from daq.pipeline import pipeline as pipeline_module
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin, check_disk, reopen
from daq.runs.journal import Journal
from daq.runs.raw_frame import checksum, read_raw, write_raw
from daq.runs.run_folder import RunFolder, frame_entries, steps_on_disk
from stages.errors import DeviceLost, MotionStopped
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load, write_frames
from tests.slow_cases import slow

PLAN = SHIFT + "frames: 2\n"


@pytest.fixture
def files(tmp_path):
    return write_frames(tmp_path / "frames_in", 40)


@pytest.fixture
def bench_and_plan(tmp_path):
    return load(tmp_path, PLAN, camera=FILES_CAMERA)


@pytest.fixture
def folder(tmp_path, bench_and_plan):
    bench, plan = bench_and_plan
    return begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")


def kinds(folder):
    return [entry["kind"] for entry in folder.entries()]


def assert_complete(folder, plan):
    """Every planned frame once, with the checksum of the journal, and books that balance."""
    frames = frame_entries(folder.entries())
    assert sorted(frames) == [number for step in plan.steps for number in step.numbers]
    for number, entry in frames.items():
        pixels, about = read_raw(folder.frame_path(number))
        assert checksum(pixels) == entry["crc32"] == about["crc32"]
    names = [path.name for path in sorted((folder.path / "frames").iterdir())]
    assert names == [f"{number:06d}.tif" for number in sorted(frames)]
    done = json.loads((folder.path / "done.json").read_text())
    assert done["conservation"]["imbalance"] == 0
    assert done["conservation"]["written"] == len(frames)
    return done


def test_a_whole_run(bench_and_plan, folder, files):
    bench, plan = bench_and_plan
    with files_bench(bench, files) as hardware:
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    done = assert_complete(folder, plan)
    assert done["conservation"]["triggered"] == 16
    assert kinds(folder)[0] == "session"
    assert kinds(folder)[-2:] == ["counts", "end"]
    for entry in folder.entries():
        if entry["kind"] == "step":
            step = plan.steps[entry["step"]]
            assert entry["planned_mm"] == step.targets_mm
            for name, mm in step.targets_mm.items():
                assert abs(entry["measured_mm"][name] - mm) <= 10e-3
    first = read_raw(folder.frame_path(0))[1]
    assert first["timestamp_ns"] > 0
    assert first["received_ns"] >= first["timestamp_ns"]
    assert first["true_mm"]["target_x"] != first["planned_mm"]["target_x"]


def test_frames_enter_the_journal_before_their_step(bench_and_plan, folder, files):
    bench, plan = bench_and_plan
    with files_bench(bench, files) as hardware:
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    seen = set()
    for entry in folder.entries():
        if entry["kind"] == "frame":
            seen.add(entry["frame"])
        if entry["kind"] == "step":
            assert set(plan.steps[entry["step"]].numbers) <= seen


@pytest.mark.parametrize("step", [slow(0), 3, slow(7)])
def test_ctrl_c_once_finishes_the_step_and_resume_does_the_rest(bench_and_plan, folder, files, step):
    bench, plan = bench_and_plan

    def press(progress):
        if progress.step == step and progress.doing == "exposing" and not runner.interrupts.is_end_wanted:
            runner.interrupts.press()

    with files_bench(bench, files) as hardware:
        runner = Runner(hardware, [RunCamera(hardware, folder)], plan.steps, watcher=press)
        if step == 7:  # asked for in the last step: nothing is left to interrupt
            runner.run()
        else:
            with pytest.raises(RunInterrupted, match=f"{7 - step} of 8 steps left"):
                runner.run()
        assert steps_on_disk(folder.entries()) == set(range(step + 1))
        if step != 7:
            assert not folder.is_done
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    done = assert_complete(folder, plan)
    assert [session["ended"] for session in done["sessions"]][-1] == "finished"


def test_ctrl_c_twice_stops_from_another_thread_and_the_run_can_go_on(bench_and_plan, folder, files):
    """What the second press does to real motion is shown by tests/system on pseudo-terminals."""
    bench, plan = bench_and_plan
    with files_bench(bench, files) as hardware:
        stopper = []
        runner = Runner(hardware, [RunCamera(hardware, folder)], plan.steps)
        runner.interrupts._stop_now = lambda: stopper.append(threading.current_thread())
        real_move = hardware.stage.move

        def move(targets):
            runner.interrupts.press()
            runner.interrupts.press()
            while not stopper:
                time.sleep(0.001)
            raise MotionStopped("glass_z was stopped")

        hardware.stage.move = move
        with pytest.raises(RunInterrupted, match=r"stopped on the way to step 1 \(particles_clear_d0_r0_a\)"):
            runner.run()
        assert stopper[0] is not threading.main_thread()
        assert folder.entries()[-1]["why"] == "RunInterrupted"
        hardware.stage.move = real_move
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    assert_complete(folder, plan)


def test_pause_waits_between_steps(bench_and_plan, folder, files):
    bench, plan = bench_and_plan
    with files_bench(bench, files) as hardware:
        runner = Runner(hardware, [RunCamera(hardware, folder)], plan.steps)
        runner.interrupts.pause()
        thread = threading.Timer(0.5, runner.interrupts.go_on)
        thread.start()
        begun = time.monotonic()
        runner.run()
        assert time.monotonic() - begun >= 0.5
    assert_complete(folder, plan)


class Flaky(FilesCamera):
    """Lost at some frames; back after it was opened again."""

    def __init__(self, folder, at=(5,), forever=False):
        super().__init__(folder)
        self.asked, self.at, self.forever, self.is_gone = 0, at, forever, False

    def open(self):
        super().open()
        self.is_gone = False

    def poll(self, timeout_s):
        self.asked += timeout_s > 0.0  # looking whether something lies there is no waiting for a frame
        self.is_gone |= timeout_s > 0.0 and self.asked in self.at
        if self.is_gone or (self.forever and self.asked >= self.at[0]):
            raise CameraLost("somebody stepped on the cable")
        return super().poll(timeout_s)

    def disarm(self):
        if self.asked in self.at:
            super().disarm()
            raise CameraLost("still gone")
        return super().disarm()


def test_camera_lost_and_back_repeats_the_step(bench_and_plan, folder, files):
    """Lost at the second frame of step 2: its first frame is discarded, both are taken again."""
    bench, plan = bench_and_plan
    with files_bench(bench, files, lambda folder: Flaky(folder, at=(6,))) as hardware:
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    done = assert_complete(folder, plan)
    assert [entry["frames"] for entry in folder.entries() if entry["kind"] == "discard"] == [[4]]
    assert done["conservation"]["rejected"] == 1
    assert done["conservation"]["lost"] == 1
    assert done["conservation"]["triggered"] == 18


def test_camera_lost_for_good_ends_the_run_resumable(bench_and_plan, folder, files, monkeypatch):
    bench, plan = bench_and_plan
    monkeypatch.setattr("daq.runner.step_frames.RETRY_S", 0.01)
    with files_bench(bench, files, lambda folder: Flaky(folder, at=(6,), forever=True)) as hardware:
        with pytest.raises(CameraLost, match="stepped on the cable"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        assert steps_on_disk(folder.entries()) == {0, 1}
        assert folder.entries()[-1]["why"] == "CameraLost"
    with files_bench(bench, files) as hardware:
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    assert_complete(folder, plan)


def test_no_frame_at_all_is_said(bench_and_plan, folder, tmp_path):
    bench, plan = bench_and_plan
    few = write_frames(tmp_path / "few", 3)

    class Short(FilesCamera):
        def arm(self, buffers=24):
            shown = self._next_file
            super().arm(buffers)
            self._next_file = shown

    with files_bench(bench, few, Short) as hardware, pytest.raises(FramesLost, match="after 4 triggers"):
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    counts = next(entry for entry in folder.entries() if entry["kind"] == "counts")
    assert counts["books"]["silent"] == 4
    assert counts["books"]["imbalance"] == 0


class Disk:
    """Has room for so many frames and lines of the journal."""

    def __init__(self, monkeypatch, frames, lines):
        self.frames, self.lines = frames, lines
        write_line = Journal._write

        def write(journal, line):
            self.lines -= 1
            if self.lines < 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            write_line(journal, line)

        monkeypatch.setattr(pipeline_module, "write_raw", self.write_frame)
        monkeypatch.setattr(Journal, "_write", write)

    def write_frame(self, path, pixels, about):
        self.frames -= 1
        if self.frames < 0:
            raise DiskError(f"{path}: No space left on device; make room, then resume the run")
        write_raw(path, pixels, about)

    def make_room(self):
        self.frames = self.lines = 1000


@pytest.mark.parametrize(("frames", "lines"), [
    (5, 1000), (1000, 4), *(slow(frames, 1000) for frames in (0, 1, 3, 8, 12, 15)),
    *(slow(1000, lines) for lines in (*range(4), *range(5, 29))),
])  # fmt: skip
def test_a_full_disk_ends_the_run_at_rest_and_resume_does_the_rest(
    bench_and_plan, folder, files, monkeypatch, frames, lines
):
    """Wherever it is full: of frames, or of the journal, whose lines are of the session, frames and steps."""
    bench, plan = bench_and_plan
    disk = Disk(monkeypatch, frames, lines)
    with files_bench(bench, files) as hardware:
        with pytest.raises(DiskError, match="No space left"):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        places_mm = hardware.simulation.true_mm()
        hardware.clock.sleep_s(30.0)
        assert hardware.simulation.true_mm() == places_mm
        counts = [entry for entry in folder.entries() if entry["kind"] == "counts"]
        disk.make_room()
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    done = assert_complete(folder, plan)
    for entry in counts:  # where there was room for them
        assert entry["books"]["imbalance"] == 0
        assert entry["books"]["unwritten"] == done["conservation"]["unwritten"] >= 1


def test_a_slow_disk_slows_the_run_and_loses_nothing(bench_and_plan, folder, files, monkeypatch):
    bench, plan = bench_and_plan

    def slow(path, pixels, about):
        time.sleep(0.03)
        write_raw(path, pixels, about)

    monkeypatch.setattr(pipeline_module, "write_raw", slow)
    with files_bench(bench, files) as hardware:
        done = Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    assert done["conservation"]["lost"] == 0
    assert_complete(folder, plan)


def test_a_dead_disk_is_named(bench_and_plan, folder, files, monkeypatch):
    bench, plan = bench_and_plan
    monkeypatch.setattr(pipeline_module, "DISK_TIMEOUT_S", 0.3)
    gate = threading.Event()

    def dead(*_):
        threading.Timer(1.5, gate.set).start()  # from then on: a busy computer may take long to get here
        gate.wait(20.0)

    monkeypatch.setattr(pipeline_module, "write_raw", dead)
    with files_bench(bench, files) as hardware, pytest.raises(DiskError, match=r"no frame was written for 0\.3 s"):
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()


def test_unplugged_stage_ends_the_run_and_forgets_its_position(bench_and_plan, folder, files):
    bench, plan = bench_and_plan
    rehearsal = Rehearsal([{"what": "unplug", "of": "target", "step": 4}])
    with files_bench(rehearsal.of(bench, len(plan.steps)), files) as hardware:
        with pytest.raises(DeviceLost):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        assert hardware.simulation.event_log().faults == ["unplug of target at step 4"]
        assert hardware.stage.where_mm()["target_x"] is None
        assert steps_on_disk(folder.entries()) == {0, 1, 2}
    with files_bench(bench, files) as hardware:
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    assert_complete(folder, plan)


@pytest.mark.parametrize("what", ["plan", "bench", "scene"])
def test_resume_is_refused_if_a_file_means_something_else(tmp_path, folder, what):
    reopen(folder.path)
    path, old, new = {
        "plan": (tmp_path / "plan.yaml", "mm: 0.5", "mm: 0.6"),
        "bench": (tmp_path / "bench.yaml", "settle_s: 0.5", "settle_s: 0.6"),
        "scene": (tmp_path / "scene.yaml", "radius_mm: 25.0", "radius_mm: 24.9"),
    }[what]
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(ResumeRefused, match=f"the {what} is another than when the run began"):
        reopen(folder.path)


def test_resume_of_a_finished_run_or_with_missing_files_is_refused(bench_and_plan, folder, files):
    bench, plan = bench_and_plan
    with files_bench(bench, files) as hardware:
        Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
    with pytest.raises(ResumeRefused, match="is finished"):
        reopen(folder.path)
    (folder.path / "done.json").unlink()
    folder.frame_path(3).unlink()
    with pytest.raises(RunDamaged, match=r"frames/000003\.tif is missing.*--retake"):
        reopen(RunFolder.open(folder.path).path)


def test_too_small_a_disk_is_refused_before_the_run(tmp_path):
    with pytest.raises(DiskError, match="make room, or choose another folder"):
        check_disk(tmp_path, 10**15)
    check_disk(tmp_path, 1)
