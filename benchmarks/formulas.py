"""The optics that array libraries are raced with: our rotation form, and textbook formulas as a plain peer.

`plane_point` is written once for any array library: what a peer gets when it is given our formulas.
`numpy_ray_map` is the same optics as anyone would write it first, in vectorised NumPy.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tracer.scene.scene import Scene

AnyArray = TypeVar("AnyArray")  # of NumPy, Dr.Jit, PyTorch or JAX


def plane_point(
    scene: Scene,
    u: AnyArray,
    v: AnyArray,
    sqrt: Callable[[Any], Any],
    select: Callable[[Any, Any, Any], Any],
) -> tuple[Any, Any]:
    """Plane point x, y of pixels u, v of an ideal camera; spheres from the camera down, misses by selects."""
    camera = scene.camera
    r = camera.rotation
    x, y = (u - camera.principal_px[0]) / camera.focal_px, (v - camera.principal_px[1]) / camera.focal_px
    scale = 1.0 / sqrt(x * x + y * y + 1.0)
    d = [(r[0][k] * x + r[1][k] * y + r[2][k]) * scale for k in range(3)]
    p = [0.0 * x + camera.position_mm[k] for k in range(3)]
    for cx, cy, cz, radius, n, _ in sorted(scene.sphere_table().tolist(), key=lambda row: -row[2]):
        w = [a - b for a, b in zip(p, (cx, cy, cz), strict=True)]
        m = -(w[0] * d[0] + w[1] * d[1] + w[2] * d[2])
        a = [w[k] + m * d[k] for k in range(3)]
        b2 = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
        hit = (b2 < radius * radius) & (m > 0.0)
        chi = select(hit, b2 * (1.0 / (radius * radius)), 0.0 * b2)
        cos_i, cos_t = sqrt(1.0 - chi), sqrt(1.0 - chi * (1.0 / (n * n)))
        g = (1.0 - 1.0 / (n * n)) / (cos_t + cos_i * (1.0 / n))
        cosine, q = 1.0 - 2.0 * chi * g * g, 2.0 * g * (cos_i * cos_t + chi * (1.0 / n)) * (1.0 / radius)
        along = b2 * q
        centre = (cx, cy, cz)
        p = [select(hit, centre[k] + a[k] * cosine + d[k] * along, p[k]) for k in range(3)]
        d = [select(hit, d[k] * cosine - a[k] * q, d[k]) for k in range(3)]
    t = -p[2] / d[2]
    return p[0] + t * d[0], p[1] + t * d[1]


def numpy_ray_map(scene: Scene, rows_per_block: int = 32) -> NDArray[np.float64]:
    """Plane points (H, W, 2) [mm] by quadratic intersection and vector Snell, in blocks that fit the cache."""
    height, width = scene.camera.shape
    out = np.empty((height, width, 2))
    spheres = scene.sphere_table()
    order = np.argsort(-spheres[:, 2])
    for first in range(0, height, rows_per_block):
        rows = np.arange(first, min(first + rows_per_block, height))
        v, u = np.meshgrid(rows, np.arange(width), indexing="ij")
        d = scene.camera.directions(np.stack((u, v), axis=-1))
        p = np.broadcast_to(np.array(scene.camera.position_mm), d.shape).copy()
        for x, y, z, radius, n, _ in spheres[order]:
            for eta, sign in ((1.0 / n, -1.0), (n, 1.0)):
                w = p - np.array([x, y, z])
                b = (w * d).sum(-1)
                q = b * b - (w * w).sum(-1) + radius * radius
                hit = q > 0.0
                t = -b + sign * np.sqrt(np.where(hit, q, 0.0))
                hit &= t > 1e-9
                s = p + t[..., None] * d
                normal = (s - np.array([x, y, z])) / radius * -sign
                cosine = -(normal * d).sum(-1)
                k = 1.0 - eta * eta * (1.0 - cosine * cosine)
                bent = eta * d + (eta * cosine - np.sqrt(np.maximum(k, 0.0)))[..., None] * normal
                p, d = np.where(hit[..., None], s, p), np.where(hit[..., None], bent, d)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -p[..., 2] / d[..., 2]
            out[rows] = p[..., :2] + t[..., None] * d[..., :2]
    return out
