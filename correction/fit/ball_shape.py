"""How a landing point moves when a ball on its way is not round.

A ball of radius R + h(e) in direction e, h = e.S e with S symmetric and traceless (five numbers, an ellipsoid to
first order), meets a ray that would meet the sphere at R e, with direction d, at a path longer by

    dt = h / (d . e)            with the normal        e' - (2 / R) (S e' - h e'),        e' there.

Nothing but these two changes at each of the two surfaces; the derivative is the difference of two such traces.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tracer.camera import Camera
from tracer.sensitivity import TargetPose

Points = NDArray[np.float64]
STEP_MM = 1e-3
SHAPES = tuple(
    np.array(rows, dtype=np.float64)
    for rows in (
        ((1, 0, 0), (0, -1, 0), (0, 0, 0)),
        ((1, 0, 0), (0, 1, 0), (0, 0, -2)),
        ((0, 1, 0), (1, 0, 0), (0, 0, 0)),
        ((0, 0, 1), (0, 0, 0), (1, 0, 0)),
        ((0, 0, 0), (0, 0, 1), (0, 1, 0)),
    )
)  # the five traceless S, of which every other is a sum


def shape_rates(
    camera: Camera, spheres: Points, crossed: Sequence[int], ball: int, pixels: Points, pose: TargetPose
) -> Points:
    """Derivatives (N, 2, 5) of landing points by the numbers of `SHAPES` of one ball.

    Parameters
    ----------
    camera : Camera
    spheres : (B, 6) float64
        Sphere table; n is against the room.
    crossed : sequence of int
        Rows of the spheres that the rays cross, in order.
    ball : int
        Row of the one whose shape changes.
    pixels : (N, 2) float64
    pose : TargetPose
        Of the target.
    """
    changes = []
    for shape in SHAPES:
        ends = [_landed(camera, spheres, crossed, ball, sign * STEP_MM * shape, pixels, pose) for sign in (1, -1)]
        changes.append((ends[0] - ends[1]) / (2.0 * STEP_MM))
    return np.stack(changes, axis=2)


def _landed(
    camera: Camera,
    spheres: Points,
    crossed: Sequence[int],
    ball: int,
    shape_mm: Points,
    pixels: Points,
    pose: TargetPose,
) -> Points:
    way = camera.directions(pixels)
    at = np.broadcast_to(np.array(camera.position_mm), way.shape)
    with np.errstate(invalid="ignore"):
        for number in crossed:
            row, shape = spheres[number], shape_mm if number == ball else np.zeros((3, 3))
            for entering in (True, False):
                away = at - row[:3]
                along = np.sum(away * way, axis=1)
                root = np.sqrt(along**2 - np.sum(away**2, axis=1) + row[3] ** 2)
                path = -along - root if entering else -along + root
                out = (away + path[:, None] * way) / row[3]
                height = np.sum(out * (out @ shape), axis=1)
                at = at + (path + height / np.sum(out * way, axis=1))[:, None] * way
                out = (at - row[:3]) / np.linalg.norm(at - row[:3], axis=1, keepdims=True)
                turned = out @ shape
                normal = out - 2.0 / row[3] * (turned - height[:, None] * out)
                normal /= np.linalg.norm(normal, axis=1, keepdims=True)
                way = _refracted(way, normal if entering else -normal, 1.0 / row[4] if entering else row[4])
        origin, axes = np.array(pose.origin_mm), np.array(pose.axes)
        fall = (at - origin) @ axes[2] / (way @ axes[2])
        return np.asarray((at - fall[:, None] * way - origin) @ axes[:2].T)


def _refracted(way: Points, normal: Points, ratio: float) -> Points:
    """Snell's law; normals against the ways, ratio of the indices before and after."""
    across = way - np.sum(way * normal, axis=1, keepdims=True) * normal
    after = ratio * across
    return np.asarray(after - np.sqrt(1.0 - np.sum(after**2, axis=1, keepdims=True)) * normal)
