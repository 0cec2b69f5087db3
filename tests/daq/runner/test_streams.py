"""A stream keeps every frame that it has, books its gaps and goes on, whatever comes between."""

import json
import shutil

import numpy as np
import pytest
import tifffile

from daq.cameras.files import FilesCamera
from daq.errors import CameraLost, FramesLost, RunDamaged, RunInterrupted, SettingsChanged
from daq.runner import camera_session
from daq.runner.run_camera import RunCamera
from daq.runner.runner import Runner
from daq.runner.session import Request, begin, reopen
from daq.runs.gaps import gap_sentence
from daq.runs.raw_frame import read_raw
from daq.runs.run_check import check_run
from daq.runs.run_folder import frame_entries, steps_on_disk
from stages.errors import MotionStopped
from tests.daq.small_bench import SIDE_PX, files_bench, load

FRAMES = 60
PLAN = f"experiment: stream\nview: clear\nframes: {FRAMES}\n"
CAMERA = """camera:
  backend: files
  options: {folder: frames_in}
  settings: {TriggerMode: "Off", AcquisitionFrameRate: 500.0}
  buffers: 40
  timeout_s: 0.3
"""


def numbered_frames(folder, numbers):
    """Frames that carry their number in the first pixel; what is not numbered is a hole in the ids."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        image = np.full((SIDE_PX, SIDE_PX), 7, np.uint16)
        image[0, 0] = number
        tifffile.imwrite(folder / f"{number:05d}.tif", image)
    return folder


@pytest.fixture(scope="module")
def numbered(tmp_path_factory):
    return numbered_frames(tmp_path_factory.mktemp("numbered"), range(3 * FRAMES))


@pytest.fixture
def run(tmp_path, numbered):
    bench, plan = load(tmp_path, PLAN, camera=CAMERA)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    return bench, plan, folder, shutil.copytree(numbered, tmp_path / "frames_in")  # tests take some away


def go(run, camera_class=FilesCamera, folder=None, before=None):
    bench, plan, made, files = run
    with files_bench(bench, files, camera_class) as hardware:
        runner = Runner(hardware, [RunCamera(hardware, folder or made)], plan.steps)
        if before is not None:
            before(hardware, runner)
        return runner.run()


def kinds(folder, kind):
    return [entry for entry in folder.entries() if entry["kind"] == kind]


def shown(folder):
    """Number of every frame, and the number that its picture carries."""
    return {n: int(read_raw(folder.frame_path(n))[0][0, 0]) for n in sorted(frame_entries(folder.entries()))}


class Faulty(FilesCamera):
    """Does something else than a frame, once each: keys are the arm, and the frames that it has given by then."""

    faults: dict = {}  # noqa: RUF012

    def __init__(self, folder):
        super().__init__(folder)
        self.arms, self.given, self.left, self.forgotten = 0, 0, dict(self.faults), False

    def arm(self, buffers=24):
        super().arm(buffers)
        self.arms, self.given = self.arms + 1, 0

    def poll(self, timeout_s):
        fault = self.left.pop((self.arms, self.given), None)
        if fault is not None:
            fault(self)
        frame = super().poll(timeout_s)
        self.given += frame is not None
        return frame

    def configure(self, settings):
        self.forgotten = False
        return super().configure(settings)

    def verify(self):
        super().verify()
        if self.forgotten:
            raise SettingsChanged("the camera lost its settings (Gain = 3 reads 0); configure it again")


def unplugged(camera):
    raise CameraLost("somebody stepped on the cable")


def forgets(camera):
    camera.forgotten = True


def with_faults(faults):
    return type("OnceFaulty", (Faulty,), {"faults": faults})


def test_a_whole_stream_has_no_gaps_and_no_further_arm(run):
    done = go(run)
    assert done["frames"] == FRAMES
    assert "gaps" not in done
    assert not kinds(run[2], "arm")
    assert all(number == picture for number, picture in shown(run[2]).items())


def test_one_lost_frame_neither_ends_nor_repeats_the_run(run):
    numbered_frames(run[3], [])
    (run[3] / "00023.tif").unlink()
    done = go(run)
    assert done["frames"] == FRAMES - 1
    assert done["gaps"] == [{"step": 0, "tag": "stream_clear", "gaps": [[23, 23]]}]
    assert kinds(run[2], "step")[0]["gaps"] == [[23, 23]]
    assert gap_sentence(done["gaps"][0]["gaps"], FRAMES) == f"1 of {FRAMES} frames never came: 23"
    assert done["conservation"]["missing"] == 1
    assert done["conservation"]["imbalance"] == 0
    assert all(number == picture for number, picture in shown(run[2]).items())
    assert check_run(run[2].path).is_sound, check_run(run[2].path).findings


def test_more_gaps_than_the_plan_allows_end_it_and_resuming_goes_on_behind(run):
    for number in range(20, 28):  # more than a tenth
        (run[3] / f"{number:05d}.tif").unlink()
    with pytest.raises(FramesLost, match=r"8 of 29 frames are gone: 8 never arrived"):
        go(run)
    assert not run[2].is_done
    kept = shown(run[2])
    assert sorted(kept) == [*range(20), 28]
    numbered_frames(run[3], range(20, 28))
    done = go(run)
    assert done["gaps"][0]["gaps"] == [[20, 27], [29, 29]]
    assert kinds(run[2], "arm")[0]["frame"] == 30


def test_a_plan_that_wants_a_whole_stream_takes_it_again(run, tmp_path):
    bench, plan = load(tmp_path, PLAN + "gaps_at_most: 0\n", name="whole", camera=CAMERA)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "runs")
    (run[3] / "00023.tif").unlink()
    whole = (bench, plan, folder, run[3])
    with pytest.raises(FramesLost, match="1 of 25 frames are gone"):
        go(whole)
    numbered_frames(run[3], [23])
    assert go(whole)["frames"] == FRAMES
    assert len(kinds(folder, "discard")[0]["frames"]) == 24


def test_a_camera_that_is_lost_and_comes_back_goes_on_behind(run):
    done = go(run, with_faults({(1, 31): unplugged}))
    (arm,) = kinds(run[2], "arm")
    assert arm["frame"] == 32
    assert "stepped on the cable" in arm["why"]
    assert done["gaps"][0]["gaps"] == [[31, 31]]
    assert not kinds(run[2], "discard")
    assert done["conservation"]["imbalance"] == 0


def test_a_stream_that_dries_up_is_armed_again_until_nothing_comes(run):
    for number in range(40, 3 * FRAMES):
        (run[3] / f"{number:05d}.tif").unlink()
    done = go(run)  # every arm shows the files from the first one on
    assert done["frames"] == FRAMES
    assert [entry["frame"] for entry in kinds(run[2], "arm")] == [40]
    assert "the stream ended after 40 of 60 frames" in kinds(run[2], "arm")[0]["why"]


def test_frames_of_an_arm_whose_settings_were_lost_are_other_pictures(run):
    done = go(run, with_faults({(1, 20): unplugged, (2, 9): forgets}))
    (discarded,) = kinds(run[2], "discard")
    assert discarded["frames"] == list(range(20, FRAMES))
    assert [entry["frame"] for entry in kinds(run[2], "arm")] == [20, 20]
    assert done["frames"] == FRAMES
    assert done["conservation"]["imbalance"] == 0


def test_one_press_ends_a_stream_after_the_present_frame_and_keeps_it(run):
    def press(hardware, runner):
        runner._watcher = lambda progress: progress.frames == 17 and runner.interrupts.press()

    with pytest.raises(RunInterrupted, match="which keeps its frames"):
        go(run, before=press)
    assert sorted(shown(run[2])) == list(range(17))
    assert steps_on_disk(run[2].entries()) == set()
    done = go(run)
    assert kinds(run[2], "arm")[0]["frame"] == 18
    assert done["gaps"][0]["gaps"] == [[17, 17]]


def test_a_stop_ends_a_stream_while_it_waits_for_a_frame(run, tmp_path):
    """The next frame would come in a minute: it is given up at the next slice, and what was taken stays."""
    polled = []

    class Slow(Faulty):
        def poll(self, timeout_s):
            if self.given < 5:
                return super().poll(timeout_s)
            polled.append(timeout_s)
            if len(polled) == 3:
                hardware_of[0].stage.stop()
            return None

    hardware_of = []
    bench, plan = load(tmp_path / "slow", PLAN, camera=CAMERA.replace("timeout_s: 0.3", "timeout_s: 60.0"))
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, tmp_path / "slow")
    files = run[3]
    with files_bench(bench, files, Slow) as hardware:
        hardware_of.append(hardware)
        with pytest.raises(MotionStopped):
            Runner(hardware, [RunCamera(hardware, folder)], plan.steps).run()
        assert len([wait_s for wait_s in polled if wait_s]) == 3
        assert max(polled) <= camera_session.SLICE_S
        hardware.stage.clear_stop()
    assert sorted(shown(folder)) == list(range(5))


def test_a_held_bench_exposes_nothing(run):
    with files_bench(run[0], run[3]) as hardware:
        taken = camera_session.CameraSession(hardware.camera, hardware.camera_section, hardware.stage.latch)
        taken.set_up()
        frames = taken.frames(5)
        next(frames)[1].release()
        hardware.stage.stop()
        with pytest.raises(MotionStopped):
            next(frames)
        with pytest.raises(MotionStopped):
            taken.frames(5)
        hardware.stage.clear_stop()
        next(taken.frames(5))[1].release()


def test_a_damaged_frame_of_an_unfinished_stream_is_noticed_before_it_counts(run):
    def press(hardware, runner):
        runner._watcher = lambda progress: progress.frames == 9 and runner.interrupts.press()

    with pytest.raises(RunInterrupted):
        go(run, before=press)
    path = run[2].frame_path(4)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(RunDamaged, match="000004"):
        reopen(run[2].path)


def test_done_json_of_a_stream_can_be_read_back(run):
    (run[3] / "00003.tif").unlink()
    go(run)
    tree = json.loads((run[2].path / "done.json").read_text())
    assert tree["gaps"] == [{"step": 0, "tag": "stream_clear", "gaps": [[3, 3]]}]
