"""The optics that an array library is raced with: our rotation form, written for any library."""

from collections.abc import Callable
from typing import Any, TypeVar

from tracer.scene.scene import Scene

AnyArray = TypeVar("AnyArray")  # of Dr.Jit


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
