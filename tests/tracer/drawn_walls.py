"""Random scenes with windows, tubes, glass rods, domes, liquids and balls in all of them."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.tracer.scenes import camera_at
from tracer.bodies import Body, Core, Dome, Sphere, Tube, Window
from tracer.errors import SceneError
from tracer.media import ConstantMedium, Medium
from tracer.scene.scene import Scene
from tracer.strategies.trace import TraceResult, trace_from

CAMERA_Z = 400.0
GLASS, WATER = ConstantMedium(1.5195), ConstantMedium(1.333)
AIR_CAMERA = camera_at((0.0, 0.0, CAMERA_Z), (0.0, 0.0, 0.0), 2000.0, (96, 64))


def window(**changes: object) -> Window:
    plain = Window("window", (0.0, 0.0, 150.0), (0.0, 0.0, 1.0), 10.0, 100.0, GLASS, WATER)
    return replace(plain, **changes)


def tube(**changes: object) -> Tube:
    plain = Tube("tube", (-80.0, 0.0, 0.0), (80.0, 0.0, 0.0), 50.0, 45.0, GLASS)
    return replace(plain, **changes)


def dome(**changes: object) -> Dome:
    """A flask, thicker on one side."""
    plain = Dome("dome", (0.0, 0.0, 0.0), 50.0, 45.0, GLASS, None, (0.5, 0.3, -0.4))
    return replace(plain, **changes)


def among_all_kinds(*bodies: Body, **scene: object) -> Scene:
    """A scene with a wall of every kind, those that are missing far away: kernels are compiled but once."""
    far = (
        window(name="far window", centre_mm=(-3000.0, 0.0, 300.0), normal=(1.0, 0.0, 0.0)),
        tube(name="far tube", start_mm=(-380.0, 400.0, 60.0), end_mm=(-280.0, 400.0, 60.0)),
        dome(name="far dome", centre_mm=(0.0, -400.0, 20.0), inner_centre_mm=None),
    )
    kinds = {body.kind for body in bodies}
    return Scene(AIR_CAMERA, (*bodies, *(body for body in far if body.kind not in kinds)), **scene)


def seen(scene: Scene, pixels: NDArray[np.float64]) -> TraceResult:
    """Trace pixels as rays from the pinhole, by the kernel that has been compiled for rays."""
    return trace_from(scene, np.array(scene.camera.position_mm), scene.camera.directions(pixels))


def index(rng: np.random.Generator, *choices: float) -> Medium:
    return ConstantMedium(float(rng.choice(choices)))


def drawn_window(rng: np.random.Generator, z_mm: float = 165.0) -> Window:
    normal = np.array([*rng.uniform(-0.5, 0.5, 2), 1.0])
    normal /= np.linalg.norm(normal)
    return Window(
        "window",
        (0.0, 0.0, float(z_mm + rng.uniform(-10.0, 10.0))),
        tuple(normal.tolist()),
        float(rng.choice([1e-3, 1.0, 10.0, 30.0])),
        float(rng.uniform(60.0, 200.0)),
        index(rng, 1.0, 1.46, 1.5195, 1.8),
        index(rng, 1.0, 1.33, 1.4, 1.5195) if rng.random() < 0.7 else None,
    )


def drawn_tube(rng: np.random.Generator) -> Tube:
    outer, length = float(rng.uniform(15.0, 40.0)), float(rng.uniform(20.0, 160.0))
    axis = rng.normal(size=3) * (1.0, 1.0, 0.2)
    half = 0.5 * length * axis / np.linalg.norm(axis)
    middle = np.array([*rng.uniform(-10.0, 10.0, 2), rng.uniform(0.0, 40.0)])
    start, end = tuple((middle - half).tolist()), tuple((middle + half).tolist())
    inner = outer * float(rng.choice([0.999999, 0.95, 0.8, 0.3]))
    filled = index(rng, 1.0, 1.33, 1.4, 1.7) if rng.random() < 0.6 else None
    return Tube("tube", start, end, outer, inner, index(rng, 1.0, 1.33, 1.5195, 1.7), filled)


def drawn_glass_rod(rng: np.random.Generator) -> Tube:
    axis = rng.normal(size=3) * (1.0, 1.0, 0.3)
    half = float(rng.uniform(5.0, 40.0)) * axis / np.linalg.norm(axis)
    middle = np.array([*rng.uniform(-40.0, 40.0, 2), rng.uniform(0.0, 90.0)])
    start, end = tuple((middle - half).tolist()), tuple((middle + half).tolist())
    return Tube("rod", start, end, float(rng.uniform(1.0, 12.0)), 0.0, index(rng, 1.0, 1.33, 1.5195, 1.7))


def drawn_dome(rng: np.random.Generator) -> Dome:
    """A flask among the bodies, or a dome around the camera."""
    around_camera = rng.random() < 0.4
    at = np.array(
        [0.0, 0.0, CAMERA_Z] if around_camera else [*rng.uniform(-20.0, 20.0, 2), rng.uniform(0.0, 60.0)]
    )
    outer = float(rng.uniform(90.0, 150.0) if around_camera else rng.uniform(10.0, 40.0))
    inner = outer * float(rng.choice([0.999999, 0.95, 0.8, 0.5]))
    if around_camera:
        inner = max(inner, 86.0)
    aside = rng.normal(size=3)
    aside *= rng.choice([0.0, 0.3]) * (outer - inner) / np.linalg.norm(aside)
    axis = rng.normal(size=3) * 0.2 + (0.0, 0.0, -1.0 if around_camera else 1.0)
    return Dome(
        "dome", tuple(at.tolist()), outer, inner, index(rng, 1.0, 1.33, 1.5195, 1.7),
        index(rng, 1.0, 1.33, 1.4, 1.7) if rng.random() < 0.6 else None,
        tuple((at + aside).tolist()), tuple((axis / np.linalg.norm(axis)).tolist()),
        float(rng.choice([20.0, 60.0, 180.0])),
    )  # fmt: skip


def drawn_walls(rng: np.random.Generator, both: bool = True) -> Scene:
    """A camera, perhaps (or for sure: `both`) a window, a tube and a dome, and balls, some of them hollow.

    Some tubes are rods.  Kernels are compiled for the kinds that a scene has: fast tests keep to all three.
    """
    position = (*(float(x) for x in rng.uniform(-60.0, 60.0, 2)), CAMERA_Z)
    scene = Scene(camera_at(position, (0.0, 0.0, 0.0), 5000.0, (64, 48)))
    for make in (drawn_dome, drawn_window, drawn_tube, drawn_glass_rod):
        before = len(scene.bodies)
        for _ in range(20):  # there may be no room for it
            if len(scene.bodies) == before and (both or rng.random() < 0.5):
                scene = with_room_for(scene, make(rng))
    for k in range(40):
        radius = float(rng.uniform(2.0, 14.0))
        centre = (*(float(x) for x in rng.uniform(-30.0, 30.0, 2)), float(rng.uniform(radius, 140.0)))
        ball = Sphere(f"b{k}", centre, radius, index(rng, 1.0, 1.3, 1.4, 1.5195, 1.9))
        if rng.random() < 0.2:
            ball = replace(ball, cores=(Core(radius * float(rng.uniform(0.2, 1.0)), index(rng, 1.0, 1.33)),))
        scene = with_room_for(scene, ball)
        if len(scene.bodies) > 9:
            break
    return scene


def with_room_for(scene: Scene, body: Body) -> Scene:
    """The scene with a body more, or as it is if that cannot stand there."""
    try:
        return scene.with_bodies([*scene.bodies, body])
    except SceneError:
        return scene


def aimed(rng: np.random.Generator, scene: Scene, count: int) -> NDArray[np.float64]:
    """Directions (count, 3) from the camera to points among the bodies."""
    there = np.concatenate((rng.uniform(-45.0, 45.0, (count, 2)), rng.uniform(0.0, 100.0, (count, 1))), axis=1)
    ways = there - np.array(scene.camera.position_mm)
    return ways / np.linalg.norm(ways, axis=1, keepdims=True)
