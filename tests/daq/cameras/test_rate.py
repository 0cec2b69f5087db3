"""The rate of the paper's bench: 10 Hz double-frames, 2016 x 2016, 12 bit, nothing lost."""

import time

import numpy as np
import pytest

from daq.cameras.harvesters import HarvestersCamera
from sim.camera.config import CameraConfig
from sim.camera.gentl import write_producer
from tests.daq.cameras.rigs import need_harvesters

SIDE, SECONDS = 2016, 60
SETTINGS = {
    "PixelFormat": "Mono12p",
    "DoubleFrameEnable": True,
    "DoubleFrameInterval": 500.0,
    "ExposureTime": 100.0,
    "TriggerMode": "Off",
    "AcquisitionFrameRate": 10.0,
}

pytestmark = [pytest.mark.slow, pytest.mark.timeout(200)]


@pytest.fixture
def ring(tmp_path):
    rng = np.random.default_rng(1)
    frames = [rng.integers(0, 4096, (SIDE, SIDE), dtype=np.uint16) for _ in range(8)]
    for index, frame in enumerate(frames):
        np.save(tmp_path / f"{index}.npy", frame)
    config = CameraConfig(
        width=SIDE,
        height=SIDE,
        row_time_us=12.0,
        source="sim.camera.source:RingSource",
        source_arguments={"folder": str(tmp_path)},
    )
    return config, frames


def run(camera, frames):
    """Take frames for a minute; every 40th is compared pixel by pixel."""
    camera.open()
    camera.configure(SETTINGS)
    camera.arm(buffers=40)
    end = time.monotonic() + SECONDS
    stamps, handover_ms = [], []
    while time.monotonic() < end:
        with camera.next_frame(3.0) as frame:
            handover_ms.append((time.monotonic_ns() - frame.meta.received_ns) / 1e6)
            if len(stamps) % 40 == 0:
                np.testing.assert_array_equal(frame.pixels, frames[frame.meta.sequence % len(frames)])
            stamps.append((frame.meta.sequence, frame.meta.timestamp_ns))
    counters = camera.counters
    camera.close()
    sequence, clock_ns = np.array(stamps).T
    step, apart_us = np.diff(sequence), np.diff(clock_ns) / 1e3
    rate = sequence[-1] / ((clock_ns[-1] - clock_ns[0]) / 1e9)
    print(f"{rate:.2f} frames/s, handover p50/p99 {np.percentile(handover_ms, [50, 99]).round(1)} ms, {counters}")
    # Every frame is accounted for; a few may be lost after the last one fetched.
    gaps = sequence[-1] + 1 - len(sequence)
    assert gaps <= counters.losses <= gaps + 3
    assert (apart_us[(sequence[:-1] % 2 == 0) & (step == 1)] == 500.0).all()
    return rate, handover_ms, counters


def test_twenty_frames_a_second_through_harvesters(ring, tmp_path):
    need_harvesters()
    config, frames = ring
    rate, handover_ms, counters = run(HarvestersCamera(write_producer(tmp_path / "rate.cti", [config])), frames)
    assert counters.losses == 0
    assert rate > 19.5
    assert np.percentile(handover_ms[20:], 99) < 50
