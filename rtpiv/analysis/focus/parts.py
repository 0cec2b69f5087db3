"""Parts of a view by what the line of sight meets: beside all glass, and rings behind each stack of balls.

A pixel belongs behind those balls that its straight line of sight crosses; its radius is that of the ball nearest
the camera, r = distance of the line from the centre / R.  Parts that are cut by a silhouette are left out, and a
band around every ball as well: a wide pupil sees both sides of an edge.
"""

import numpy as np
from numpy.typing import NDArray

from rtpiv.analysis.focus.blur import FEWEST_PX
from tracer.scene.scene import Scene

RINGS = {"centre": (0.0, 0.2), "halfway": (0.35, 0.55), "rim": (0.6, 0.75)}
BESIDE_FROM = 1.45  # radii


def parts_of(scene: Scene) -> dict[str, NDArray[np.bool_]]:
    """Masks (H, W) by name: ``beside``, and ``BALLS: centre``, ``halfway`` and ``rim`` for each stack of balls."""
    camera = scene.camera
    rows, columns = np.indices(camera.shape)
    rays = camera.directions(np.stack((columns, rows), axis=-1))
    balls = sorted(scene.spheres, key=lambda s: -s.centre_mm[2])
    beside = np.ones(camera.shape, np.bool_)
    radii = []
    for ball in balls:
        to = np.subtract(ball.centre_mm, camera.position_mm)
        off = np.linalg.norm(np.cross(rays, to), axis=-1) / ball.radius_mm
        radii.append(off)
        beside &= off > BESIDE_FROM
    parts = {"beside": beside}
    crossed = np.zeros(camera.shape, np.int64)
    for bit, off in enumerate(radii):
        crossed |= (off < 1.0).astype(np.int64) << bit
    for stack in np.unique(crossed):
        members = [k for k in range(len(balls)) if stack >> k & 1]
        if not members:
            continue
        name = "+".join(balls[k].name for k in members)
        for ring, (low, high) in RINGS.items():
            off = radii[members[0]]
            parts[f"{name}: {ring}"] = (crossed == stack) & (off >= low) & (off < high)
    return {name: part for name, part in parts.items() if np.count_nonzero(part) >= FEWEST_PX}
