"""The expected time of a rehearsal beside the processor time that its pictures take, on several benches."""

import os
import re
from dataclasses import replace

import pytest

from daq.bench.bench_file import load_bench
from daq.plans.forecast import frames_s, simulation_s
from daq.plans.plan import load_plan
from ground.rows import thread_count
from sim.bench import SimulatedBench
from sim.expected import STEP_S
from tests.daq.flow_bench import write_flow
from tests.daq.small_bench import EXAMPLES, write_bench

TARGET = "experiment: target\nclear: {z_mm: [-10.0]}\nglass: {z_mm: [0.0]}\n"
LENS = "\naperture: {f_mm: 60.0, f_number: 2.8, focus_mm: 500.0}"


@pytest.mark.parametrize(("scene", "simulation"), [
    ("", "samples: 4"), ("", "samples: 3" + LENS), ("three_spheres_500.yaml", "samples: 4"),
    ("furnace_window.yaml", "samples: 2"),
])  # fmt: skip
def test_pictures_take_what_was_expected(tmp_path, scene, simulation):
    """By processor time: what else the computer does is not meant."""
    side_px = 360
    path = write_bench(tmp_path, side_px, f"{simulation}\ncamera_transport: memory")
    if scene:
        text = (EXAMPLES / scene).read_text()
        text = re.sub(r"sensor_px: .*\]", f"sensor_px: [{side_px}, {side_px}]", text)
        (tmp_path / "scene.yaml").write_text(text)
    (tmp_path / "plan.yaml").write_text(TARGET)
    bench = load_bench(path)
    (step,) = [step for step in load_plan(tmp_path / "plan.yaml", bench).steps if step.view == "glass"]
    simulation_s(bench, [step])  # code is loaded once
    estimate_s = thread_count() * (sum(simulation_s(bench, [replace(step, frames=0)])) - STEP_S)
    simulation = SimulatedBench(bench)
    try:
        simulation.place(step.targets_mm)
        begun_s = sum(os.times()[:2])
        simulation.world.light()
        took_s = sum(os.times()[:2]) - begun_s
    finally:
        simulation.close()
    assert took_s / 1.5 < estimate_s < 1.5 * took_s + 0.02  # ticks of 10 ms


def test_a_flow_is_seen_in_real_time(tmp_path):
    """Its pictures are small, and its pulses come at their rate."""
    path, plan = write_flow(tmp_path, pairs=100, chunk=50)
    bench = load_bench(path)
    step = load_plan(plan, bench).steps[-1]
    assert simulation_s(bench, [step])[0] > frames_s(bench, step) > 4.0
