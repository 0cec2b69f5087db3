"""Parts of the view that no map is to use, though rays get through: what a calibration could not confirm.

A fit compares the frames of the target with what the fitted scene shows.  Where something stands that the scene
does not list, or where a ball is not known well enough, rays are traced as ever and mean nothing.  Such a part is
kept with the scene, so that it goes wherever the scene goes: an outline in the raw frame, or all that is seen
through one sequence of bodies.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from tracer.errors import SceneError

UNLISTED, UNCONFIRMED = "unlisted body", "unconfirmed"
Point = tuple[float, float]


@dataclass(frozen=True)
class MaskedPart:
    """A part of the view that is not to be used.

    Parameters
    ----------
    why : {"unlisted body", "unconfirmed"}
        Something stands there that the scene does not list; or the target did not confirm what the scene shows.
    outline_px : tuple of (float, float)
        Polygon u, v in the raw frame, three points or more; empty for `through`.
    through : tuple of str
        Names of the bodies crossed, in order (``tracer.strategies.branches``); empty for an outline.

    Raises
    ------
    SceneError
        Neither or both are given, or the outline is none.
    """

    why: str
    outline_px: tuple[Point, ...] = ()
    through: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.why not in (UNLISTED, UNCONFIRMED):
            raise SceneError(f"masked: why is {self.why!r}; give {UNLISTED!r} or {UNCONFIRMED!r}")
        if bool(self.outline_px) == bool(self.through):
            raise SceneError("masked: give outline_px or through, one of them")
        if self.outline_px and (len(self.outline_px) < 3 or not np.isfinite(self.outline_px).all()):
            raise SceneError("masked: an outline_px is a list of three points u, v or more")

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
        """Pixels (H, W) inside the outline; none of a way through."""
        inside = np.zeros(shape, np.bool_)
        if not self.outline_px:
            return inside
        points = np.array(self.outline_px)
        low = np.clip(np.floor(points.min(axis=0)), 0, (shape[1], shape[0])).astype(int)
        high = np.clip(np.ceil(points.max(axis=0)) + 1, 0, (shape[1], shape[0])).astype(int)
        v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
        odd = np.zeros(u.shape, np.bool_)
        for (x0, y0), (x1, y1) in zip(points, np.roll(points, -1, axis=0), strict=True):
            if y0 != y1:
                odd ^= ((y0 > v) != (y1 > v)) & (u < x0 + (v - y0) * (x1 - x0) / (y1 - y0))
        inside[low[1] : high[1], low[0] : high[0]] = odd
        return inside


def hull_px(points: NDArray[np.float64]) -> tuple[Point, ...]:
    """Convex outline of points u, v (N, 2), to a tenth of a pixel."""
    corners = points[scipy.spatial.ConvexHull(points).vertices]
    return tuple((round(u, 1), round(v, 1)) for u, v in corners.tolist())
