"""What every camera backend owes its caller, on every simulated device it can talk to."""

import contextlib
import itertools
import math
import time
from functools import cache

import numpy as np
import pytest

from daq.cameras.camera import Camera
from daq.errors import (
    CameraBusy,
    CameraLost,
    CameraTimeout,
    CameraUsageError,
    FrameIncomplete,
    SettingRefused,
    SettingsChanged,
)
from sim.camera.config import CameraConfig, FaultPlan
from tests.daq.cameras.rigs import RIGS
from tests.loops import loop_over

SOFTWARE = {"TriggerSelector": "FrameStart", "TriggerMode": "On", "TriggerSource": "Software"}
FORMATS = ["Mono8", "Mono10", "Mono10p", "Mono10Packed", "Mono12", "Mono12p", "Mono12Packed", "Mono14", "Mono14p",
           "Mono16"]  # fmt: skip
WIDTH, HEIGHT = 65, 41
PLAIN = CameraConfig(width=WIDTH, height=HEIGHT, row_time_us=20.0, first_frame_id=65530)


@cache
def expected(trigger):
    """The pattern by its definition, with Python's unbounded integers."""
    row, col = np.mgrid[0:HEIGHT, 0:WIDTH].astype(object)
    image = ((3 * col + 5 * row + 7 * (row * col // 16) + 17 * trigger) % 4096).astype(np.uint16)
    image[0, 0] = trigger
    image.flags.writeable = False  # shared by all that ask for it
    return image


@pytest.fixture(scope="module", params=list(RIGS))
def rig(request, tmp_path_factory):
    rig = RIGS[request.param](tmp_path_factory.mktemp("rig"))
    yield rig
    rig.close()


@pytest.fixture(scope="module")
def plain(rig):
    """One camera without faults for all tests that leave it as they found it."""
    camera = rig.make(PLAIN)
    camera.open()
    yield camera
    camera.close()


@pytest.fixture
def camera(plain):
    yield plain
    plain.disarm()


@pytest.fixture
def faulty(rig):
    """Open a camera of its own with a fault plan."""
    opened = []

    def make(faults, **changes):
        settings = {"width": 64, "height": 16, "row_time_us": 20.0, "serial": f"F{next(_serials)}"} | changes
        made = rig.make(CameraConfig(faults=faults, **settings))
        opened.append(made)
        made.open()
        return made

    yield make
    for made in opened:
        made.close()


_serials = itertools.count()


def triggered(camera, number, timeout_s=2.0):
    frames = []
    for _ in range(number):
        camera.trigger()
        frames.append(camera.next_frame(timeout_s).copy())
    return frames


def test_satisfies_the_protocol_and_says_who_it_is(camera):
    assert isinstance(camera, Camera)
    assert camera.info.serial == PLAIN.serial
    assert camera.info.vendor
    assert camera.info.model


@loop_over("name", FORMATS)
def test_every_pixel_of_every_format(camera, name):
    camera.configure({"PixelFormat": name, "Width": 33, "Height": 21, "OffsetX": 7, "OffsetY": 3, **SOFTWARE})
    camera.arm()
    bits = next(bits for bits in (8, 10, 12, 14, 16) if name.startswith(f"Mono{bits}"))
    shift = bits - 12
    first, second = triggered(camera, 2)
    crops = [expected(trigger)[3:24, 7:40].astype(np.uint32) for trigger in range(60)]
    crops = [crop << shift if shift > 0 else crop >> -shift for crop in crops]
    shown = [trigger for trigger, crop in enumerate(crops) if np.array_equal(crop, first.pixels)]
    assert len(shown) == 1 or (name == "Mono8" and shown)  # eight bits cannot tell all triggers apart
    assert any(np.array_equal(crops[trigger + 1], second.pixels) for trigger in shown)
    for frame in (first, second):
        assert frame.meta.pixel_format == name
        assert frame.meta.significant_bits == bits
    camera.disarm()


WHOLE = {"BinningHorizontal": 1, "BinningVertical": 1, "DecimationHorizontal": 1, "DecimationVertical": 1,
         "ReverseX": False, "ReverseY": False, "Width": WIDTH, "Height": HEIGHT}  # fmt: skip


@pytest.mark.parametrize("settings", [
    {"ReverseX": True, "ReverseY": True},
    {"BinningHorizontal": 2, "BinningVertical": 2, "Width": 32, "Height": 20},
    {"DecimationHorizontal": 3, "DecimationVertical": 2, "Width": 21, "Height": 20},
    {"Height": 4, "Width": 8, "OffsetX": 3, "OffsetY": 1, "BinningHorizontal": 2, "BinningVertical": 2,
     "DecimationHorizontal": 2, "DecimationVertical": 2, "ReverseX": True},
])  # fmt: skip
def test_binning_decimation_and_reversal_come_before_the_region(camera, settings):
    camera.configure({"PixelFormat": "Mono12", **WHOLE, **settings, **SOFTWARE})
    camera.arm()
    (frame,) = triggered(camera, 1)
    left, top = settings.get("OffsetX", 0), settings.get("OffsetY", 0)
    across, down = settings.get("BinningHorizontal", 1), settings.get("BinningVertical", 1)
    right, lower = settings.get("DecimationHorizontal", 1), settings.get("DecimationVertical", 1)

    def shown(trigger):
        sensor = expected(trigger)
        sensor = sensor[:, ::-1] if settings.get("ReverseX") else sensor
        sensor = sensor[::-1] if settings.get("ReverseY") else sensor
        rows, columns = frame.pixels.shape
        sensor = sensor[top * lower * down :, left * right * across :]
        cells = [sensor[i :: lower * down, j :: right * across] for i in range(down) for j in range(across)]
        return np.floor(np.mean([cell[:rows, :columns] for cell in cells], axis=0))

    camera.disarm()
    camera.configure(WHOLE)
    assert any(np.array_equal(shown(trigger), frame.pixels) for trigger in range(70))


def test_settings_are_read_back_and_the_node_list_is_whole(camera):
    asked = {"ExposureTime": 321.0, "Gain": 6.0, "AcquisitionFrameRate": 25.0, "PixelFormat": "Mono12p"}
    back = camera.configure({**asked, "Width": 40, "Height": 20, "OffsetX": 10, "OffsetY": 5, **SOFTWARE})
    for name, value in asked.items():
        assert back[name] == (pytest.approx(value) if isinstance(value, float) else value)
    listed = camera.settings()
    assert {"Width": 40, "Height": 20, "OffsetX": 10, "OffsetY": 5}.items() <= listed.items()
    assert {"TriggerMode", "TriggerSource", "PayloadSize", "AcquisitionMode", "DeviceModelName"} <= set(listed)
    assert listed["PayloadSize"] == 40 * 20 * 12 // 8
    camera.verify()
    camera.configure({"Gain": 0.0, "Width": WIDTH, "Height": HEIGHT})


def test_every_kind_of_chunk_comes_with_its_own_frame(camera):
    chunks = ("Timestamp", "ExposureTime", "LineStatusAll", "CounterValue", "FramesPerTriggerCounter")
    camera.configure({"PixelFormat": "Mono12p", "ExposureTime": 321.5, **SOFTWARE}, chunks=chunks)
    camera.arm()
    first, second = (frame.meta for frame in triggered(camera, 2))
    assert set(first.chunks) == set(second.chunks) == set(chunks)
    for meta in (first, second):
        assert meta.chunks["Timestamp"] == meta.timestamp_ns
        assert isinstance(meta.chunks["Timestamp"], int)  # as a float it would lose its last digits in a month
        assert meta.chunks["ExposureTime"] == pytest.approx(321.5)
        assert meta.chunks["FramesPerTriggerCounter"] == 1
    assert second.chunks["Timestamp"] > first.chunks["Timestamp"]
    assert second.chunks["CounterValue"] == first.chunks["CounterValue"] + 1
    camera.disarm()
    with pytest.raises(SettingRefused, match=r"sends no chunk Gain, .*camera\.chunks"):
        camera.configure({}, chunks=("Gain",))


def test_a_few_features_are_read_also_while_it_is_armed(camera):
    camera.configure({"ExposureTime": 250.0, **SOFTWARE})
    camera.arm()
    found = camera.read(["DeviceTemperature", "ExposureTime", "NoSuchThing"])
    assert found == {"DeviceTemperature": pytest.approx(41.5), "ExposureTime": pytest.approx(250.0)}


@loop_over(
    "bad",
    [{"Width": 100_000}, {"Width": -1}, {"PixelFormat": "BayerRG8"}, {"Exposure": 1.0}, {"ExposureTime": 0.0},
     {"ExposureTime": float("nan")}, {"Gain": float("inf")}, {"TriggerSource": "Line77"}, {"PayloadSize": 3}],
)  # fmt: skip
def test_a_refused_setting_changes_nothing(camera, bad):
    before = {
        "Width": 32,
        "Height": 16,
        "OffsetX": 4,
        "OffsetY": 2,
        "ExposureTime": 200.0,
        "PixelFormat": "Mono12",
    }
    camera.configure({**before, **SOFTWARE})
    with pytest.raises(SettingRefused):
        camera.configure({"Height": 8, **bad})
    camera.verify()
    assert before.items() <= camera.settings().items()


def test_ids_wrap_is_no_loss(camera):
    camera.configure({"PixelFormat": "Mono12", "Width": 16, "Height": 8, **SOFTWARE})
    camera.arm()
    frames = triggered(camera, 12)
    assert [frame.meta.sequence for frame in frames] == list(range(12))
    assert camera.counters.missing == 0
    assert camera.disarm().delivered == 12


def test_time_stamps_count_on_the_cameras_clock(camera):
    camera.configure({"PixelFormat": "Mono8", "TriggerMode": "Off", "AcquisitionFrameRate": 40.0})
    camera.arm()
    frames = [camera.next_frame(2.0).copy() for _ in range(6)]
    period_ms = np.diff([frame.meta.timestamp_ns for frame in frames]) / 1e6
    assert 20 < np.median(period_ms) < 35  # 25 ms, soft real time on a shared machine
    assert all(np.diff([frame.meta.received_ns for frame in frames]) > 0)


def test_the_clock_that_can_be_read_is_the_one_that_stamps(camera):
    camera.configure({"PixelFormat": "Mono12", "ExposureTime": 200.0, **SOFTWARE})
    camera.arm()
    for _ in range(3):
        before_ns = camera.trigger()
        frame = camera.next_frame(2.0).copy()
        after_ns = camera.clock_ns()
        assert before_ns <= frame.meta.timestamp_ns <= after_ns
        assert frame.meta.id_told


def test_polling_only_looks(camera):
    camera.configure({"PixelFormat": "Mono12", **SOFTWARE})
    camera.arm()
    assert camera.poll(0.0) is None
    assert camera.poll(0.05) is None
    camera.trigger()
    frame = camera.poll(2.0)
    assert frame.meta.sequence == 0
    frame.release()
    assert camera.poll(0.0) is None
    camera.probe(2.0)


def test_double_frames_pair_by_id_and_time(camera):
    double = {"DoubleFrameEnable": True, "DoubleFrameInterval": 500.0, "ExposureTime": 100.0}
    camera.configure({"PixelFormat": "Mono12", **double, **SOFTWARE})
    camera.arm()
    frames = []
    for _ in range(4):
        camera.trigger()
        frames += [camera.next_frame(2.0).copy(), camera.next_frame(2.0).copy()]
    camera.disarm()
    camera.configure({"DoubleFrameEnable": False})
    assert [frame.meta.sequence for frame in frames] == list(range(8))
    for first, second in zip(frames[::2], frames[1::2], strict=True):
        assert second.meta.timestamp_ns - first.meta.timestamp_ns == 500_000
        assert first.pixels[0, 0] == second.pixels[0, 0]  # the same trigger's pattern


def test_triggers_while_the_sensor_is_busy_are_counted(camera):
    camera.configure({"PixelFormat": "Mono12", "ExposureTime": 200_000.0, **SOFTWARE})
    camera.arm()
    for _ in range(4):
        camera.trigger()
    camera.next_frame(2.0).release()
    counters = camera.disarm()
    camera.configure({"ExposureTime": 200.0})
    assert counters.ignored_triggers == 3
    assert (counters.delivered, counters.losses) == (1, 0)


def test_counters_that_were_configured_are_left_alone(rig):
    camera = rig.make(CameraConfig(width=64, height=16, serial="COUNTS"))
    camera.open()
    camera.configure({"CounterSelector": "Counter0", "CounterEventSource": "Off", **SOFTWARE})
    camera.arm()
    triggered(camera, 1)
    camera.verify()
    assert camera.disarm().ignored_triggers is None
    camera.close()


def test_a_timeout_leaves_the_camera_usable(camera):
    camera.configure({"PixelFormat": "Mono12", **SOFTWARE})
    camera.arm()
    start = time.monotonic()
    with pytest.raises(CameraTimeout):
        camera.next_frame(0.2)
    assert time.monotonic() - start < 1.5
    assert triggered(camera, 1)[0].meta.sequence == 0


def test_calls_in_the_wrong_order_are_the_callers_fault(camera):
    with pytest.raises(CameraUsageError):
        camera.trigger()
    with pytest.raises(CameraUsageError):
        camera.next_frame(0.1)
    camera.arm()
    with pytest.raises(CameraUsageError):
        camera.arm()
    with pytest.raises(CameraUsageError):
        camera.configure({"Gain": 0.0})
    with pytest.raises(CameraUsageError):
        camera.open()


def test_a_slow_consumer_is_an_underrun_and_held_pixels_stay(camera):
    camera.configure({"PixelFormat": "Mono12", "TriggerMode": "Off", "AcquisitionFrameRate": 200.0,
                      "ExposureTime": 100.0})  # fmt: skip
    camera.arm(buffers=3)
    held = [camera.next_frame(2.0) for _ in range(3)]
    before = [frame.pixels.copy() for frame in held]
    time.sleep(0.5)  # a hundred frames find no room
    for frame, pixels in zip(held, before, strict=True):
        np.testing.assert_array_equal(frame.pixels, pixels)
        frame.release()
        frame.release()
    time.sleep(0.1)
    late = [camera.next_frame(2.0).copy() for _ in range(12)]
    fetched_s = time.monotonic()
    before = camera.counters
    more = 6 + math.ceil(200.0 * (time.monotonic() - fetched_s))  # that came while the camera was asked
    counters = camera.disarm()
    camera.configure({"AcquisitionFrameRate": 10.0, **SOFTWARE})
    assert counters.underrun > 20
    # Frames, not packets: with those delivered they make the ids up to the last one fetched, and hardly more.
    assert late[-1].meta.sequence + 1 <= before.delivered + before.underrun <= late[-1].meta.sequence + 1 + more
    # The frames that waited behind the gap are told apart from those before it.
    assert late[-1].meta.sequence >= 3 + 20
    assert counters.missing == 0


def test_held_frames_stay_readable_after_disarming(camera):
    camera.configure({"PixelFormat": "Mono12", **SOFTWARE})
    camera.arm()
    camera.trigger()
    frame = camera.next_frame(2.0)
    pixels = frame.pixels.copy()
    camera.disarm()
    camera.arm()
    triggered(camera, 2)
    camera.disarm()
    np.testing.assert_array_equal(frame.pixels, pixels)
    frame.release()


def test_arming_again_starts_from_zero(camera):
    camera.configure({"PixelFormat": "Mono12", **SOFTWARE})
    for _ in range(3):
        camera.arm(4)
        assert [frame.meta.sequence for frame in triggered(camera, 3)] == [0, 1, 2]
        assert camera.disarm().delivered == 3


def test_incomplete_and_dropped_frames_are_told_apart(faulty):
    camera = faulty(FaultPlan(incomplete=(2, 5), dropped=(7, 8, 9)))
    camera.configure({"PixelFormat": "Mono12", "TriggerMode": "Off", "AcquisitionFrameRate": 50.0})
    camera.arm()
    frames = [camera.next_frame(2.0).copy() for _ in range(8)]
    counters = camera.disarm()
    first = frames[0].meta.frame_id
    ids = [frame.meta.frame_id - first for frame in frames]
    assert ids == [0, 1, 3, 4, 6, 10, 11, 12]
    assert [frame.meta.sequence for frame in frames] == ids
    assert (counters.incomplete, counters.missing, counters.delivered) == (2, 3, counters.delivered)
    assert all((frame.pixels[0, 0], 0) == (index, 0) for index, frame in zip(ids, frames, strict=True))


def test_a_frame_that_is_incomplete_or_late_and_settings_that_vanish_are_noticed(faulty):
    """Who waits for an incomplete frame hears of it at once; a late one is a timeout, and then a frame."""
    camera = faulty(FaultPlan(incomplete=(1,), late_s={"3": 0.8}, reset_at=5))
    camera.configure({"PixelFormat": "Mono12", "ExposureTime": 333.0, **SOFTWARE})
    camera.arm()
    triggered(camera, 1)
    camera.trigger()
    with pytest.raises(FrameIncomplete):
        camera.poll(60.0)
    assert camera.poll(0.0) is None  # told once
    assert triggered(camera, 1)[0].pixels[0, 0] == 2
    camera.trigger()
    with pytest.raises(CameraTimeout):
        camera.next_frame(0.3)
    assert camera.next_frame(3.0).meta.sequence == 3
    counters = camera.disarm()
    assert (counters.delivered, counters.incomplete, counters.missing) == (3, 1, 0)
    camera.arm()
    triggered(camera, 1)
    camera.verify()
    camera.trigger()
    camera.next_frame(2.0).release()
    with pytest.raises(SettingsChanged, match="ExposureTime = 333"):
        camera.verify()


def test_a_lost_camera_says_so_in_time_and_comes_back_reset(faulty):
    camera = faulty(FaultPlan(lost_at=2, back_after_s=2.0))
    camera.configure({"PixelFormat": "Mono12", "ExposureTime": 333.0, **SOFTWARE})
    camera.arm()
    triggered(camera, 2)
    camera.trigger()
    start = time.monotonic()
    with pytest.raises(CameraLost):
        camera.next_frame(0.5)
    assert time.monotonic() - start < 1.5 * 0.5 + 0.75
    camera.close()
    deadline = time.monotonic() + 10
    while True:
        try:
            camera.open()
            break
        except CameraLost:
            assert time.monotonic() < deadline
            time.sleep(0.7)  # each try of Harvesters starts a process
    assert camera.settings()["TriggerMode"] == "Off"  # its settings are those after power-up
    camera.configure({"PixelFormat": "Mono12", **SOFTWARE})
    camera.arm()
    assert triggered(camera, 1)[0].meta.sequence == 0


def test_a_camera_lost_before_it_is_set_is_lost_and_refuses_nothing(faulty):
    camera = faulty(FaultPlan(lost_at=0))
    camera.configure(SOFTWARE)
    camera.arm()
    camera.trigger()
    with pytest.raises(CameraLost):
        camera.next_frame(0.3)
    with contextlib.suppress(CameraLost):
        camera.disarm()
    with pytest.raises(CameraLost):
        camera.configure({"PixelFormat": "Mono8", "ExposureTime": 20.0})


def test_a_second_owner_finds_the_camera_busy(rig, tmp_path):
    first = rig.make(CameraConfig(width=64, height=16, serial="BUSY", lock_path=str(tmp_path / "lock")))
    first.open()
    second = rig.again(first)
    with pytest.raises(CameraBusy):
        second.open()
    first.close()
    second.open()
    second.close()
