"""The camera without a transport: frames into a list."""

import struct
import threading
import time

import numpy as np
import pytest

from sim.camera.config import CameraConfig, FaultPlan
from sim.camera.device import CameraGone, SimCamera
from sim.camera.registers import WriteProtected
from sim.camera.remote import FrameServer, RemoteSource
from sim.camera.source import PatternSource, RingSource, load_source


class Client:
    """Writes registers by name and collects frames."""

    def __init__(self, **changes):
        self.camera = SimCamera(CameraConfig(width=16, height=8, row_time_us=10.0, **changes))
        self.frames = []
        self.came = threading.Condition()
        self.camera.sink = self.take

    def take(self, frame):
        with self.came:
            self.frames.append(frame)
            self.came.notify_all()

    def set(self, name, value):
        form = ">d" if isinstance(value, float) else ">I"
        self.camera.write(self.camera.registers.addresses[name], struct.pack(form, value))

    def wait(self, number, timeout_s=3.0):
        with self.came:
            assert self.came.wait_for(lambda: len(self.frames) >= number, timeout_s)
        return self.frames


@pytest.fixture
def client():
    made = []

    def make(**changes):
        made.append(Client(**changes))
        return made[-1]

    yield make
    for one in made:
        one.camera.power_off()


def test_multi_frame_mode_ends_by_itself(client):
    one = client()
    one.set("AcquisitionMode", 2)
    one.set("AcquisitionFrameCount", 3)
    one.set("AcquisitionFrameRate", 200.0)
    one.set("AcquisitionStart", 1)
    one.wait(3)
    time.sleep(0.1)
    assert [frame.number for frame in one.frames] == [0, 1, 2]


def test_line_trigger_counts_only_when_it_is_the_source(client):
    one = client()
    one.set("TriggerMode", 1)
    one.set("TriggerSource", 0)
    one.set("AcquisitionStart", 1)
    one.camera.line_pulse(1, time.monotonic_ns(), time.monotonic_ns())
    one.set("TriggerSource", 1)
    one.camera.line_pulse(1, time.monotonic_ns(), time.monotonic_ns())
    assert one.wait(1)[0].trigger_index == 0
    time.sleep(0.05)
    assert len(one.frames) == 1


def test_gain_is_applied_and_clipped(client):
    one = client()
    one.set("Gain", 20.0)  # dB, ten times
    one.set("AcquisitionStart", 1)
    payload = one.wait(1)[0].picture.payload.view("<u2").reshape(8, 16)
    plain = PatternSource(16, 8).frame(0, 0)
    np.testing.assert_array_equal(payload, np.minimum(plain.astype(int) * 10, 4095))


def test_region_cannot_change_while_frames_run(client):
    one = client()
    one.set("AcquisitionStart", 1)
    with pytest.raises(WriteProtected):
        one.set("Width", 8)
    one.set("AcquisitionStop", 1)
    one.set("Width", 8)
    assert one.camera.registers.integer("OffsetXMax") == 8


def test_missed_triggers_are_counted_only_when_asked(client):
    one = client()
    one.set("TriggerMode", 1)
    one.set("ExposureTime", 100_000.0)
    one.set("CounterEventSource", 1)
    one.set("AcquisitionStart", 1)
    for _ in range(5):
        one.set("TriggerSoftware", 1)
    address = one.camera.registers.addresses["CounterValue"]
    assert one.camera.read(address, 4) == struct.pack(">I", 4)
    one.set("CounterReset", 1)
    assert one.camera.read(address, 4) == bytes(4)


def test_a_lost_camera_answers_nothing_and_returns_with_defaults(client):
    one = client(faults=FaultPlan(lost_at=1, back_after_s=0.3))
    one.set("ExposureTime", 50.0)
    one.set("AcquisitionFrameRate", 100.0)
    one.set("AcquisitionStart", 1)
    one.wait(1)
    time.sleep(0.1)
    with pytest.raises(CameraGone):
        one.set("Gain", 1.0)
    time.sleep(0.4)
    one.set("Gain", 1.0)
    assert one.camera.registers.number("ExposureTime") == 1000.0


def test_configuration_survives_json():
    config = CameraConfig(width=9, faults=FaultPlan(dropped=(3,), late_s={"1": 0.5}), source_arguments={"a": 1})
    assert CameraConfig.from_json(config.to_json()) == config
    with pytest.raises(TypeError):
        CameraConfig.from_json('{"wide": 1}')


def test_ring_repeats_its_files(tmp_path):
    for index in range(3):
        np.save(tmp_path / f"{index}.npy", np.full((4, 6), index, np.uint16))
    ring = load_source("sim.camera.source:RingSource", {"folder": str(tmp_path)})
    assert [int(ring.frame(0, 0)[0, 0]) for _ in range(5)] == [0, 1, 2, 0, 1]
    with pytest.raises(ValueError, match="holds no"):
        RingSource(tmp_path / "..")


def test_remote_source_shows_what_the_server_draws(tmp_path):
    class World:
        def frame(self, trigger_index, time_ns):
            if trigger_index == 9:
                raise RuntimeError("no such day")
            return np.full((4, 6), trigger_index * 100 + time_ns, np.uint16)

    server = FrameServer(World(), tmp_path, 6, 4)
    source = RemoteSource(**server.arguments())
    first = source.frame(2, 5)
    second = source.frame(3, 7)
    assert (first == 205).all()
    assert (second == 307).all()
    with pytest.raises(OSError, match="no such day"):
        source.frame(9, 0)
    server.close()
    with pytest.raises(OSError):
        source.frame(1, 1)
    source.close()


def test_a_remote_world_sends_what_comes_again_only_once(tmp_path):
    """More constants than are numbered, changing ones between, two cameras: each sees what was shown."""
    frozen = [np.full((4, 6), 1000 + number, np.uint16) for number in range(20)]
    for image in frozen:
        image.flags.writeable = False

    class World:
        def frame(self, trigger_index, time_ns):
            return np.full((4, 6), time_ns, np.uint16) if trigger_index < 0 else frozen[trigger_index]

    server = FrameServer(World(), tmp_path, 6, 4)
    sources = [RemoteSource(**server.arguments()) for _ in range(2)]
    kept = {}
    for turn in range(3):
        for number in [*range(20), *reversed(range(20))]:
            for source in sources[: turn + 1]:
                assert (source.frame(-1, number) == number).all()
                shown = source.frame(number, 0)
                assert (shown == 1000 + number).all()
                if not shown.flags.writeable:
                    assert kept.setdefault((id(source), number), shown) is shown
    assert len(kept) == 2 * 16
    server.close()
    for source in sources:
        source.close()


def test_a_world_that_ends_takes_its_camera_along(client, tmp_path):
    class World:
        def frame(self, trigger_index, time_ns):
            if trigger_index:
                raise RuntimeError("over")
            return np.zeros((8, 16), np.uint16)

    server = FrameServer(World(), tmp_path, 16, 8)
    one = client(source="sim.camera.remote:RemoteSource", source_arguments=server.arguments())
    one.set("AcquisitionFrameRate", 100.0)
    one.set("AcquisitionStart", 1)
    one.wait(1)
    time.sleep(0.3)
    with pytest.raises(CameraGone):
        one.set("Gain", 1.0)
    server.close()
