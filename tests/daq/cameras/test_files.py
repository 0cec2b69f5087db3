"""A folder as a camera: what a recorded run shows, holes included."""

import numpy as np
import pytest
import tifffile

from daq.cameras import make_camera
from daq.cameras.camera import Camera
from daq.errors import BadFrame, CameraSetupError, CameraTimeout, CameraUsageError, SettingRefused


@pytest.fixture
def folder(tmp_path):
    for number in (7, 8, 10):
        tifffile.imwrite(tmp_path / f"{number:06d}.tif", np.full((6, 9), number, np.uint16))
    return tmp_path


def test_shows_files_in_order_and_counts_the_hole(folder):
    camera = make_camera("files", folder=folder)
    assert isinstance(camera, Camera)
    camera.open()
    camera.configure({"TriggerMode": "On", "TriggerSource": "Software"})
    camera.arm()
    for _ in range(3):
        camera.trigger()
    frames = [camera.next_frame(0.5) for _ in range(3)]
    assert [f.pixels[0, 0] for f in frames] == [7, 8, 10]
    assert [f.meta.sequence for f in frames] == [0, 1, 3]
    assert camera.disarm().missing == 1


def test_free_run_keeps_its_rate_and_ends(folder):
    camera = make_camera("files", folder=folder)
    camera.open()
    camera.configure({"AcquisitionFrameRate": 50.0})
    camera.arm()
    frames = [camera.next_frame(0.2) for _ in range(3)]
    with pytest.raises(CameraTimeout):
        camera.next_frame(0.2)
    times_ms = np.diff([f.meta.timestamp_ns for f in frames]) / 1e6
    np.testing.assert_allclose(times_ms, 20.0, atol=1e-3)


def test_repeating_ids_go_on_rising(folder):
    camera = make_camera("files", folder=folder, repeat=True)
    camera.open()
    camera.configure({"AcquisitionFrameRate": 500.0})
    camera.arm()
    assert [camera.next_frame(0.5).meta.frame_id for _ in range(5)] == [7, 8, 10, 18, 19]


def test_triggers_beyond_the_buffers_are_counted(folder):
    camera = make_camera("files", folder=folder)
    camera.open()
    camera.configure({"TriggerMode": "On"})
    camera.arm(buffers=2)
    for _ in range(5):
        camera.trigger()
    assert camera.counters.ignored_triggers == 3


def test_misuse_and_damage_have_their_own_errors(folder):
    with pytest.raises(CameraSetupError, match=r"no \.tif"):
        make_camera("files", folder=folder.parent / folder.name / "..").open()
    camera = make_camera("files", folder=folder)
    with pytest.raises(CameraUsageError):
        camera.arm()
    camera.open()
    for bad in ({"Width": 10}, {"TriggerMode": "Maybe"}, {"Shutter": 1}, {"Gain": float("nan")}):
        with pytest.raises(SettingRefused):
            camera.configure(bad)
    camera.configure({"TriggerMode": "On"})
    camera.arm()
    with pytest.raises(CameraTimeout, match="TriggerMode On"):
        camera.next_frame(0.01)
    (folder / "000007.tif").write_bytes(b"no tiff at all")
    camera.trigger()
    with pytest.raises(BadFrame):
        camera.next_frame(0.1)


def test_unknown_backends_and_options_are_setup_errors():
    with pytest.raises(CameraSetupError, match="harvesters"):
        make_camera("firewire")
    with pytest.raises(CameraSetupError):
        make_camera("files", directory="x")
    with pytest.raises(CameraSetupError):
        make_camera("no.such.module:Camera")
