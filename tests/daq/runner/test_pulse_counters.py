"""A frame is counted in the stretch in which it was exposed, however late it arrives; what is missing is said."""

import time
from types import SimpleNamespace

import pytest

from daq.bench.bench_table import CameraSection
from daq.cameras.camera import Counters
from daq.errors import CameraLost, FrameIncomplete, RunUsageError
from daq.runner import pulse_counters
from daq.runner.pulse_counters import CameraCounter
from daq.timing.pulses import Pulse, Role

SHAPES = {
    "two_blocks": {"shape": "two_blocks", "marker": "spacing", "dead_us": 2.0},
    "straddling": {"shape": "straddling", "marker": "spacing", "dead_us": 2.0},
    "double_height": {"shape": "double_height", "dead_us": 2.0},
}
PULSE = Pulse(0.0, 10.0)
BOOTED_NS = 10**15  # the camera's clock is not ours


class LateCamera:
    """A camera whose frames take their time; exposures are told by the test."""

    def __init__(self, late_s=0.0, lost=0, has_clock=True, has_stamps=True, trouble=None):
        self.late_s, self.lost, self.has_clock, self.has_stamps = late_s, lost, has_clock, has_stamps
        self.trouble, self._coming = trouble, []

    def expose(self, frames=1):
        for _ in range(frames):
            self._coming.append((time.monotonic() + self.late_s, self.now_ns()))
            time.sleep(0.002)

    def now_ns(self):
        return time.monotonic_ns() + BOOTED_NS

    def clock_ns(self):
        return self.now_ns() if self.has_clock else None

    def poll(self, timeout_s):
        if self.trouble is not None:
            error, self.trouble = self.trouble, None
            raise error
        if not self._coming or self._coming[0][0] > time.monotonic():
            time.sleep(0.001)
            return None
        _, stamp_ns = self._coming.pop(0)
        return Held(SimpleNamespace(timestamp_ns=stamp_ns if self.has_stamps else 0))

    def configure(self, settings, **chunks):
        return {}

    def settings(self):
        return {"ExposureTime": 100.0}

    def arm(self, buffers):
        pass

    def disarm(self):
        return Counters(missing=self.lost)

    @property
    def counters(self):
        return Counters(missing=self.lost)


class Held(SimpleNamespace):
    def __init__(self, meta):
        super().__init__(meta=meta)

    def __enter__(self):
        return self

    def release(self):
        pass

    def __exit__(self, *error):
        pass


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(pulse_counters, "TAIL_S", 0.1)
    monkeypatch.setattr(pulse_counters, "FIRST_FRAME_S", 1.0)


def counter_of(camera, shape="two_blocks"):
    settings = {"TriggerMode": "On", "TriggerSource": "Line1"}
    section = CameraSection(backend="harvesters", options={"cti": "x"}, settings=settings, pairs=SHAPES[shape])
    return CameraCounter(camera, section)


def counted(camera, bursts, shape="two_blocks", roles=(Role.CAMERA,), frames=2):
    counter = counter_of(camera, shape)
    counter.begin(roles, 1e5, PULSE)
    for pairs in bursts:
        counter.mark()
        camera.expose(frames * pairs)
    return counter.end()


@pytest.mark.parametrize("late_s", [0.0, 0.05, 0.7])
def test_late_frames_belong_to_the_burst_that_made_them(late_s):
    found = counted(LateCamera(late_s), (1, 7, 0, 5))
    assert [stretch.pulses for stretch in found.stretches] == [0, 1, 7, 0, 5]
    assert not found.trouble
    assert len(found.stretches[2].times_s) == 7


@pytest.mark.parametrize(("shape", "roles", "frames"), [
    ("two_blocks", (Role.Q_SWITCH_1,), 2), ("double_height", (Role.CAMERA,), 1),
    ("straddling", (Role.CAMERA, Role.CAMERA_B), 2), ("straddling", (Role.Q_SWITCH_2,), 1),
])  # fmt: skip
def test_frames_of_a_pulse_are_those_of_the_shape_and_of_the_plug(shape, roles, frames):
    found = counted(LateCamera(), (3, 2), shape, roles, frames)
    assert [stretch.pulses for stretch in found.stretches] == [0, 3, 2]


def test_half_a_pair_is_no_pair():
    camera = LateCamera()
    counter = counter_of(camera)
    counter.begin((Role.CAMERA,), 1e5, PULSE)
    counter.mark()
    camera.expose(5)
    assert counter.end().stretches[1].pulses == 2.5


@pytest.mark.parametrize(("camera", "said"), [
    (LateCamera(lost=2), "2 frames were lost"), (LateCamera(has_stamps=False), "no time stamps"),
    (LateCamera(trouble=FrameIncomplete("one frame came with pixels missing")), "pixels missing"),
    (LateCamera(trouble=CameraLost("the camera is gone")), "is gone"),
])  # fmt: skip
def test_what_may_be_missing_is_said(camera, said):
    assert said in counted(camera, (2,)).trouble


def test_a_plug_without_pulses_is_not_waited_for_for_ever():
    found = counted(LateCamera(), (0, 0))
    assert [stretch.pulses for stretch in found.stretches] == [0, 0, 0]


def test_a_camera_without_a_clock_cannot_assign_late_frames():
    with pytest.raises(RunUsageError, match="cannot be assigned"):
        counter_of(LateCamera(has_clock=False)).begin((Role.CAMERA,), 1e5, PULSE)
