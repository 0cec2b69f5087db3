"""What the supplied frames really show: glass as their renderer traces it.

A path tracer in float32 does not start a refracted ray where it hit the surface, but a little beyond, so that
the ray does not hit the same surface again: by (1 + max |p|) 1500 ulp along the normal, towards the side it
travels to, with p the point hit in scene units (mm here) and ulp = 2^-24.  At 100 mm that is 9 um, sideways on
the ray 9 um times the sine of its angle: a tenth of a pixel.  truth.json knows nothing of it.  Written out in
plain numpy, so that neither tracer nor project renderer is trusted.
"""

import numpy as np
from numpy.typing import NDArray

from tracer.scene.scene import Scene

OFFSET = 1500.0 * 2.0**-24


def shown_mm(scene: Scene, pixels: NDArray, z_mm: float = 0.0, offset: float = OFFSET) -> NDArray:
    """Target points (N, 2) at height z_mm that pixels (N, 2) show; 0 offset is exact optics."""
    at = np.tile(np.array(scene.camera.position_mm), (len(pixels), 1))
    way = scene.camera.directions(pixels)
    for sphere in sorted(scene.spheres, key=lambda one: -one.centre_mm[2]):  # a stack, seen from above
        centre, radius = np.array(sphere.centre_mm), sphere.radius_mm
        n = sphere.medium.n(scene.wavelength_nm)
        away = at - centre
        along = np.sum(away * way, axis=1)
        deep = along**2 - np.sum(away**2, axis=1) + radius**2
        hit = deep > 0.0
        first = (at + (-along - np.sqrt(np.where(hit, deep, 0.0)))[:, None] * way)[hit]
        inside = _refracted(way[hit], (first - centre) / radius, 1.0 / n)
        start = _started(first, (first - centre) / radius, inside, offset)
        away = start - centre
        along = np.sum(away * inside, axis=1)
        last = start + (-along + np.sqrt(along**2 - np.sum(away**2, axis=1) + radius**2))[:, None] * inside
        way[hit] = _refracted(inside, (centre - last) / radius, n)
        at[hit] = _started(last, (last - centre) / radius, way[hit], offset)
    return (at + ((z_mm - at[:, 2]) / way[:, 2])[:, None] * way)[:, :2]


def _refracted(way: NDArray, normal: NDArray, ratio: float) -> NDArray:
    """Snell for unit ways (N, 3), normals (N, 3) against them, ratio of the indices before and after."""
    cosine = -np.sum(normal * way, axis=1)
    with np.errstate(invalid="ignore"):  # total reflection is NaN
        after = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))
    return ratio * way + (ratio * cosine - after)[:, None] * normal


def _started(point: NDArray, normal: NDArray, way: NDArray, offset: float) -> NDArray:
    """Where the renderer starts the ray that leaves `point`."""
    side = np.sign(np.sum(normal * way, axis=1)) * offset * (1.0 + np.abs(point).max(axis=1))
    return point + side[:, None] * normal
