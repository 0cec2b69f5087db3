"""Estimated time of a simulated bench for the steps of a plan: it draws every picture with rays.

A target is drawn once a place and colour, on all cores, and its further frames get new noise alone. What a pixel
of it takes differs tenfold from scene to scene, so some pixels are drawn and timed. Every frame of a flow has
particles and a core of its own, while others correct the one before, and a flow is seen in real time.
"""

from collections.abc import Sequence

from daq.bench.bench_table import Bench
from daq.plans.forecast import frames_s
from daq.plans.steps import Step
from ground.rows import thread_count
from sim.arranged import arrange, sheet_mm, true_scene
from sim.bench_table import SimulationTable, simulation_of
from sim.light import colours_of, in_each_colour, target_light
from sim.renderer.patterns import place
from sim.renderer.render import drawing_s
from sim.world import print_of

FLOW_S = 0.35  # for a million pixels of a frame with particles
NOISE_S = 0.06
STEP_S = 0.04  # motors, journal, disk


def estimate_s(bench: Bench, steps: Sequence[Step]) -> list[float]:
    """Return the seconds that each step will take on an idle computer, drawing included.

    Parameters
    ----------
    bench : Bench
        With a `simulation` section.
    steps : sequence of Step
        What is to be done.
    """
    table = simulation_of(bench)
    seen: set[tuple[object, ...]] = set()
    views_s: dict[tuple[str, str], float] = {}
    found = []
    for step in steps:
        taken_s = STEP_S + _frames_s(bench, table, step)
        if step.pulses is None and table.ring is None and (step.shows, step.positions_mm) not in seen:
            seen.add((step.shows, step.positions_mm))
            kind = step.shows, step.view
            if kind not in views_s:
                views_s[kind] = _view_s(bench, table, step)
            taken_s += views_s[kind]
        found.append(taken_s)
    return found


def _frames_s(bench: Bench, table: SimulationTable, step: Step) -> float:
    width, height = bench.scene.camera.sensor_px
    megapixels = 1e-6 * width * height
    if step.pulses is None:
        return step.frames * megapixels * NOISE_S
    return max(frames_s(bench, step), step.frames * megapixels * FLOW_S)


def _view_s(bench: Bench, table: SimulationTable, step: Step) -> float:
    """Time to draw what the camera sees in a step."""
    scene, pose = arrange(bench, true_scene(bench, table), step.targets_mm, table.glass_off_mm)
    lamp = target_light(bench) if step.shows == "chessboard" else None
    coloured = [scene]
    if lamp is not None:
        coloured = [each for each, _ in in_each_colour(scene, colours_of(lamp.light(scene.wavelength_nm)))]
    pattern = place(print_of(bench, table.seed, step.shows), pose)
    each_s = drawing_s(coloured[0], pattern, table.samples, table.pupil, sheet_mm(bench))
    width, height = scene.camera.sensor_px
    return len(coloured) * width * height * each_s / thread_count()
