"""All four shapes of double-frame cameras, over both transports: pairs come, marked, and never of two pulses.

The camera's picture says in its first pixel which trigger it belongs to, so what a frame shows is known; the
finder sees ids, stamps and chunks only.
"""

import threading
import time
from dataclasses import replace

import pytest

from daq.bench.pairs_section import PairsSection
from daq.errors import FrameIncomplete, SettingRefused
from daq.runner.pair_finder import PairFinder
from sim.camera.config import CameraConfig, FaultPlan
from sim.camera.wires import Wires
from tests.daq.cameras.rigs import RIGS
from tests.slow_cases import slow_but

RATE_HZ, EXPOSURE_US = 50.0, 500.0
PERIOD_NS = round(1e9 / RATE_HZ)
PAIRS = 30
EDGES = {"ExposureTime": EXPOSURE_US, "TriggerSource": "Line1", "TriggerMode": "On"}
START = {"TriggerSelector": "FrameStart"}
DOUBLE = START | {"DoubleFrameEnable": True, "DoubleFrameInterval": 600.0}
STACKED = DOUBLE | {"DoubleFrameLayout": "OneBuffer"}
BURST = {"TriggerSelector": "FrameBurstStart", "AcquisitionBurstFrameCount": 2}
HALF_US = 5e5 / RATE_HZ
SHAPES = {
    "double_height": (PairsSection(shape="double_height", dead_us=100.0), STACKED),
    "two_blocks, line": (PairsSection(shape="two_blocks", marker="line_status", line=2, dead_us=100.0), DOUBLE),
    "two_blocks, spacing": (PairsSection(shape="two_blocks", marker="spacing", dead_us=100.0), DOUBLE),
    "straddling, line": (
        PairsSection(shape="straddling", marker="line_status", line=2, dead_us=HALF_US - EXPOSURE_US), START,
    ),
    "straddling, counter": (
        PairsSection(shape="straddling", marker="counter", counter="CounterValue", dead_us=HALF_US - EXPOSURE_US),
        START,
    ),
    "burst, counter": (
        PairsSection(shape="burst", marker="counter", counter="FramesPerTriggerCounter", dead_us=0.0), BURST,
    ),
}  # fmt: skip
FAULTS = FaultPlan(first_skipped=3, skipped=(17, 30), dropped=(12, 41), doubled=(22,), seed=3)


@pytest.fixture(params=list(RIGS))
def rig(request, tmp_path):
    rig = RIGS[request.param](tmp_path)
    yield rig
    rig.close()


def pulses(wires, section, pairs):
    """A timing unit: a marker over exposure A, a trigger for A, and one for B where the camera needs it."""
    begun_ns = time.monotonic_ns() + 20_000_000
    for pulse in range(pairs):
        at_ns = begun_ns + pulse * PERIOD_NS
        time.sleep(max(0.0, (at_ns - time.monotonic_ns()) / 1e9))
        wires.pulse(2, at_ns, at_ns + round(1e3 * (EXPOSURE_US + section.dead_us / 2 + 1)))
        wires.pulse(1, at_ns, at_ns + 10_000)
        if section.shape == "straddling":
            time.sleep(1e-6 * HALF_US)
            second_ns = at_ns + round(1e3 * (EXPOSURE_US + section.dead_us))
            wires.pulse(1, second_ns, second_ns + 10_000)


def shown(frame, shape):
    """Pulse that a frame shows, by the number of its trigger."""
    trigger = int(frame.pixels[0, 0])
    return trigger // 2 if shape == "straddling" else trigger


def taken(camera, wires, section, settings):
    """Pulses shown by the pairs of one arm, the finder, and how many frames came."""
    camera.configure(EDGES | settings, section.chunks)
    camera.arm(40)
    firing = threading.Thread(target=pulses, args=(wires, section, PAIRS))
    firing.start()
    finder = PairFinder(section, RATE_HZ, EXPOSURE_US + section.dead_us, lambda item: None)
    found, frames, quiet_s = [], 0, time.monotonic() + 3.0
    while time.monotonic() < quiet_s:
        try:
            frame = camera.poll(0.05)
        except FrameIncomplete:  # a busy computer loses packets: such a pair is lost as the injected ones are
            continue
        if frame is None:
            quiet_s = quiet_s if firing.is_alive() else min(quiet_s, time.monotonic() + 0.15)
            continue
        frames += 1
        pulse = shown(frame, section.shape)
        if section.shape == "double_height":
            height = frame.pixels.shape[0] // 2
            assert frame.pixels.shape == (2 * 16, 32)
            assert frame.pixels[height, 0] == frame.pixels[0, 0]
        frame.release()
        for half in range(2 if section.shape == "double_height" else 1):
            meta = frame.meta
            if section.shape == "double_height":
                meta = replace(meta, sequence=2 * meta.sequence + half)
            found += [pair] if (pair := finder.add(meta, pulse)) else []
    found += [pair] if (pair := finder.end()) else []
    firing.join()
    camera.disarm()
    return found, finder, frames


@pytest.mark.parametrize("name", slow_but(SHAPES, "double_height", "two_blocks, line"))
def test_pairs_come_whole_and_of_one_pulse_each(rig, tmp_path, name):
    section, settings = SHAPES[name]
    wires = Wires(tmp_path)
    config = CameraConfig(32, 16, row_time_us=2.0, wires=str(wires.path), faults=FAULTS)
    camera = rig.make(config)
    camera.open()
    try:
        found, finder, frames = taken(camera, wires, section, settings)
    finally:
        camera.close()
        wires.close()
    assert all(one == two for one, two in found)
    assert len(set(found)) == len(found)
    assert len(found) >= PAIRS - 9  # three first frames, two skipped, two dropped; a doubled one costs nothing
    parts = 2 if section.shape == "double_height" else 1
    assert 2 * len(found) + sum(finder.rejected.values()) == parts * frames


def test_a_camera_without_chunks_is_refused_where_the_marker_is_one(rig, tmp_path):
    camera = rig.make(CameraConfig(32, 16, has_chunks=False))
    camera.open()
    with pytest.raises(
        SettingRefused, match="sends no chunk LineStatusAll, so it cannot distinguish exposure A from B"
    ):
        camera.configure({"ExposureTime": 500.0}, ("LineStatusAll",))
    with pytest.raises(SettingRefused, match="sends no chunk"):
        camera.configure({}, ("FrameTriggerCounter",))
    camera.close()


def test_chunks_that_were_not_asked_for_do_not_come(rig):
    camera = rig.make(CameraConfig(32, 16))
    camera.open()
    camera.configure({"TriggerMode": "Off", "AcquisitionFrameRate": 50.0})
    camera.arm()
    frame = camera.next_frame(3.0)
    assert frame.meta.chunks == {}
    frame.release()
    camera.close()
