"""The corners of one ray, for drawings: pinhole, entries, exits, plane point."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.kernels.march import MAX_EVENTS, next_body
from tracer.kernels.sphere import angles, foot, through, turned
from tracer.scene import Scene


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
        World points [mm]: the pinhole, entry and exit of each sphere, and the plane point; the ray ends
        early where it is stopped, and one scene height further on where it misses the plane.
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
        cos_i, cos_t = angles(b2, radius, n)
        corners.append(centre + a - radius * cos_i * d)
        if b2 >= n * n * radius * radius:  # total reflection
            return np.array(corners)
        cosine, q = through(b2, radius, n, cos_i, cos_t)
        turn = turned(a[0], a[1], a[2], d[0], d[1], d[2], b2, cosine, q)
        p, d, last = centre + turn[:3], np.array(turn[3:]), body
        corners.append(p + radius * cos_i * d)
    if body == -1:
        reach = -p[2] / d[2] if d[2] < 0.0 else scene.camera.position_mm[2]
        corners.append(p + reach * d)
    return np.array(corners)
