"""The corners of one ray, for drawings: pinhole, entries, exits, plane point."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.kernels.ball import MEAN, inside
from tracer.kernels.branches import body_of
from tracer.kernels.landing import STATE, trace_states
from tracer.kernels.rays import MAX_EVENTS
from tracer.kernels.sphere import RADIUS, REFRACTIVE_INDEX, SOLID, angles, rotate, way_through
from tracer.kernels.world import RECOVERED, World
from tracer.scene.scene import Scene
from tracer.strategies.trace import world_of

Vector = NDArray[np.float64]


def ray_path(scene: Scene, pixel: ArrayLike) -> NDArray[np.float64]:
    """Corners of the ray through an acquired pixel.

    Parameters
    ----------
    scene : Scene
        The scene.
    pixel : array_like (2,)
        u, v.

    Returns
    -------
    ndarray (N, 3)
        World points [mm]: the pinhole, entry and exit of each sphere and of the cores in it, exits of other
        bodies, and the plane point; the ray ends early where it is stopped, and one scene height further on where
        it misses the plane.
    """
    world, corners = world_of(scene), [np.array(scene.camera.position_mm)]
    trail, state = np.empty(MAX_EVENTS, np.int32), np.empty((MAX_EVENTS, STATE))
    start = tuple(scene.camera.directions(pixel).tolist())
    status, end, onwards, _, events = trace_states(scene.camera.position_mm, start, world, trail, state)
    p, d = np.array(end), np.array(onwards)
    bodies = [body_of(event, world.spheres)[0] for event in trail[:events].tolist()]
    centres = [world.spheres[body, :RADIUS] if body >= 0 else np.zeros(3) for body in bodies]
    starts = [*(state[k, :3] + centre for k, centre in enumerate(centres)), p]
    for k, (body, centre) in enumerate(zip(bodies, centres, strict=True)):
        w, way, m, b2 = state[k, :3], state[k, 3:6], state[k, 6], float(state[k, 7])
        if body < 0:
            corners.append(starts[k + 1])
        elif world.shapes and world.shapes[0][body, MEAN] > 0.0:
            corners += [centre + point for point in _in_ball(state[k, :6], world, body)]
        elif b2 < world.spheres[body, RADIUS] ** 2:  # else a tangent
            corners += [centre + point for point in _corners_inside(w + m * way, way, b2, world.spheres[body])]
    if status == RECOVERED:
        reach = -p[2] / d[2] if d[2] < 0.0 else scene.camera.position_mm[2]
        corners.append(p + reach * d)
    return np.array(corners)


def _in_ball(state: Vector, world: World, body: int) -> list[Vector]:
    """Corners at the surfaces of a ball out of round, relative to its centre; none of a ray beside it."""
    ball = world.spheres[body]
    p, d = (state[:3] + ball[:3]).tolist(), state[3:].tolist()
    surfaces = inside(tuple(p), tuple(d), ball, world.shapes[0][body])
    return [np.array(point) for point, _, _ in surfaces] if np.isfinite(surfaces[0][2]) else []


def _corners_inside(a: Vector, d: Vector, b2: float, sphere: Vector) -> list[Vector]:
    """Corners at the surfaces of a sphere, relative to its centre; one alone where all light is reflected outside.

    Half the turn of ``tracer.kernels.sphere`` happens at each surface; inside index n the foot lies at a / n.
    """
    radius, n = sphere[RADIUS], sphere[REFRACTIVE_INDEX]
    if b2 >= (n * radius) ** 2:
        return [a - radius * angles(b2, radius, n)[0] * d]
    way = way_through(b2, sphere)
    layers = [(radius, n), *sphere[SOLID : SOLID + 2 * ((way + 1) // 2)].reshape(-1, 2)]
    corners, passed, outside = [], [], 1.0
    for k, (radius, n) in enumerate(layers):
        rho, nu = outside * radius, n / outside
        cos_i, cos_t = angles(b2, rho, nu)
        corners.append(a / outside - radius * cos_i * d)
        if k > 0 and way == 2 * k:  # reflected
            a, d = _rotate(a, d, b2, 2.0 * b2 / (rho * rho) - 1.0, -2.0 * cos_i / rho)
            break
        g = (nu - 1.0) * (nu + 1.0) / (nu * nu) / (cos_t + cos_i / nu)
        half = cos_i * cos_t + b2 / (rho * rho * nu), g / rho
        passed.append((n, radius * cos_t, half))
        a, d = _rotate(a, d, b2, *half)
        outside = n
    for n, along, half in reversed(passed):
        corners.append(a / n + along * d)
        a, d = _rotate(a, d, b2, *half)
    return corners


def _rotate(a: Vector, d: Vector, b2: float, cosine: float, q: float) -> tuple[Vector, Vector]:
    a_behind, d_behind = rotate(tuple(a), tuple(d), b2, (cosine, q))
    return np.array(a_behind), np.array(d_behind)
