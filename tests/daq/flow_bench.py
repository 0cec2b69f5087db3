"""A small simulated bench with a laser and a double-frame camera; its frames say which pulse lit them.

The renderer is left out: a frame is one grey value, darker without light, and its first pixels say which pair and
which pulse of it were seen, and how many pulses.
"""

import re

import numpy as np

from rtpiv.verbs.acquire import LiveFrames, acquire
from sim import light as lit
from tests.daq.small_bench import write_bench

FLOOR, LIGHT = 35, 20
LAMPS = "lamp_1: A, q_switch_1: B, lamp_2: C, q_switch_2: D, camera: E, marker: F"
DIODES = "q_switch_1: B, q_switch_2: D, camera: E, marker: F"
HEADS = {
    LAMPS: "{max_rate_hz: 25.0, lamp_to_q_switch_us: [180.0, 185.0], warmup_s: 5.0}",
    DIODES: "{max_rate_hz: 25.0}",
}
DOUBLE = "DoubleFrameEnable: true, DoubleFrameInterval: 402.0, TriggerSelector: FrameStart"
SINGLE = "TriggerSelector: FrameStart"
BURST = "TriggerSelector: FrameBurstStart, AcquisitionBurstFrameCount: 2"
BLOCKS = "shape: two_blocks, dead_us: 2.0, second_exposure_us: 192.0"
SHAPES = {
    "double_height": (f"{DOUBLE}, DoubleFrameLayout: OneBuffer",
                      "shape: double_height, dead_us: 2.0, second_exposure_us: 192.0"),
    "two_blocks": (DOUBLE, f"{BLOCKS}, marker: line_status, line: 2"),
    "two_blocks by spacing": (DOUBLE, f"{BLOCKS}, marker: spacing"),
    "straddling": (SINGLE, "shape: straddling, marker: line_status, line: 2, dead_us: 19600.0"),
    "burst": (BURST, "shape: burst, marker: counter, counter: FramesPerTriggerCounter, dead_us: 0.0"),
}  # fmt: skip
PLAN = "experiment: flow\nview: glass\nlaser: laser\nrate_hz: 25.0\ntarget_z_mm: -30.0\n"
DT_US = {"straddling": 19_700.0}


class ToldLight(lit.LitFlow):
    """Light whose frames say what they show."""

    def expose(self, camera, start_ns, end_ns, pairs=None):
        with self._lock:
            seen = [flash for flash in self._flashes if start_ns <= flash.time_ns < end_ns]
        image = np.full(camera.scene.camera.shape, FLOOR + LIGHT * len(seen), np.uint16)
        image[0, :4] = [7, len(seen), *((seen[0].lit.pair, seen[0].lit.pulse) if seen else (4095, 4095))]
        image[0, 4] = bool(seen and seen[0].is_seeded)
        return image


def told(pixels):
    """(pulses seen, pair, pulse) of a frame."""
    seen, pair, pulse = (int(value) for value in pixels[0, 1:4])
    assert pixels[0, 0] == 7
    return seen, pair, pulse


def shows_particles(pixels):
    """Whether the seeding was open when the light of a frame fell."""
    return bool(pixels[0, 4])


def write_flow(
    folder, shape="two_blocks", channels=LAMPS, pairs=20, chunk=10, more="", faults="", backend="harvesters"
):
    """Write scene, bench and plan; return bench and plan."""
    settings, section = SHAPES[shape]
    simulation = "samples: 1\nrow_time_us: 2.0" + (f"\nfaults: {{{faults}}}" if faults else "")
    path = write_bench(folder, simulation=simulation)
    camera = (
        f"camera:\n  backend: {backend}\n  options: {{cti: x.cti}}\n  buffers: 120\n  timeout_s: 1.0\n"
        f"  settings: {{PixelFormat: Mono12p, ExposureTime: 400.0, {settings}, TriggerMode: 'On', "
        f"TriggerSource: Line1}}\n  pairs: {{{section}}}\n"
    )
    text = re.sub(r"^camera:\n(  .*\n)+", camera, path.read_text(), flags=re.MULTILINE)
    wired = channels + (", camera_b: G" if shape == "straddling" else "")
    laser = f"kind: timing, box: qc9520, port: /dev/box, clear_mm: 0.0, channels: {{{wired}}}"
    path.write_text(f"{text}devices:\n  laser: {{{laser}, head: {HEADS[channels]}}}\n")
    plan = folder / "plan-flow.yaml"
    plan.write_text(f"{PLAN}pairs: {pairs}\nchunk: {chunk}\ndt_us: {DT_US.get(shape, 100.0)}\n{more}")
    return path, plan


def acquire_simulated(plan, bench, runs, operator="test", live=False):
    """Acquire on the simulated bench, homed, frames as they come; the run folder."""
    frames = LiveFrames(correct=False, live=live)
    return acquire(plan, bench, runs, simulate=True, home=True, frames=frames, operator=operator)
