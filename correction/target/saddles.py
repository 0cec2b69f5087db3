"""Candidates for chessboard corners anywhere in a frame.

Where two edges cross, intensity has a saddle: the Hessian H of the smoothed frame has eigenvalues
l1 > 0 > l2, and l1 up the bright squares.  -det H is large there, zero along a straight edge and negative on
a blob; it does not depend on rotation, and little on perspective.  The edges themselves are the directions
in which the quadratic form vanishes: at angles +-atan(sqrt(-l1 / l2)) from the eigenvector of l1.

Next to a corner the lattice has corners of the opposite kind (bright and dark exchanged), so every step
along an edge can be checked.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

SMOOTH_PX = 1.6  # standard deviation; squares down to 8 px still have one saddle a corner
NEAREST_PX = 3  # two corners are never closer
WEAKEST = 0.06  # of the strength of the strongest corners


@dataclass(frozen=True)
class Saddles:
    """Saddle points of a frame, N of them.

    Attributes
    ----------
    position_px : (N, 2) float64
        u, v, good to about 0.1 px.
    edges : (N, 2, 2) float64
        ``edges[n, k]`` is the unit vector of edge k; the squares around ``edges[n, 0] + edges[n, 1]`` and
        opposite to it are bright.
    strength : (N,) float64
        -det H.
    """

    position_px: NDArray[np.float64]
    edges: NDArray[np.float64]
    strength: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.strength)


def find_saddles(frame: NDArray[Any], mask: NDArray[np.bool_] | None = None) -> Saddles:
    """Find saddle points, strongest first.

    Parameters
    ----------
    frame : (H, W) uint8, uint16 or float32
        The frame.
    mask : (H, W) bool, optional
        True where candidates may lie.
    """
    import cv2

    smooth = cv2.GaussianBlur(frame.astype(np.float32), (0, 0), SMOOTH_PX, borderType=cv2.BORDER_REPLICATE)
    uu = cv2.sepFilter2D(smooth, cv2.CV_32F, np.array([1.0, -2.0, 1.0]), np.array([1.0]))
    vv = cv2.sepFilter2D(smooth, cv2.CV_32F, np.array([1.0]), np.array([1.0, -2.0, 1.0]))
    slope = np.array([-0.5, 0.0, 0.5])
    uv = cv2.sepFilter2D(smooth, cv2.CV_32F, slope, slope)
    strength = uv * uv - uu * vv
    size = 2 * NEAREST_PX + 1
    peak = (strength == cv2.dilate(strength, np.ones((size, size), np.uint8))) & (strength > 0.0)
    peak[:NEAREST_PX], peak[-NEAREST_PX:], peak[:, :NEAREST_PX], peak[:, -NEAREST_PX:] = False, False, False, False
    if mask is not None:
        peak &= mask
    v, u = np.nonzero(peak)
    if len(u) == 0:
        return Saddles(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0))
    value = strength[v, u].astype(np.float64)
    strong = np.sort(value)[-min(len(value), 100) :]
    keep = np.flatnonzero(value > WEAKEST * np.median(strong))
    keep = keep[np.argsort(-value[keep], kind="stable")]
    u, v = u[keep], v[keep]
    hessian = np.array([[uu[v, u], uv[v, u]], [uv[v, u], vv[v, u]]], dtype=np.float64).transpose(2, 0, 1)
    first = 0.5 * np.stack((smooth[v, u + 1] - smooth[v, u - 1], smooth[v + 1, u] - smooth[v - 1, u]), axis=-1)
    shift = -np.linalg.solve(hessian, first.astype(np.float64)[..., None])[..., 0]
    position = np.stack((u, v), axis=-1) + np.clip(shift, -1.0, 1.0)
    return Saddles(position, _edges(hessian), value[keep])


def _edges(hessian: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors (N, 2, 2) in which the quadratic forms (N, 2, 2) vanish."""
    values, vectors = np.linalg.eigh(hessian)
    low, high = values[:, 0], values[:, 1]
    up, across = vectors[:, :, 1], vectors[:, :, 0]
    angle = np.arctan(np.sqrt(np.maximum(high, 0.0) / np.maximum(-low, 1e-300)))
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return np.stack((c * up - s * across, c * up + s * across), axis=1)
