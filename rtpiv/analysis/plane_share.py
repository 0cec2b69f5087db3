"""How much of the investigation plane a scene shows, in mm^2: as a whole, and behind each body.

A node of the corrected image stands for pitch^2 of the plane.  The OUTLINE of a body are the nodes whose straight
line to the pinhole it would stop if it were opaque.  Glass gives part of them back, seen through itself or through
other balls; the mask says why the rest is lost.  What a ball SHOWS is the area whose best view goes through it; it
may reach beyond the outline, where the view beside the ball is blocked.  Bodies stand behind each other, so areas
of bodies overlap and do not add up to the whole.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap
from correction.node_status import NodeStatus
from rtpiv.analysis.through_glass import ThroughGlass, behind, clipped, reach, through_glass
from tracer.bodies import Body
from tracer.scene.scene import Scene

Areas = Mapping[NodeStatus, float]


@dataclass(frozen=True)
class BodyShare:
    """What one body does to the view of the plane.

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
    def lost_to(self) -> NodeStatus | None:
        """Why most of what is lost of the outline is lost; None if nothing is."""
        lost = [status for status, area in self.within_mm2.items() if status != NodeStatus.RECOVERED and area]
        return max(lost, key=lambda status: self.within_mm2[status]) if lost else None


@dataclass(frozen=True)
class PlaneShare:
    """What a scene shows of the plane.

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
            if not set(body.event_names).isdisjoint(branch):
                shown[body.name] += area
    direct_mm2 = float(by_branch[0])
    return PlaneShare(
        (width * grid.pitch_mm, height * grid.pitch_mm),
        _areas(np.bincount(status.ravel(), minlength=len(NodeStatus)), node_mm2),
        direct_mm2,
        float(by_branch.sum()) - direct_mm2,
        through_glass(scene, grid, correction_map.recovered),
        tuple(
            _body_share(body, scene, correction_map, shown[body.name]) for body in scene.seen if body.room is None
        ),
    )


def _body_share(body: Body, scene: Scene, correction_map: CorrectionMap, shown_mm2: float) -> BodyShare:
    grid, (height, width) = correction_map.grid, correction_map.grid.shape
    window = clipped(reach(body, scene, grid), ((0, height), (0, width)))
    status = correction_map.status[slice(*window[0]), slice(*window[1])]
    counts = np.bincount(status[behind((body,), scene, grid, window)], minlength=len(NodeStatus))
    areas = _areas(counts, grid.pitch_mm**2)
    return BodyShare(body.name, bool(body.media), sum(areas.values()), areas, shown_mm2)


def _areas(counts: NDArray[np.int64], node_mm2: float) -> Areas:
    return {status: float(counts[status]) * node_mm2 for status in NodeStatus if counts[status]}
