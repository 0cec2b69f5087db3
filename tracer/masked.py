"""Parts of the view that no map is to use, though rays get through.

A fit compares the frames of the target with what the fitted scene shows.  Where something stands that the scene
does not list, or where a ball is not known well enough, rays are traced as ever and mean nothing.  Such a part is
kept with the scene, so that it goes wherever the scene goes: an outline in the raw frame, or all that is seen
through one sequence of bodies.  What a person wants left out, such as a wall in the flow or a reflection, is an
outline too, in the raw frame or in the plane of the vectors, and no calibration takes it away; drawn as a picture
it becomes outlines (`tracer.mask_picture`).
"""

from dataclasses import dataclass, replace

import numpy as np

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
