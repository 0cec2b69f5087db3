"""What the camera of a scene sees of a pattern on the plane: the computer-generated image."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from rtpiv.analysis.pictures.patterns import Pattern
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import RayMap, build_ray_map

WIDEST_PX = 1008  # of a picture: as large as it is drawn
Watched = Callable[[Iterable[tuple[float, float]], int, str], Iterable[tuple[float, float]]]


def seen(
    scene: Scene, pattern: Pattern, samples: int = 3, watched: Watched = lambda items, total, what: items
) -> NDArray[np.float32]:
    """Image of a pattern on the plane through the scene's glass, refracted light only.

    Parameters
    ----------
    scene : Scene
        The scene.
    pattern : Pattern
        What hangs on the plane.
    samples : int
        Rays a pixel along each side.
    watched : callable
        Passes items on and says how far they are, see `ground.terminal.progress`.

    Returns
    -------
    ndarray of float32 (H, W), or (H, W, 3) of a pattern in colour
        Mean of the pattern over each pixel; 0 where no ray reaches the plane.
    """
    camera, (height, width) = scene.camera, scene.camera.shape
    total = np.zeros((height, width, pattern.channels), np.float32)
    offsets = ((np.arange(samples) + 0.5) / samples - 0.5).tolist()
    places = [(du, dv) for dv in offsets for du in offsets]
    ray_map: RayMap | None = None
    for du, dv in watched(places, len(places), "what the camera sees"):
        principal = (camera.principal_px[0] - du, camera.principal_px[1] - dv)
        moved = scene.with_camera(replace(camera, principal_px=principal))
        ray_map = build_ray_map(moved, ray_map)
        plane = np.asarray(ray_map.plane_mm, np.float64)

        def work(first: int, last: int, plane: NDArray[np.float64] = plane) -> None:
            pattern.add(plane[first:last].reshape(-1, 2), total[first:last].reshape(-1, pattern.channels))

        run_rows(work, height)
    total /= samples**2
    return total if pattern.channels > 1 else total[..., 0]
