"""Places of camera, glass and target at given positions of the axes, and a check that they can be drawn.

What the renderer cannot draw is said before anything runs (`check_views`): found out by the camera's own process
after minutes, it reads like a camera that no longer answers.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from daq.bench.bench_table import Bench
from daq.errors import PlanError
from daq.plans.steps import Step
from sim.bench_table import SimulationTable, simulation_of
from sim.demo.scenes import misalign
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tracer.bodies import translate_by
from tracer.errors import SceneError
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_priors


def true_scene(bench: Bench, table: SimulationTable) -> Scene:
    """Return where everything really is while every axis stands where the scene file holds.

    It is what a simulated bench hides from its user.
    """
    if not table.is_misaligned:
        return bench.scene
    priors = load_priors(bench.path.parent / bench.table.scene)
    return misalign(bench.scene, table.seed, is_packed=priors.contact_mm is not None)


def arrange(
    bench: Bench, scene: Scene, positions_mm: Mapping[str, float], glass_off_mm: Sequence[float] = (0.0, 0.0, 0.0)
) -> tuple[Scene, Pose]:
    """Scene and place of the print, from the `scene` that holds where every axis stands at home.

    Glass that was put up beside its place stands off by `glass_off_mm` wherever its axes are.
    What the bench itself carries, such as the window of a furnace, no axis moves.

    Raises
    ------
    SceneError
        Bodies or camera cannot stand there.
    """
    offsets = {element: np.zeros(3) for element in ("camera", "glass", "target", "bench")}
    offsets["glass"] += glass_off_mm
    for name, axis in bench.table.stages.axes.items():
        offsets[axis.carries]["xyz".index(axis.along)] += positions_mm[name] - bench.home_mm[name]
    camera = scene.camera
    x, y, z = (float(c) for c in np.add(camera.position_mm, offsets["camera"]))
    bodies = tuple(body.moved(translate_by(offsets[body.carried])) for body in scene.bodies)
    moved = replace(scene, camera=replace(camera, position_mm=(x, y, z)), bodies=bodies)
    return moved, Pose().translate(*(float(c) for c in offsets["target"]))


def where_scene_holds(bench: Bench, glass_off_mm: Sequence[float]) -> dict[str, float]:
    """Position of every axis at which the scene file truly holds, as far as axes can bring the glass there."""
    return {
        name: at_mm - glass_off_mm["xyz".index(axis.along)] if axis.carries == "glass" else at_mm
        for (name, at_mm), axis in zip(bench.home_mm.items(), bench.table.stages.axes.values(), strict=True)
    }


def sheet_mm(bench: Bench) -> tuple[float, float] | None:
    """Width and height of the object on the target's stage, if the bench file says it."""
    table = bench.table.keep_out
    return None if table is None else (table.target_size_mm[0], table.target_size_mm[1])


def check_views(bench: Bench, steps: Iterable[Step]) -> None:
    """Refuse what the simulated camera cannot draw.

    Raises
    ------
    PlanError
        A step, or the whole bench, cannot be drawn; names the step, the body and the cure.
    """
    table = simulation_of(bench)
    try:
        scene = true_scene(bench, table)
    except SceneError as error:
        raise PlanError(f"the simulated bench cannot be set up: {error}") from None
    looked_at = set()
    for step in steps:
        if step.positions_mm in looked_at:
            continue
        looked_at.add(step.positions_mm)
        try:
            there, pose = arrange(bench, scene, step.targets_mm, table.glass_off_mm)
            tables_of(there, pose, table.pupil, sheet_mm(bench))
        except SceneError as error:
            said = f"the simulated bench cannot show step {step.index + 1} ({step.tag})"
            raise PlanError(f"{said}: {error}") from None
