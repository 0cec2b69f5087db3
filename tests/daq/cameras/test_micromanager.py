"""Cameras by Micro-Manager: its real core with its demonstration camera, and a simulated one that misbehaves."""

import importlib.util
import threading
import time

import numpy as np
import pytest

from daq.bench.bench_file import load_bench
from daq.cameras import make_camera
from daq.cameras.camera import Camera
from daq.cameras.micromanager import MicroManagerCamera
from daq.errors import (
    BadFrame,
    CameraError,
    CameraLost,
    CameraSetupError,
    CameraTimeout,
    CameraUsageError,
    SettingRefused,
    SettingsChanged,
)
from daq.runs.run_check import check_run
from ground.errors import ConfigError
from sim.camera import core as module
from sim.camera.config import CameraConfig
from tests.daq.cameras.rigs import need_harvesters
from tests.daq.flow_bench import acquire_simulated
from tests.daq.small_bench import TARGET, write_bench

SOFTWARE = {"TriggerMode": "On", "TriggerSource": "Software"}


class Untrue(module.SimCore):
    """A core whose adapter does what `how` says."""

    how = ""
    until = threading.Event()

    def setProperty(self, label, name, value):  # noqa: N802
        if self.how != "takes nothing":
            super().setProperty(label, name, value)

    def startSequenceAcquisition(self, *arguments):  # noqa: N802
        if self.how == "hangs":
            self.until.wait(20.0)
        if self.how != "gives nothing":
            super().startSequenceAcquisition(*arguments)

    def popNextImageMD(self, tags):  # noqa: N802
        image = super().popNextImageMD(tags)
        if self.how == "counts nothing":
            tags.tags.pop("ImageNumber")
        return np.dstack([image] * 3) if self.how == "sends colours" else image


module.Untrue = Untrue


@pytest.fixture
def sim(tmp_path, monkeypatch):
    """Open a camera of the simulated core; an adapter may do something untrue."""
    opened = []
    (tmp_path / module.CONFIG).write_text(CameraConfig(width=40, height=24).to_json())

    def make(how="", **options):
        monkeypatch.setattr(Untrue, "how", how)
        monkeypatch.setattr(Untrue, "until", threading.Event())
        where = {"library": "SimCamera", "device": "Sim", "adapters": str(tmp_path)}
        opened.append(make_camera("micromanager", core="sim.camera.core:Untrue", **{**where, **options}))
        opened[-1].open()
        return opened[-1]

    yield make
    Untrue.until.set()
    for camera in opened:
        camera.close()


@pytest.fixture
def demo():
    if importlib.util.find_spec("mm_test_adapters") is None or importlib.util.find_spec("pymmcore") is None:
        pytest.skip("pymmcore or mm-test-adapters is not installed")
    import mm_test_adapters

    folder = str(mm_test_adapters.device_adapter_path())
    camera = MicroManagerCamera("DemoCamera", "DCam", folder, MaximumExposureMs=1000.0)
    camera.open()
    yield camera
    camera.close()


def pattern(trigger, bits=12):
    row, col = np.mgrid[0:24, 0:40].astype(object)
    image = ((3 * col + 5 * row + 7 * (row * col // 16) + 17 * trigger) % 4096).astype(np.uint16)
    image[0, 0] = trigger
    return image << (bits - 12) if bits > 12 else image >> (12 - bits)


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_every_pixel_of_every_format(sim, bits):
    camera = sim()
    camera.configure({**SOFTWARE, "PixelFormat": f"Mono{bits}", "ExposureTime": 2000.0})
    camera.arm()
    for number in range(3):
        camera.trigger()
        frame = camera.next_frame(2.0)
        np.testing.assert_array_equal(frame.pixels, pattern(number, bits))
        meta = frame.meta
        assert (meta.frame_id, meta.sequence, meta.significant_bits) == (number + 1, number, bits)
        assert (meta.exposure_us, meta.timestamp_ns) == (2000.0, 0)
    assert camera.disarm().delivered == 3


def test_a_later_trigger_is_never_answered_by_an_earlier_one(sim):
    camera = sim()
    camera.configure({**SOFTWARE, "ExposureTime": 10_000.0})
    camera.arm()
    camera.trigger()
    while not camera._core.getRemainingImageCount():  # it is there, and nobody fetches it
        time.sleep(0.005)
    camera.trigger()
    frame = camera.next_frame(2.0)
    np.testing.assert_array_equal(frame.pixels, pattern(1))
    assert frame.meta.frame_id == 2
    assert camera.poll(0.1) is None


def test_a_trigger_ends_the_exposure_of_the_one_before(sim):
    camera = sim()
    camera.configure({**SOFTWARE, "ExposureTime": 200_000.0})
    camera.arm()
    camera.trigger()
    time.sleep(0.02)
    camera.trigger()
    assert camera.next_frame(3.0).meta.frame_id == 2
    assert camera.poll(0.3) is None


def test_images_of_a_sequence_are_counted_by_their_number(sim):
    camera = sim()
    camera.configure({"TriggerMode": "Off", "ExposureTime": 5000.0})
    camera.arm()
    ids = []
    for _ in range(4):
        with camera.next_frame(2.0) as frame:
            ids.append(frame.meta.frame_id)
    assert ids == [0, 1, 2, 3]
    camera._core._images.append((pattern(9), 9))  # five were lost
    while camera.next_frame(2.0).meta.frame_id != 9:
        pass
    assert camera.counters.missing >= 1


def test_a_buffer_that_overflows_ends_it(sim):
    camera = sim()
    camera.configure({"TriggerMode": "Off", "ExposureTime": 10.0})
    camera.arm(2)
    end_s = time.monotonic() + 20.0
    while not camera._core.isBufferOverflowed():
        assert time.monotonic() < end_s
        time.sleep(0.01)
    with pytest.raises(CameraError, match=r"has overflowed.*increase buffers") as caught:
        camera.poll(1.0)
    assert type(caught.value) is CameraError  # neither a timeout nor a loss, after which a stream would go on
    assert camera.disarm().unused > 0


def test_a_call_that_never_returns_is_a_loss_within_its_deadline(sim):
    camera = sim("hangs", call_s=0.3)
    camera.configure(SOFTWARE)
    camera.arm()
    begun_s = time.monotonic()
    with pytest.raises(CameraLost, match="to expose and has not answered"):
        camera.trigger()
    with pytest.raises(CameraLost):
        camera.poll(5.0)
    camera.close()
    assert time.monotonic() - begun_s < 1.5


@pytest.mark.parametrize(("how", "error", "words"), [
    ("sends colours", BadFrame, "a frame is grey"),
    ("counts nothing", CameraError, "does not number its images"),
    ("gives nothing", CameraTimeout, "no frame within"),
])  # fmt: skip
def test_images_that_are_none_are_refused(sim, how, error, words):
    camera = sim(how)
    camera.configure({"TriggerMode": "Off", "ExposureTime": 1000.0})
    camera.arm()
    with pytest.raises(error, match=words):
        camera.next_frame(0.5)
    camera.disarm()


@pytest.mark.parametrize(
    "bad",
    [{"Gamma": 1.0}, {"ExposureTime": 0.0}, {"ExposureTime": float("nan")}, {"PixelFormat": "Mono12p"},
     {"Width": 41}, {"OffsetX": -1}, {"Width": 10.5}, {"TriggerSource": "Line1"}, {"CCDTemperature": -20.0},
     {"BitDepth": "13"}],
)  # fmt: skip
def test_a_refused_setting_changes_nothing(sim, bad):
    camera = sim()
    before = {"Width": 32, "Height": 16, "OffsetX": 4, "OffsetY": 2, "ExposureTime": 200.0}
    before |= {"PixelFormat": "Mono10"}
    assert camera.configure({**before, **SOFTWARE}).items() >= before.items()
    with pytest.raises(SettingRefused):
        camera.configure({"Gain": 2.0, "Height": 8, **bad})
    assert camera.settings().items() >= before.items()
    camera.verify()
    with pytest.raises(SettingRefused, match="chunk"):
        camera.configure({}, chunks=["Timestamp"])


def test_what_an_adapter_did_not_take_or_has_lost_is_found(sim):
    with pytest.raises(SettingRefused, match=r"Gain = 3\.0 reads 0\.0"):
        sim("takes nothing").configure({"Gain": 3.0})
    camera = sim()
    camera.configure({"Gain": 3.0})
    camera.verify()
    camera._core._properties["Gain"] = "0"
    with pytest.raises(SettingsChanged, match="Gain"):
        camera.verify()


def test_calls_in_the_wrong_order_are_the_callers_fault(sim):
    camera = sim()
    assert isinstance(camera, Camera)
    assert camera.info.model == "SimCamera Sim"
    for early in (camera.trigger, lambda: camera.poll(0.0), lambda: camera.probe(0.1), camera.open):
        with pytest.raises(CameraUsageError):
            early()
    camera.arm()
    with pytest.raises(CameraUsageError, match="TriggerMode"):
        camera.trigger()
    with pytest.raises(CameraUsageError, match="disarm"):
        camera.configure({})
    camera.close()
    camera.close()
    with pytest.raises(CameraUsageError):
        camera.settings()


def test_what_is_not_there_is_said(sim):
    with pytest.raises(CameraSetupError, match="NoSuch"):
        sim(library="NoSuch")
    with pytest.raises(CameraSetupError, match=r"install rtpiv\[micromanager\]"):
        MicroManagerCamera("A", "B", core="no_such_core:Core").open()


def test_micro_managers_own_camera(demo):
    demo.configure({**SOFTWARE, "PixelFormat": "Mono12", "ExposureTime": 3000.0, "Width": 64, "Height": 48,
                    "OffsetX": 8, "Gain": 2})  # fmt: skip
    told = demo.settings()
    assert (told["Width"], told["OffsetX"], told["ExposureTime"], told["Gain"]) == (64, 8, 3000.0, 2)
    demo.verify()
    demo.arm(4)
    for number in range(3):
        demo.trigger()
        frame = demo.next_frame(5.0)
        assert frame.pixels.shape == (48, 64)
        assert (frame.meta.frame_id, frame.meta.pixel_format) == (number + 1, "Mono12")
        assert frame.pixels.max() < 4096
        assert frame.pixels.std() > 0
    demo.disarm()
    demo.configure({"TriggerMode": "Off", "ExposureTime": 1000.0})
    demo.arm(30)
    assert [demo.next_frame(5.0).meta.frame_id for _ in range(5)] == [0, 1, 2, 3, 4]
    demo.disarm()
    with pytest.raises(SettingRefused):
        demo.configure({"Binning": 3})
    with pytest.raises(SettingRefused, match="PixelFormat"):
        demo.configure({"PixelFormat": "RGB8"})


def test_its_buffer_overflows_too(demo):
    demo.configure({"TriggerMode": "Off", "PixelFormat": "Mono16", "ExposureTime": 100.0, "FastImage": 1})
    demo.arm(2)
    time.sleep(1.0)
    with pytest.raises(CameraError, match="has overflowed"):
        demo.poll(1.0)


CAMERA = """camera:
  backend: {backend}
  options: {{cti: x.cti, library: A, device: B}}
  settings: {{PixelFormat: Mono12, ExposureTime: 2000.0, TriggerMode: "On", TriggerSource: Software}}
  timeout_s: 60.0
"""


@pytest.mark.slow
def test_a_target_run_gives_the_very_frames_that_another_backend_gives(tmp_path):
    """What comes after a run, from calibration to report, reads nothing but its frames."""
    need_harvesters()
    found = {}
    for backend in ("micromanager", "harvesters"):
        bench = write_bench(tmp_path / backend, camera=CAMERA.format(backend=backend))
        plan = tmp_path / backend / "plan.yaml"
        plan.write_text(TARGET)
        path = acquire_simulated(plan, bench, tmp_path / backend / "runs", operator=None)
        assert check_run(path).is_sound
        found[backend] = [file.read_bytes()[-96 * 96 * 2 :] for file in sorted((path / "frames").iterdir())]
    assert len(found["micromanager"]) == 3
    assert found["micromanager"] == found["harvesters"]


@pytest.mark.parametrize("more", ["  pairs: {shape: two_blocks, marker: spacing, dead_us: 2.0}\n",
                                  "  chunks: [Timestamp]\n"])  # fmt: skip
def test_pairs_of_a_flow_are_refused(tmp_path, more):
    with pytest.raises(ConfigError, match=r"bench.yaml:\d+: .*frames cannot be assigned to light pulses"):
        load_bench(write_bench(tmp_path, camera=CAMERA.format(backend="micromanager") + more))
