"""A mesh as the kernels take it: patches, and a tree of boxes around them (``tracer.kernels.patches``)."""

import numpy as np
from numpy.typing import NDArray

from tracer.kernels.patches import BOX_NUMBERS, PATCH_NUMBERS, normal_at

LEAF = 2  # patches of a box that is divided no more
MARGIN = 1e-12  # of the size, added to boxes: rounding
MIDDLES = ((0.5, 0.5), (0.0, 0.5), (0.5, 0.0))  # a, b of the middles of edges 1-2, 2-3, 3-1


def control_points(
    points_mm: NDArray[np.float64], normals: NDArray[np.float64], triangles: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Control points (T, 10, 3) of the patches, from points (V, 3), unit normals (V, 3) and corners (T, 3)."""
    p, n = points_mm[triangles], normals[triangles]

    def on_edge(one: int, other: int) -> NDArray[np.float64]:
        rise = ((p[:, other] - p[:, one]) * n[:, one]).sum(axis=1, keepdims=True)
        return np.asarray((2.0 * p[:, one] + p[:, other] - rise * n[:, one]) / 3.0)

    edges = [on_edge(*pair) for pair in ((0, 1), (1, 0), (1, 2), (2, 1), (2, 0), (0, 2))]
    mean = np.mean(edges, axis=0)
    return np.stack([*p.transpose(1, 0, 2), *edges, mean + 0.5 * (mean - p.mean(axis=1))], axis=1)


def mesh_row(n: float, controls_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Row of a mesh of relative index n, from the control points of its patches."""
    low, high = controls_mm.min(axis=1), controls_mm.max(axis=1)
    order, boxes = _boxes(low, high)
    centre = 0.5 * (low.min(axis=0) + high.max(axis=0))
    radius = float(np.linalg.norm(controls_mm - centre, axis=2).max())
    head = [n, float(len(boxes)), *centre, radius]
    return np.concatenate((head, boxes.ravel(), controls_mm[order].transpose(0, 2, 1).ravel()))


def _boxes(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Order of the patches, and boxes (B, BOX_NUMBERS), parents before children: halves along the longest side."""
    margin = MARGIN * float((high.max(axis=0) - low.min(axis=0)).max())
    order, boxes = np.arange(len(low)), []

    def divide(first: int, last: int) -> None:
        among = order[first:last]
        box = [*(low[among].min(axis=0) - margin), *(high[among].max(axis=0) + margin), first, 0, 0]
        boxes.append(box)
        if last - first <= LEAF:
            box[-2] = last - first
        else:
            middle = 0.5 * (low[among] + high[among])
            axis = int(np.argmax(np.ptp(middle, axis=0)))
            half = (last - first) // 2
            order[first:last] = among[np.argsort(middle[:, axis], kind="stable")]
            divide(first, first + half)
            divide(first + half, last)
        box[-1] = len(boxes)

    divide(0, len(low))
    return order, np.array(boxes).reshape(-1, BOX_NUMBERS)


def kinks(triangles: NDArray[np.int64], controls_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angle [rad] between neighbouring patches in the middle of each edge (E,): what the surface does not know.

    Patches meet at right angles to the normals of their corners; between these each has its own.
    """
    rows = np.ascontiguousarray(controls_mm.transpose(0, 2, 1)).reshape(len(triangles), PATCH_NUMBERS)
    normals = np.array([[normal_at(row, 0, a, b) for a, b in MIDDLES] for row in rows]).reshape(-1, 3)
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    most = int(triangles.max()) + 1
    _, which = np.unique(edges.min(axis=1) * most + edges.max(axis=1), return_inverse=True)
    pairs = np.argsort(which.reshape(-1), kind="stable").reshape(-1, 2)
    return np.asarray(np.linalg.norm(normals[pairs[:, 0]] - normals[pairs[:, 1]], axis=1))
