"""The corners of one ray, for drawings: pinhole, entries, exits, plane point."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.kernels.march import MAX_EVENTS, next_body
from tracer.kernels.shell import SOLID, way_through
from tracer.kernels.sphere import angles, foot, turned
from tracer.scene import Scene

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
        World points [mm]: the pinhole, entry and exit of each sphere and of the cores in it, and the plane point;
        the ray ends early where it is stopped, and one scene height further on where it misses the plane.
    """
    spheres, rods = scene.sphere_table(), scene.rod_table()
    p = np.array(scene.camera.position_mm)
    d = scene.camera.directions(pixel)
    corners, last = [p], -1
    for _ in range(MAX_EVENTS):
        body = next_body(p[0], p[1], p[2], d[0], d[1], d[2], last, spheres, rods)
        if body < 0 or spheres[body, 5] != 0.0:
            break
        centre, radius, n = spheres[body, :3], float(spheres[body, 3]), float(spheres[body, 4])
        w = p - centre
        _, *foot_point = foot(w[0], w[1], w[2], d[0], d[1], d[2])
        a = np.array(foot_point)
        b2 = float(a @ a)
        if b2 >= n * n * radius * radius:  # total reflection
            return np.array([*corners, centre + a - radius * angles(b2, radius, n)[0] * d])
        inside, a, d = _inside(a, d, b2, spheres[body])
        corners += [centre + point for point in inside]
        p, last = centre + a, body
    if body == -1:
        reach = -p[2] / d[2] if d[2] < 0.0 else scene.camera.position_mm[2]
        corners.append(p + reach * d)
    return np.array(corners)


def _inside(a: Vector, d: Vector, b2: float, sphere: Vector) -> tuple[list[Vector], Vector, Vector]:
    """Corners at the surfaces of a sphere, relative to its centre, and foot point and direction behind it.

    Half the turn of ``tracer.kernels.sphere`` happens at each surface; inside index n the foot lies at a / n.
    """
    way = way_through(b2, sphere)
    layers = [(sphere[3], sphere[4]), *sphere[SOLID : SOLID + 2 * ((way + 1) // 2)].reshape(-1, 2)]
    corners, passed, outside = [], [], 1.0
    for k, (radius, n) in enumerate(layers):
        rho, nu = outside * radius, n / outside
        cos_i, cos_t = angles(b2, rho, nu)
        corners.append(a / outside - radius * cos_i * d)
        if k > 0 and way == 2 * k:  # reflected
            a, d = _turned(a, d, b2, 2.0 * b2 / (rho * rho) - 1.0, -2.0 * cos_i / rho)
            break
        g = (nu - 1.0) * (nu + 1.0) / (nu * nu) / (cos_t + cos_i / nu)
        half = cos_i * cos_t + b2 / (rho * rho * nu), g / rho
        passed.append((n, radius * cos_t, half))
        a, d = _turned(a, d, b2, *half)
        outside = n
    for n, along, half in reversed(passed):
        corners.append(a / n + along * d)
        a, d = _turned(a, d, b2, *half)
    return corners, a, d


def _turned(a: Vector, d: Vector, b2: float, cosine: float, q: float) -> tuple[Vector, Vector]:
    turn = np.array(turned(a[0], a[1], a[2], d[0], d[1], d[2], b2, cosine, q))
    return turn[:3], turn[3:]
