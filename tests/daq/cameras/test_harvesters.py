"""What only the Harvesters backend has: a process of its own, its watchdog, foreign producers."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from daq.cameras import make_camera
from daq.cameras.harvesters import HarvestersCamera
from daq.errors import CameraLost, CameraSetupError
from daq.runner.step_readings import camera_facts
from sim.camera.config import CameraConfig, FaultPlan
from sim.camera.gentl import write_producer
from tests.daq.cameras.rigs import need_harvesters
from tests.slow_cases import slow

SOFTWARE = {"TriggerSelector": "FrameStart", "TriggerMode": "On", "TriggerSource": "Software"}


@pytest.fixture
def make(tmp_path):
    need_harvesters()
    made = []

    def opened(**changes):
        settings = {"width": 64, "height": 16, "row_time_us": 20.0} | changes
        cti = write_producer(tmp_path / f"{len(made)}.cti", [CameraConfig(**settings)])
        made.append(HarvestersCamera(cti))
        made[-1].open()
        return made[-1]

    yield opened
    for camera in made:
        camera.close()


@pytest.mark.slow
def test_a_process_that_hangs_is_ended_in_time(make):
    camera = make()
    camera.configure(SOFTWARE)
    camera.arm()
    os.kill(camera._process.pid, signal.SIGSTOP)  # as a producer that hangs inside a C call
    start = time.monotonic()
    with pytest.raises(CameraLost, match="no answer"):
        camera.next_frame(0.6)
    assert time.monotonic() - start < 1.5 * 0.6 + 0.5
    assert camera._process is None  # ended, not left behind
    camera.close()
    camera.open()
    camera.configure(SOFTWARE)
    camera.arm()
    camera.trigger()
    assert camera.next_frame(2.0).meta.sequence == 0


def test_a_process_that_dies_is_a_lost_camera(make):
    camera = make()
    camera.arm()
    os.kill(camera._process.pid, signal.SIGKILL)
    with pytest.raises(CameraLost, match="process has ended"):  # noqa: PT012
        while True:  # some may have come before
            camera.next_frame(1.0).release()


@pytest.mark.parametrize("wait", [HarvestersCamera.trigger, slow(lambda camera: camera.poll(0.1))])
def test_a_camera_that_was_lost_between_steps_is_still_lost_when_frames_are_waited_for(make, wait):
    """A run asks for the clock between steps and lets it pass: who waits for frames is to find out."""
    camera = make()
    camera.configure(SOFTWARE)
    camera.arm()
    camera._process.kill()
    assert camera_facts(camera) == {}
    with pytest.raises(CameraLost, match="process has ended"):
        wait(camera)


@pytest.mark.parametrize("number", [slow(signal.SIGINT), signal.SIGHUP])
def test_what_a_terminal_sends_is_for_the_parent_to_decide(make, number):
    """A closed window ends a run after its step; the camera must live as long."""
    camera = make()
    camera.configure(SOFTWARE)
    camera.arm()
    os.kill(camera._process.pid, number)
    time.sleep(0.2)
    camera.trigger()
    assert camera.next_frame(2.0).meta.sequence == 0


SCRIPT = """
import sys
from daq.cameras import make_camera

camera = make_camera("harvesters", cti=sys.argv[1])
camera.open()
camera.configure({"TriggerMode": "On", "TriggerSource": "Software"})
camera.arm()
camera.trigger()
with camera.next_frame(30.0) as frame:
    print("took", frame.pixels.shape)
if sys.argv[2] == "leave":
    sys.exit()
camera.close()
"""


@pytest.mark.parametrize("ending", [slow("close"), "leave"])
def test_a_script_needs_no_guard_and_may_stand_beside_any_file(tmp_path, ending):
    """The camera's process neither runs the caller's script again nor looks into the folder it was started in."""
    need_harvesters()
    cti = write_producer(tmp_path / "sim.cti", [CameraConfig(width=64, height=16)])
    (tmp_path / "script.py").write_text(SCRIPT)
    here = tmp_path / "here"
    here.mkdir()
    for name in ("daq.py", "numpy.py", "genicam.py"):
        (here / name).write_text("raise SystemExit('this is the wrong one')")
    command = [sys.executable, str(tmp_path / "script.py"), str(cti), ending]
    done = subprocess.run(command, cwd=here, capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout == "took (16, 64)\n", done.stderr
    assert done.returncode == 0
    assert done.stderr == ""


@pytest.mark.posix("a GenTL producer")
@pytest.mark.parametrize("lost_at", [None, 1])
def test_the_process_ends_without_a_word_with_a_caller_that_is_killed(tmp_path, lost_at):
    """Also with a camera that went before, as a simulated one goes with its world."""
    need_harvesters()
    config = CameraConfig(width=64, height=16, faults=FaultPlan(lost_at=lost_at))
    cti = write_producer(tmp_path / "sim.cti", [config])
    ends = "camera.trigger(); print(camera._process.pid, flush=True); sys.stdin.read()"
    text = SCRIPT.replace("camera.close()", ends)
    (tmp_path / "script.py").write_text(text)
    command = [sys.executable, str(tmp_path / "script.py"), str(cti), "stay"]
    pipe = subprocess.PIPE
    caller = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
    assert caller.stdout.readline().startswith("took")
    number = int(caller.stdout.readline())
    time.sleep(0.3 if lost_at else 0.0)
    caller.kill()
    assert caller.communicate()[1] == ""
    deadline = time.monotonic() + 60
    while Path(f"/proc/{number}").exists() and "Z" not in Path(f"/proc/{number}/stat").read_text().split()[2]:
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.slow
def test_a_producer_that_keeps_pythons_lock_delivers_all_the_same(make):
    camera = make(hold_gil=True)
    camera.configure({"AcquisitionFrameRate": 50.0, "TriggerMode": "Off"})
    camera.arm()
    ids = [camera.next_frame(2.0).copy().meta.sequence for _ in range(25)]
    assert ids == list(range(25))
    assert camera.disarm().missing == 0


def test_a_missing_or_foreign_file_is_a_setup_error(tmp_path):
    need_harvesters()
    with pytest.raises(CameraSetupError, match=r"no GenTL producer"):
        HarvestersCamera(tmp_path / "none.cti").open()
    (tmp_path / "text.cti").write_text("not a library")
    with pytest.raises(CameraSetupError, match="lists: none"):
        HarvestersCamera(tmp_path / "text.cti").open()


@pytest.mark.slow
def test_a_serial_number_that_is_not_there_names_those_that_are(tmp_path):
    need_harvesters()
    cti = write_producer(tmp_path / "two.cti", [CameraConfig(serial="A1"), CameraConfig(serial="A2")])
    with pytest.raises(CameraSetupError, match="A1, A2"):
        HarvestersCamera(cti, "A3").open()
    camera = HarvestersCamera(cti, "A2")
    camera.open()
    assert camera.info.serial == "A2"
    camera.close()


def test_the_producer_of_the_genicam_wheel():
    """A producer and a camera that are not ours: no trigger, no exposure time, no time stamps."""
    need_harvesters()
    import genicam

    cti = Path(genicam.__file__).parent / "viky.cti"
    if not cti.is_file():
        pytest.skip("this genicam wheel carries no viky.cti")
    camera = make_camera("harvesters", cti=cti)
    camera.open()
    assert camera.info.model == "Viky"
    back = camera.configure({"PixelFormat": "Mono8", "Width": 400, "Height": 300})
    assert back == {"PixelFormat": "Mono8", "Width": 400, "Height": 300}
    camera.arm()
    frames = [camera.next_frame(3.0).copy() for _ in range(5)]
    counters = camera.disarm()
    camera.close()
    assert all(frame.pixels.shape == (300, 400) for frame in frames)
    assert [frame.meta.sequence for frame in frames] == list(range(5))
    assert counters.ignored_triggers is None  # it cannot tell, and we do not say zero
    assert np.isnan(frames[0].meta.exposure_us)
    # A ball bounces before a bright wall, in the units of Mono8.
    assert frames[0].pixels.max() == 255
    assert frames[0].pixels.min() < 50
    assert not np.array_equal(frames[0].pixels, frames[4].pixels)


def test_its_process_does_not_wait_for_what_reads_bench_files():
    need_harvesters()
    code = "import sys, rtpiv, daq.cameras.harvesters_worker; sys.exit('pydantic' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
