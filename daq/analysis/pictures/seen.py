"""What the ideal camera of a scene sees of a pattern on the plane: the computer-generated image."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracer.ray_map import build_ray_map
from tracer.scene import Scene

Pattern = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def seen(scene: Scene, pattern: Pattern, samples: int = 3) -> NDArray[np.float32]:
    """Image of a pattern on the plane through the scene's glass, refracted light only.

    Parameters
    ----------
    scene : Scene
        The scene.
    pattern : callable
        Plane points (..., 2) [mm] -> values (...) or (..., C); NaN points stay dark.
    samples : int
        Rays a pixel along each side.

    Returns
    -------
    ndarray of float32 (H, W) or (H, W, C)
        Mean of the pattern over each pixel; 0 where no ray reaches the plane.
    """
    total: NDArray[np.float64] | None = None
    camera = scene.camera
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    for dv in offsets:
        for du in offsets:
            principal = (camera.principal_px[0] - float(du), camera.principal_px[1] - float(dv))
            plane = build_ray_map(scene.with_camera(replace(camera, principal_px=principal))).plane_mm
            reached = np.isfinite(plane[..., 0])
            values = pattern(np.where(reached[..., None], plane, 0.0))
            values = np.where(reached if values.ndim == 2 else reached[..., None], values, 0.0)
            total = values if total is None else total + values
    assert total is not None
    return (total / samples**2).astype(np.float32)
