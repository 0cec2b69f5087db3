"""Paper-like scenes by name, and what a bench does to them: everything off by fractions of a millimetre.

The nominal scene is what the experimenter believes; the true scene is what the simulated camera sees.  The
difference comes from a seed and is hidden from the correction.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tracer.bodies import Body, Sphere
from tracer.camera import Camera, Lens, look_at, thin_lens_distance_mm
from tracer.errors import SceneError
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

CROWN = ConstantMedium(1.53)
PITCH_UM = 11.0
FULL_PX = 2016
PACKING_TURN = 2e-3  # rad, by which a packing may be turned about each axis
TOUCHING_MM = 0.05  # gap up to which balls touch
BARREL_35MM = 0.018  # k1 in units of the half sensor width, a 35 mm lens at 250 mm


def _nominal(f_mm: float, distance_mm: float, *spheres: tuple[float, float, float, float, float]) -> Scene:
    """Scene on the axis; spheres as x, y, z, radius [mm], n."""
    focal_px = thin_lens_distance_mm(f_mm, distance_mm) / (PITCH_UM * 1e-3)
    position = (0.0, 0.0, distance_mm)
    middle = 0.5 * (FULL_PX - 1)
    pose = look_at(position, (0.0, 0.0, 0.0))
    camera = Camera(focal_px, (middle, middle), (FULL_PX, FULL_PX), position, pose)
    bodies = tuple(
        Sphere(f"sphere{i}", (x, y, z), radius, CROWN if n == CROWN.index else ConstantMedium(n))
        for i, (x, y, z, radius, n) in enumerate(spheres, start=1)
    )
    return Scene(camera, bodies)


def _stack(f_mm: float, distance_mm: float, radius_mm: float, count: int) -> Scene:
    """Touching spheres on the axis, the first touching the plane."""
    heights = [radius_mm * (2 * i + 1) for i in range(count)]
    return _nominal(f_mm, distance_mm, *((0.0, 0.0, z, radius_mm, 1.53) for z in heights))


def _pyramid() -> Scene:
    """Four spheres in a square, 3 mm off the plane, and one on top."""
    base = [(x, y, 28.0, 25.0, 1.53) for x, y in ((-25.0, -25.0), (25.0, -25.0), (25.0, 25.0), (-25.0, 25.0))]
    return _nominal(60.0, 500.0, *base, (0.0, 0.0, 28.0 + 25.0 * math.sqrt(2.0), 25.0, 1.53))


def _side_view() -> Scene:
    """Two spheres seen by a camera that stands 60 mm to the side."""
    scene = _stack(60.0, 500.0, 25.0, 2)
    position = (60.0, -25.0, 496.0)
    return scene.with_camera(
        replace(scene.camera, position_mm=position, rotation=look_at(position, (0.0, 0.0, 0.0)))
    )


SCENES: dict[str, Callable[[], Scene]] = {
    "one_sphere_250": lambda: _stack(35.0, 250.0, 50.0, 1),
    "one_sphere_500": lambda: _stack(60.0, 500.0, 50.0, 1),
    "one_sphere_1000": lambda: _stack(105.0, 1000.0, 50.0, 1),
    "two_spheres_500": lambda: _stack(60.0, 500.0, 25.0, 2),
    "three_spheres_500": lambda: _stack(60.0, 500.0, 25.0, 3),
    "pyramid_500": _pyramid,
    "pair_off_axis": lambda: _nominal(
        60.0, 500.0, (-14.0, 9.0, 20.0, 20.0, 1.49), (20.0, -12.0, 62.0, 30.0, 1.5195)
    ),
    "tilted": _side_view,
}


def demo_scene(name: str) -> Scene:
    """Return a nominal scene (2016 x 2016 px).

    Raises
    ------
    SceneError
        There is no scene of that name.
    """
    if name not in SCENES:
        raise SceneError(f"there is no demo scene {name!r}; choose one of {', '.join(SCENES)}")
    return SCENES[name]()


def at_size(scene: Scene, size_px: int) -> Scene:
    """Return the scene seen with `size_px` pixels across: same field of view, larger or smaller pixels."""
    return scene.with_camera(scene.camera.with_width(size_px))


def misalign(scene: Scene, seed: int, *, barrel: float = 0.0, is_packed: bool = False) -> Scene:
    """Return the true scene behind a nominal one: camera, aim, roll and every body but walls a little off.

    Parameters
    ----------
    scene : Scene
        What the experimenter believes.
    seed : int
        The same seed gives the same errors.
    barrel : float
        Barrel distortion of the true lens: k1 in units of the half sensor width.
    is_packed : bool
        Balls that touch each other are off all together, turned and moved as one, and still touch; so is a tube
        that the glass carries.

    Raises
    ------
    SceneError
        The bodies stand so close to each other or to the plane that no errors fit in; move them apart.
    """
    rng = np.random.default_rng(seed)
    bodies = scene.bodies
    shift = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.05, 0.2)])
    jitters = [rng.uniform(-0.1, 0.1, 3) for _ in bodies]
    true = replace(scene, camera=_perturb_camera(scene.camera, rng, barrel), bodies=())
    moved = {k for k, body in enumerate(bodies) if body.room is None}
    if is_packed:
        together = _balls_in_contact(bodies)
        if together:
            together |= {k for k, body in enumerate(bodies) if body.room is not None and body.carried == "glass"}
        moved |= together
        turn = Rotation.from_rotvec(rng.uniform(-PACKING_TURN, PACKING_TURN, 3))
        ends = [(bodies[k].capsule.start_mm, bodies[k].capsule.end_mm) for k in together]
        middle = np.mean(ends, axis=(0, 1)) if together else np.zeros(3)
        bodies = tuple(
            body.moved(lambda point: _vector(middle + turn.apply(np.array(point) - middle)))
            if k in together
            else body
            for k, body in enumerate(bodies)
        )
        jitters = [jitters[min(together)] if k in together else jitter for k, jitter in enumerate(jitters)]
    for spread in 1.0 + 1e-4 * np.arange(
        200
    ):  # spread the group until the jittered bodies clear each other and the plane
        try:
            return true.with_bodies(
                [
                    _shift_body(body, float(spread), shift + jitters[k]) if k in moved else body
                    for k, body in enumerate(bodies)
                ]
            )
        except SceneError:
            continue
    raise SceneError("the bodies stand too close to be misaligned; move them apart or away from the plane")


def _balls_in_contact(bodies: Sequence[Body]) -> set[int]:
    """Numbers of the balls that touch another one."""
    return {
        number
        for pair in combinations(range(len(bodies)), 2)
        for number in pair
        if all(isinstance(bodies[k], Sphere) for k in pair)
        and math.dist(*(bodies[k].capsule.start_mm for k in pair))
        <= sum(bodies[k].capsule.radius_mm for k in pair) + TOUCHING_MM
    }


def _perturb_camera(camera: Camera, rng: np.random.Generator, barrel: float) -> Camera:
    """Camera with pinhole, aim and roll off, and the principal distance of the nominal one."""
    forward = camera.rotation_matrix[2]
    nominal = np.array(camera.position_mm)
    aim = nominal - forward * (nominal[2] / forward[2])
    position = nominal + rng.uniform(-0.3, 0.3, 3) * (1.0, 1.0, 2.0)
    aim[:2] += rng.uniform(-0.5, 0.5, 2)
    up = -camera.rotation_matrix[1]
    up -= forward * (up[2] / forward[2])  # the level direction that look_at made orthogonal to the axis
    roll = float(np.arctan2(up[0], up[1]) + rng.uniform(-2e-3, 2e-3))
    lens = camera.lens
    if barrel:
        half_px = 0.5 * (camera.sensor_px[0] - 1)
        lens = Lens(k1=barrel * (camera.focal_px / half_px) ** 2)
    where, point = _vector(position), _vector(aim)
    return replace(camera, position_mm=where, rotation=look_at(where, point, roll), lens=lens)


def _shift_body(body: Body, spread: float, shift: NDArray[np.float64]) -> Body:
    """Body moved away from the world's origin by the factor `spread`, then by `shift`."""
    middle = 0.5 * (np.array(body.capsule.start_mm) + np.array(body.capsule.end_mm))
    return body.moved(lambda point: _vector(spread * middle + shift + (np.array(point) - middle)))


def _vector(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
