"""What only the Harvesters backend has: a process of its own, its watchdog, foreign producers."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from rigs import need_harvesters

from daq.cameras import make_camera
from daq.cameras.harvesters import HarvestersCamera
from daq.errors import CameraLost, CameraSetupError
from sim.camera.config import CameraConfig
from sim.camera.gentl import write_producer

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
