"""Viewing slopes of each branch at the plane, and their part in a vector.

A camera ray does not meet the plane at a right angle.  Where it crosses z = 0 it goes on by

    dX/dz, dY/dz        [mm along the plane for a millimetre towards the camera]

and a particle that has risen by dz above the plane stands on the ray of another place: it is seen dz dX/dz before
its own.  So a vector that is measured on the plane is not u, v but

    u - w dX/dz,        v - w dY/dz,        w the velocity through the sheet, towards the camera.

Beside glass that is the perspective of every lens, 0.03 to 0.05; behind a ball rays are bent inwards, 0.3 behind
two of them.  One camera cannot tell w from a flow.

The slope is exact: the direction of the last straight piece of the traced ray, in what surrounds the bodies at the
plane.  With a finite aperture it is that of the ray from the pupil's middle to the centroid of a particle's
picture; the particle's chief ray lies within 0.2 px of it, where slopes differ by 0.0003 at most (f/8 and f/22).

A vector stands for a window, so its slope is the mean over what the window sees, with the weights of its products;
at a rim two views with different slopes meet in one window.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap
from piv.correlation.refine import window_weights
from piv.correlation.windows import WindowGrid
from tracer.scene.scene import Scene
from tracer.strategies.trace import trace

# Nodes between those whose rays are traced for vectors: a window holds eight along each axis
SLOPE_NODE_STEP = 4
Floats = NDArray[np.float64]


def ray_slopes(scene: Scene, pixels: Floats) -> Floats:
    """Slopes dX/dz, dY/dz (..., 2), y up, at z = 0 of the rays of pixels (..., 2); NaN where none arrives."""
    rays = trace(scene, np.nan_to_num(pixels))
    way = rays.rays["direction"]
    there = rays.recovered & np.isfinite(pixels).all(axis=-1)
    along = np.where(there, way[..., 2], np.nan)
    return np.asarray(way[..., :2] / along[..., None])


def node_slopes(found: CorrectionMap, scene: Scene, every: int = 1) -> Floats:
    """Slopes of every view of the nodes of a correction map.

    Parameters
    ----------
    found : CorrectionMap
        Of the scene, with or without what the pupil does to it (`correction.maps.aperture.through_pupil`).
    scene : Scene
        The scene.
    every : int
        Every how many nodes along each axis.

    Returns
    -------
    ndarray of float64, shape (K, h / every, w / every, 2)
        dX/dz, dY/dz of each layer; NaN where the layer shows nothing.

    Raises
    ------
    StaleMap
        The map belongs to another scene.
    """
    found.check(scene)
    some = (slice(None), slice(None, None, every), slice(None, None, every))
    seen = (found.weight[some] > 0.0) & np.isfinite(found.pixel[some]).all(axis=-1)
    slopes = np.full((*seen.shape, 2), np.nan)
    slopes[seen] = ray_slopes(scene, found.pixel[some][seen])
    return slopes


def vector_slopes(found: CorrectionMap, scene: Scene, windows: WindowGrid, window_sigma: float) -> Floats:
    """Slopes (ny, nx, 2) of vectors: means over their windows of the best views; NaN where a window sees nothing.

    Parameters
    ----------
    found, scene
        As for `node_slopes`.
    windows : WindowGrid
        Where the vectors lie on the corrected image, and how large their windows are.
    window_sigma : float
        Of their weights, see `piv.correlation.settings.PivSettings`.

    Raises
    ------
    StaleMap
        The map belongs to another scene.
    """
    slopes = node_slopes(found, scene, SLOPE_NODE_STEP)[0]
    return WindowMeans(windows, window_sigma, found.grid.shape).of(slopes)


class WindowMeans:
    """Means over windows of what is known on every SLOPE_NODE_STEP-th node of a corrected frame.

    Parameters
    ----------
    windows : WindowGrid
        The windows.
    window_sigma : float
        Of their weights, see `piv.correlation.settings.PivSettings`.
    shape : (int, int)
        Of the frame.
    """

    def __init__(self, windows: WindowGrid, window_sigma: float, shape: tuple[int, int]) -> None:
        self.down, self.along = (
            _weights(first, size, windows.size_px, window_sigma)
            for first, size in zip((windows.row, windows.column), shape, strict=True)
        )

    def of(self, nodes: Floats) -> Floats:
        """Return means (ny, nx, C) of values (h, w, C) over the nodes that have one; NaN without."""
        return _window_average(nodes, self.down, self.along)

    def at_nodes(self, vectors: Floats) -> Floats:
        """Return means (h, w, 2) at nodes of the vectors (ny, nx, 2) whose windows hold them; NaN without."""
        return _window_average(vectors, self.down.T, self.along.T)


def _window_average(values: Floats, down: NDArray[Any], along: NDArray[Any]) -> Floats:
    """Means (m, n, C) of values (h, w, C), weighted along each axis; values that are NaN do not count."""
    seen = np.isfinite(values).all(axis=-1)
    total = down @ seen.astype(np.float64) @ along.T
    sums = [down @ np.where(seen, part, 0.0) @ along.T for part in np.moveaxis(values, -1, 0)]
    means: Floats = np.stack(sums, axis=-1) / np.where(total > 0.0, total, np.nan)[..., None]
    return means


def _weights(first: NDArray[np.int64], length: int, size_px: int, window_sigma: float) -> NDArray[Any]:
    """Weights (windows, nodes) of computed nodes of an axis of `length` in windows that begin at `first`."""
    place = np.arange(0, length, SLOPE_NODE_STEP)[None, :] - first[:, None]
    inside = (place >= 0) & (place < size_px)
    return np.where(inside, window_weights(size_px, window_sigma)[np.clip(place, 0, size_px - 1)], 0.0)
