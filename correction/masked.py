"""Masked parts of a scene (`tracer.masked`), as pixels, branches and nodes.

Every correction map is made without them: without pixels and branches while it is inverted, without nodes of the
plane when that is done (`correction.maps.correction_map`).  Who looks at raw pixels asks `mask_pixels`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from correction.node_status import NodeStatus
from tracer.masked import LEFT_OUT, UNCONFIRMED, UNLISTED, MaskedPart, Point
from tracer.scene.scene import Scene
from tracer.strategies.branches import Branch
from tracer.strategies.ray_map import RayMap

STATUS = {
    UNLISTED: NodeStatus.UNLISTED,
    UNCONFIRMED: NodeStatus.UNCONFIRMED,
    LEFT_OUT: NodeStatus.LEFT_OUT,
}


def mask_pixels(scene: Scene, ray_map: RayMap | None = None) -> NDArray[np.uint8]:
    """Reasons (H, W) for which pixels of a scene's camera are masked: a NodeStatus, 0 where they are not.

    Parameters
    ----------
    scene : Scene
        The scene.
    ray_map : RayMap, optional
        Its ray map; without it only outlines are drawn.
    """
    why = np.zeros(scene.camera.shape, np.uint8)
    if ray_map is not None and scene.masked:
        why[:] = mask_branches(scene, ray_map.branches)[ray_map.branch]
    for part in scene.masked:
        why[pixels_in(part, why.shape)] = STATUS[part.why]
    return why


def mask_branches(scene: Scene, branches: Sequence[Branch]) -> NDArray[np.uint8]:
    """The same of branches (B,), which are masked as a whole."""
    of_way = {part.through: STATUS[part.why] for part in scene.masked if part.through}
    return np.array([of_way.get(tuple(names), NodeStatus.RECOVERED) for names in branches], np.uint8)


def pixels_in(part: MaskedPart, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels (H, W) inside the outline of a part in the raw frame; none without one."""
    inside = np.zeros(shape, np.bool_)
    if not part.outline_px:
        return inside
    return _fill(np.array(part.outline_px), shape)


def nodes_in(part: MaskedPart, nodes_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask of the nodes x, y (..., 2) of the plane inside the outline of a part there; none without one."""
    if not part.outline_mm:
        return np.zeros(nodes_mm.shape[:-1], np.bool_)
    return points_in(part.outline_mm, nodes_mm)


def points_in(outline: ArrayLike, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask of the points (..., 2) inside a polygon: a ray to the right crosses it an odd number of times."""
    x, y, corners = points[..., 0], points[..., 1], np.asarray(outline)
    odd = np.zeros(x.shape, np.bool_)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if y0 != y1:
            odd ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return odd


def sweep(part: MaskedPart, steps_px: NDArray[np.float64]) -> MaskedPart:
    """Return the part with what it covers when moved by any of the steps (N, 2), or by a part of one."""
    if not part.outline_px:
        return part
    steps = np.vstack(([0.0, 0.0], steps_px))[:, None]
    return replace(part, outline_px=hull_px((np.array(part.outline_px) + steps).reshape(-1, 2)))


def hull_px(points: NDArray[np.float64]) -> tuple[Point, ...]:
    """Convex outline of points u, v (N, 2), to a tenth of a pixel."""
    corners = points[scipy.spatial.ConvexHull(points).vertices]
    return tuple((round(u, 1), round(v, 1)) for u, v in corners.tolist())


def _fill(outline: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """`points_in` for all pixels (H, W): in each row those left of an odd number of crossings."""
    height, width = shape
    odd = np.zeros((height, width + 1), np.uint8)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        first, last = (
            int(np.clip(np.ceil(y), 0, height)) for y in sorted((y0, y1))
        )  # rows y with low <= y < high
        if first < last:
            rows = np.arange(first, last)
            left = np.clip(np.ceil(x0 + (rows - y0) * (x1 - x0) / (y1 - y0)), 0, width).astype(int)
            odd[rows, left] ^= 1  # from here to the right one crossing less
    return np.bitwise_xor.accumulate(odd[:, ::-1], axis=1)[:, ::-1][:, 1:].astype(np.bool_)
