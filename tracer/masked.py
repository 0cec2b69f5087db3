"""Parts of the view that no map is to use, though rays get through.

A fit compares the frames of the target with what the fitted scene shows.  Where something stands that the scene
does not list, or where a ball is not known well enough, rays are traced as ever and mean nothing.  Such a part is
kept with the scene, so that it goes wherever the scene goes: an outline in the raw frame, or all that is seen
through one sequence of bodies.  What a person wants left out, such as a wall in the flow or a reflection, is an
outline too, in the raw frame or in the plane of the vectors, and no calibration takes it away.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from tracer.errors import SceneError

UNLISTED, UNCONFIRMED, LEFT_OUT = "unlisted body", "unconfirmed", "left out"
Point = tuple[float, float]


@dataclass(frozen=True)
class MaskedPart:
    """A part of the view that is not to be used.

    Parameters
    ----------
    why : {"unlisted body", "unconfirmed", "left out"}
        Something stands there that the scene does not list; the target did not confirm what the scene shows; or a
        person wants it so.
    outline_px : tuple of (float, float)
        Polygon u, v in the raw frame, three points or more.
    through : tuple of str
        Names of the bodies crossed, in order (``tracer.strategies.branches``).
    outline_mm : tuple of (float, float)
        Polygon x, y in the plane of the vectors, three points or more.

    Raises
    ------
    SceneError
        None of the three or several are given, or the outline is none.
    """

    why: str
    outline_px: tuple[Point, ...] = ()
    through: tuple[str, ...] = ()
    outline_mm: tuple[Point, ...] = ()

    def __post_init__(self) -> None:
        if self.why not in (UNLISTED, UNCONFIRMED, LEFT_OUT):
            raise SceneError(f"masked: why is {self.why!r}; give {LEFT_OUT!r}, {UNLISTED!r} or {UNCONFIRMED!r}")
        if sum(map(bool, (self.outline_px, self.through, self.outline_mm))) != 1:
            raise SceneError("masked: give outline_px, outline_mm or through, one of them")
        for name, outline in (("outline_px", self.outline_px), ("outline_mm", self.outline_mm)):
            if outline and (len(outline) < 3 or not np.isfinite(outline).all()):
                raise SceneError(f"masked: an {name} is a list of three points or more, two numbers each")

    def coarser(self, times: int) -> "MaskedPart":
        """Return the same before a camera with pixels so many times wider."""
        if times == 1:
            return self
        outline = tuple(((u + 0.5) / times - 0.5, (v + 0.5) / times - 0.5) for u, v in self.outline_px)
        return replace(self, outline_px=outline)

    def swept(self, steps_px: NDArray[np.float64]) -> "MaskedPart":
        """Return the same with what it covers when moved by any of the steps (N, 2), or by a part of one."""
        if not self.outline_px:
            return self
        steps = np.vstack(([0.0, 0.0], steps_px))[:, None]
        return replace(self, outline_px=hull_px((np.array(self.outline_px) + steps).reshape(-1, 2)))

    def within(self, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Pixels (H, W) inside the outline in the raw frame; none without one."""
        inside = np.zeros(shape, np.bool_)
        if not self.outline_px:
            return inside
        points = np.array(self.outline_px)
        low = np.clip(np.floor(points.min(axis=0)), 0, (shape[1], shape[0])).astype(int)
        high = np.clip(np.ceil(points.max(axis=0)) + 1, 0, (shape[1], shape[0])).astype(int)
        v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
        inside[low[1] : high[1], low[0] : high[0]] = _inside(points, u, v)
        return inside

    def covers(self, nodes_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the nodes x, y (..., 2) of the plane are inside the outline there; none without one."""
        if not self.outline_mm:
            return np.zeros(nodes_mm.shape[:-1], np.bool_)
        return _inside(np.array(self.outline_mm), nodes_mm[..., 0], nodes_mm[..., 1])


def _inside(
    outline: NDArray[np.float64], x: NDArray[np.floating | np.integer], y: NDArray[np.floating | np.integer]
) -> NDArray[np.bool_]:
    """Points inside a polygon (N, 2): a ray to the right crosses it an odd number of times."""
    odd = np.zeros(x.shape, np.bool_)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if y0 != y1:
            odd ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return odd


def hull_px(points: NDArray[np.float64]) -> tuple[Point, ...]:
    """Convex outline of points u, v (N, 2), to a tenth of a pixel."""
    corners = points[scipy.spatial.ConvexHull(points).vertices]
    return tuple((round(u, 1), round(v, 1)) for u, v in corners.tolist())
