"""How long a simulated bench will take for the steps of a plan: it draws every picture with rays.

Seconds of one core for a million pixels, measured of scenes of one to four balls on two computers of 2024; a
slower or busy computer takes twice as long, so this says minutes or hours and no more. A target is drawn once a
place and colour, on all cores, and its further frames get new noise alone; every frame of a flow has particles
and a core of its own, while others correct the one before.
"""

from collections.abc import Sequence

from daq.bench.bench_table import Bench
from daq.plans.steps import Step
from ground.rows import thread_count
from sim.bench_table import SimulationTable, simulation_of
from sim.light import colours_of, in_each_colour, target_light

TARGET_S, TARGET_SAMPLES = 2.5, 4  # a million pixels at so many rays each
FLOW_S = 0.6
NOISE_S = 0.1
STEP_S = 0.3  # motors, journal, disk


def expected_s(bench: Bench, steps: Sequence[Step]) -> list[float]:
    """Return the seconds that each step will take, drawing included.

    Parameters
    ----------
    bench : Bench
        With a `simulation` section.
    steps : sequence of Step
        What is to be done.
    """
    table = simulation_of(bench)
    seen: set[tuple[object, ...]] = set()
    found = []
    for step in steps:
        is_new = step.pulses is not None or (step.shows, step.positions_mm) not in seen
        seen.add((step.shows, step.positions_mm))
        found.append(STEP_S + _frames_s(bench, table, step, is_new))
    return found


def _frames_s(bench: Bench, table: SimulationTable, step: Step, is_new: bool) -> float:
    width, height = bench.scene.camera.sensor_px
    megapixels = 1e-6 * width * height
    if step.pulses is not None:
        each = NOISE_S if table.flow.prepared is not None else FLOW_S
        return step.frames * megapixels * each
    view_s = 0.0
    if table.ring is None and is_new:
        lamp = target_light(bench) if step.shows == "chessboard" else None
        colours = (
            1
            if lamp is None
            else len(in_each_colour(bench.scene, colours_of(lamp.light(bench.scene.wavelength_nm))))
        )
        view_s = megapixels * TARGET_S * table.samples / TARGET_SAMPLES * colours / thread_count()
    return view_s + step.frames * megapixels * NOISE_S
