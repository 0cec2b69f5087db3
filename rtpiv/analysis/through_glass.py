"""Area of the plane that a scene shows, in mm^2: as a whole, behind each body, and as the share through glass.

A node of the corrected image stands for pitch^2 of the plane.  It is HIDDEN if its straight line to the pinhole
would be stopped by a ball, as if light were not refracted.  A part of the hidden nodes is recovered, because some
pixel sees them through the glass; that part, by area, is the share that every verb and every page begins with.
Nodes inside a ball that reaches through the plane are no part of it.
Walls that part the world (windows, tubes, domes, tanks) cover whole views and hide nothing; what opaque bodies
hide alone is not counted either.

The OUTLINE of one body are the nodes whose straight line to the pinhole it would stop if it were opaque.  Glass
gives part of them back, seen through itself or through other balls; the mask says why the rest is lost.  What a
ball SHOWS is the area whose best view goes through it; it may reach beyond the outline, where the view beside the
ball is blocked.  Bodies stand behind each other, so areas of bodies overlap and do not add up to the whole.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.maps.correction_map import CorrectionMap, build_correction_map, nodes_in_glass
from correction.node_status import NodeStatus
from rtpiv.analysis.kernels.behind import mark_behind
from tracer.bodies import CONTACT_TOL_MM, Block, Body, Sphere
from tracer.errors import TracerError
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

COMPARED_WIDTH_PX = 200  # of a map that only compares arrangements: areas to a few tenths of a per cent
SAID_PX = 2500  # of one whose areas are said: to some hundredths

Window = tuple[tuple[int, int], tuple[int, int]]  # rows and columns of nodes: the first, and behind the last


@dataclass(frozen=True)
class ThroughGlass:
    """Share of the plane hidden by glass that a correction recovers.

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
        """The share, see `percent`."""
        return percent(self.share)

    @property
    def name(self) -> str:
        """Name of the hidden area."""
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
    """A share of an area as people read it, with a digit more where it is little or nearly all: all is 100 %."""
    if 0.985 <= share < 1.0:
        return f"{min(100.0 * share, 99.9):.1f} %"
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
    if (inside := nodes_in_glass(scene, grid)) is not None:
        hidden &= ~inside
    count = int(np.count_nonzero(hidden))
    if not count:
        return None
    seen = int(np.count_nonzero(recovered[hidden]))
    what = "the balls" if len(Sphere.among(glass)) == len(glass) else "the glass"
    return ThroughGlass(count * grid.pitch_mm**2, seen * grid.pitch_mm**2, what)


def coarse_map(scene: Scene, widest_px: int = COMPARED_WIDTH_PX) -> CorrectionMap:
    """Map of a scene for a camera of the same view and few pixels: what is recovered, and where."""
    small = coarsen_scene(scene, widest_px)
    return build_correction_map(small, build_ray_map(small), layers=1)


def through_scene(scene: Scene) -> ThroughGlass | None:
    """Measure what is seen through glass by the map that frames are corrected by: the figure that verbs say.

    A camera of more than SAID_PX columns is given fewer, which no digit shows.

    Returns
    -------
    ThroughGlass or None
        None if nothing is hidden, or the view has no map; `trace` says why.
    """
    try:
        found = coarse_map(scene, SAID_PX)
        return through_glass(scene, found.grid, found.recovered)
    except TracerError:
        return None


def coarse_share(scene: Scene) -> float:
    """Share of what the balls hide that is recovered, in some hundredths of a second; 1 if nothing is hidden."""
    found = coarse_map(scene)
    shown = through_glass(scene, found.grid, found.recovered)
    return 1.0 if shown is None else shown.share


def hiding(scene: Scene) -> list[Body]:
    """Bodies of glass before the plane that hide a part of it: all but walls that part the world."""
    return [body for body in scene.seen if body.media and _stands_alone(body)]


def _stands_alone(body: Body) -> bool:
    """Return whether the view passes beside a body: balls, and cuvettes in which the plane does not lie."""
    return body.room is None or (isinstance(body, Block) and body.lowest_mm > -CONTACT_TOL_MM)


def behind(bodies: Iterable[Body], scene: Scene, grid: PlaneGrid, window: Window) -> NDArray[np.bool_]:
    """Nodes before which one of the bodies stands.

    Parameters
    ----------
    bodies : iterable of Body
        Taken as opaque, and as the capsules around them; blocks as they are.
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
        (first, last), (west, east) = clip_window(reach(body, scene, grid), window)
        part = np.ascontiguousarray(marks[first - top : last - top, west - left : east - left])
        if isinstance(body, Block):
            columns, rows = np.meshgrid(np.arange(west, east), np.arange(first, last))
            nodes_mm = np.stack(
                (*(frame[:2, None, None] + frame[2] * np.stack((columns, -rows))), 0.0 * rows), axis=-1
            )
            part |= body.stands_before(scene.camera.position_mm, nodes_mm)
        else:
            start, end, radius_mm = body.capsule
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


def clip_window(found: Window | None, window: Window) -> Window:
    """The part of a window of nodes that lies within another."""
    if found is None:
        return window
    rows, columns = (
        (min(max(a, low), high), min(max(b, low), high)) for (a, b), (low, high) in zip(found, window, strict=True)
    )
    return rows, columns


def coarsen_scene(scene: Scene, widest_px: int) -> Scene:
    """Return the scene before a camera of the same view, a whole number of times coarser where it is wider."""
    return scene.coarser(max(1, round(scene.camera.sensor_px[0] / widest_px)))


Areas = Mapping[NodeStatus, float]


@dataclass(frozen=True)
class BodyShare:
    """Effect of one body on the view of the plane.

    Parameters
    ----------
    name : str
        Of the body.
    is_glass : bool
        Whether light passes.
    outline_mm2 : float
        Area of the plane, within the corrected image, that it hides or bends.
    within_mm2 : mapping of NodeStatus to float
        What becomes of that area.
    shown_mm2 : float
        Area whose best view goes through the body.
    """

    name: str
    is_glass: bool
    outline_mm2: float
    within_mm2: Areas = field(repr=False)
    shown_mm2: float

    @property
    def recovered_mm2(self) -> float:
        """Part of the outline that is recovered, by whichever view."""
        return self.within_mm2.get(NodeStatus.RECOVERED, 0.0)

    @property
    def main_loss(self) -> NodeStatus | None:
        """Status of most of the lost nodes of the outline; None if nothing is lost."""
        lost = [status for status, area in self.within_mm2.items() if status != NodeStatus.RECOVERED and area]
        return max(lost, key=lambda status: self.within_mm2[status]) if lost else None


@dataclass(frozen=True)
class PlaneShare:
    """Visible area of the plane.

    Parameters
    ----------
    size_mm : (float, float)
        Width and height of the corrected image on the plane.
    areas_mm2 : mapping of NodeStatus to float
        What becomes of it.
    direct_mm2, glass_mm2 : float
        Recovered without glass, and through it.
    through : ThroughGlass or None
        How much of what the balls hide is recovered; None if nothing is hidden.
    bodies : tuple of BodyShare
        Those before the plane, in the order of the scene.
    """

    size_mm: tuple[float, float]
    areas_mm2: Areas = field(repr=False)
    direct_mm2: float
    glass_mm2: float
    through: ThroughGlass | None
    bodies: tuple[BodyShare, ...] = field(repr=False)

    @property
    def whole_mm2(self) -> float:
        """Area of the corrected image."""
        return self.size_mm[0] * self.size_mm[1]

    @property
    def recovered_mm2(self) -> float:
        """Area that can be recovered."""
        return self.direct_mm2 + self.glass_mm2


def plane_share(scene: Scene, correction_map: CorrectionMap) -> PlaneShare:
    """Measure what a scene shows of the plane.

    Raises
    ------
    StaleMap
        The map belongs to another scene.
    """
    correction_map.check(scene)
    grid, status = correction_map.grid, correction_map.status
    node_mm2 = grid.pitch_mm**2
    height, width = grid.shape
    numbers = correction_map.branch[0][correction_map.recovered]
    by_branch = node_mm2 * np.bincount(numbers, minlength=len(correction_map.branches))
    shown = dict.fromkeys((body.name for body in scene.seen), 0.0)
    for area, branch in zip(by_branch.tolist(), correction_map.branches, strict=True):
        for body in scene.seen if area else ():
            if body.is_on(branch):
                shown[body.name] += area
    direct_mm2 = float(by_branch[0])
    return PlaneShare(
        (width * grid.pitch_mm, height * grid.pitch_mm),
        _areas(np.bincount(status.ravel(), minlength=len(NodeStatus)), node_mm2),
        direct_mm2,
        float(by_branch.sum()) - direct_mm2,
        through_glass(scene, grid, correction_map.recovered),
        tuple(
            _body_share(body, scene, correction_map, shown[body.name])
            for body in scene.seen
            if _stands_alone(body)
        ),
    )


def _body_share(body: Body, scene: Scene, correction_map: CorrectionMap, shown_mm2: float) -> BodyShare:
    grid, (height, width) = correction_map.grid, correction_map.grid.shape
    window = clip_window(reach(body, scene, grid), ((0, height), (0, width)))
    status = correction_map.status[slice(*window[0]), slice(*window[1])]
    counts = np.bincount(status[behind((body,), scene, grid, window)], minlength=len(NodeStatus))
    areas = _areas(counts, grid.pitch_mm**2)
    return BodyShare(body.name, bool(body.media), sum(areas.values()), areas, shown_mm2)


def _areas(counts: NDArray[np.int64], node_mm2: float) -> Areas:
    return {status: float(counts[status]) * node_mm2 for status in NodeStatus if counts[status]}
