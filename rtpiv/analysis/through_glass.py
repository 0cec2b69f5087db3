"""How much of what the balls hide a correction gives back: what a view through glass is worth.

A node of the corrected image is HIDDEN if its straight line to the pinhole would be stopped by a ball, as if light
were not refracted.  A part of the hidden nodes is recovered, because some pixel sees them through the glass; that
part, by area, is the share that every verb and every page begins with.  Walls that part the world (windows, tubes,
domes) cover whole views and hide nothing; what opaque bodies hide alone is not counted either.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.maps.correction_map import CorrectionMap, build_correction_map
from rtpiv.analysis.kernels.behind import mark_behind
from tracer.bodies import Body, Sphere
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

WIDEST_PX = 200  # of a map that only says what is recovered: areas to a few tenths of a per cent

Window = tuple[tuple[int, int], tuple[int, int]]  # rows and columns of nodes: the first, and behind the last


@dataclass(frozen=True)
class ThroughGlass:
    """What a correction gives back of what glass hides.

    Parameters
    ----------
    hidden_mm2 : float
        Area of the plane, within the corrected image, before which balls stand.
    recovered_mm2 : float
        Part of it that is recovered.
    what : str
        What hides it: "the balls", or "the glass" if there are other bodies than balls.
    """

    hidden_mm2: float
    recovered_mm2: float
    what: str = "the balls"

    @property
    def share(self) -> float:
        """Recovered over hidden area, 0 to 1."""
        return self.recovered_mm2 / self.hidden_mm2

    @property
    def percent(self) -> str:
        """The share, below a tenth with a digit more."""
        return percent(self.share)

    @property
    def name(self) -> str:
        """What the share is of."""
        return f"of what {self.what} hide{'' if self.what.endswith('balls') else 's'}"

    @property
    def areas(self) -> str:
        """The areas that the share is made of."""
        return f"{self.recovered_mm2:.4g} of {self.hidden_mm2:.4g} mm\u00b2"

    @property
    def sentence(self) -> str:
        """The figure that a verb begins with."""
        return f"through glass: {self.percent} {self.name} ({self.areas})"


def percent(share: float) -> str:
    """A share of an area as a person reads it."""
    return f"{100.0 * share:.{1 if share < 0.0995 else 0}f} %"


def through_glass(scene: Scene, grid: PlaneGrid, recovered: NDArray[np.bool_]) -> ThroughGlass | None:
    """Measure how much of what balls hide is recovered.

    Parameters
    ----------
    scene : Scene
        The balls and the camera.
    grid : PlaneGrid
        Nodes of the corrected image.
    recovered : (h, w) bool
        Which of them the map in use recovers; a limit of its sigma may have taken nodes away.

    Returns
    -------
    ThroughGlass or None
        None if no ball hides anything of the corrected image.
    """
    glass = hiding(scene)
    hidden = behind(glass, scene, grid, ((0, grid.shape[0]), (0, grid.shape[1])))
    count = int(np.count_nonzero(hidden))
    if not count:
        return None
    seen = int(np.count_nonzero(recovered[hidden]))
    what = "the balls" if all(isinstance(body, Sphere) for body in glass) else "the glass"
    return ThroughGlass(count * grid.pitch_mm**2, seen * grid.pitch_mm**2, what)


def coarse_map(scene: Scene) -> CorrectionMap:
    """Map of a scene for a camera of the same view and few pixels: what is recovered, and where."""
    small = shown_small(scene, WIDEST_PX)
    return build_correction_map(small, build_ray_map(small), layers=1)


def coarse_share(scene: Scene) -> float:
    """Share of what the balls hide that is recovered, in some hundredths of a second; 1 if nothing is hidden."""
    found = coarse_map(scene)
    shown = through_glass(scene, found.grid, found.recovered)
    return 1.0 if shown is None else shown.share


def hiding(scene: Scene) -> list[Body]:
    """Bodies of glass before the plane that hide a part of it: all but walls that part the world."""
    return [body for body in scene.seen if body.media and body.room is None]


def behind(bodies: Iterable[Body], scene: Scene, grid: PlaneGrid, window: Window) -> NDArray[np.bool_]:
    """Nodes before which one of the bodies stands.

    Parameters
    ----------
    bodies : iterable of Body
        Taken as opaque, and as the capsules around them.
    scene : Scene
        Whose camera looks.
    grid : PlaneGrid
        Nodes of the plane.
    window : ((int, int), (int, int))
        Rows and columns asked about; they may lie beyond the grid.

    Returns
    -------
    ndarray of bool (rows, columns)
    """
    (top, bottom), (left, right) = window
    marks = np.zeros((bottom - top, right - left), np.bool_)
    frame = np.array([*grid.origin_mm, grid.pitch_mm])
    pinhole = np.array(scene.camera.position_mm)
    for body in bodies:
        (first, last), (west, east) = clipped(reach(body, scene, grid), window)
        start, end, radius_mm = body.capsule
        part = np.ascontiguousarray(marks[first - top : last - top, west - left : east - left])
        mark_behind(np.array([first, west]), frame, pinhole, np.array([*start, *end, radius_mm]), part)
        marks[first - top : last - top, west - left : east - left] = part
    return marks


def reach(body: Body, scene: Scene, grid: PlaneGrid) -> Window | None:
    """Rows and columns that a body's outline cannot leave; None beside the camera, where it may reach anywhere."""
    *ends, radius_mm = body.capsule
    points = np.array(ends)
    low, high = points.min(axis=0) - radius_mm, points.max(axis=0) + radius_mm
    pinhole = np.array(scene.camera.position_mm)
    if high[2] >= pinhole[2]:
        return None
    corners = np.array(list(product(*zip(low, high, strict=True))))
    thrown = pinhole + (corners - pinhole) * (pinhole[2] / (pinhole[2] - corners[:, 2:]))
    found = grid.to_px(thrown[:, :2])
    (u0, v0), (u1, v1) = np.floor(found.min(axis=0)), np.ceil(found.max(axis=0)) + 1.0
    return (int(v0), int(v1)), (int(u0), int(u1))


def clipped(found: Window | None, window: Window) -> Window:
    """The part of a window of nodes that lies within another."""
    if found is None:
        return window
    rows, columns = (
        (min(max(a, low), high), min(max(b, low), high)) for (a, b), (low, high) in zip(found, window, strict=True)
    )
    return rows, columns


def shown_small(scene: Scene, widest_px: int) -> Scene:
    """Return the scene before a camera of the same view, a whole number of times coarser where it is wider."""
    return scene.coarser(max(1, round(scene.camera.sensor_px[0] / widest_px)))
