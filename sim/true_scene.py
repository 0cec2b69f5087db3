"""What a simulated bench hides from whoever measures with it: the scene as it truly is."""

from daq.bench.bench_table import Bench
from sim.bench_table import SimulationTable
from sim.demo.scenes import misaligned
from tracer.scene.scene import Scene


def true_scene(bench: Bench, table: SimulationTable) -> Scene:
    """Return where everything really is while every axis stands where the scene file holds."""
    return misaligned(bench.scene, table.seed) if table.is_misaligned else bench.scene
