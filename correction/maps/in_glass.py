"""Where the light sheet runs into a body: nothing flows there, so nothing is recovered there.

A ball that touches the target's plane is cut by a sheet that lies a little before it: 0.3 mm before the plane, a
ball of 25 mm radius fills a disc of 3.9 mm radius of the sheet.  The glass of a tube's wall, which may cross the
plane, is told by the rays that end in it.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.maps.correction_map import CorrectionMap
from correction.node_status import NodeStatus
from tracer.bodies import CONTACT_TOL_MM, Capsule
from tracer.scene.scene import Scene


def outside_glass(found: CorrectionMap, scene: Scene) -> CorrectionMap:
    """Return the map with its nodes inside bodies IN_GLASS; the same map where no body reaches through z = 0."""
    cut = [body.capsule for body in scene.seen if body.lowest_mm < -CONTACT_TOL_MM and not body.may_cross_plane]
    if not cut:
        return found
    inside = np.any([_inside(capsule, found.grid) for capsule in cut], axis=0) & found.recovered
    return replace(
        found,
        status=np.where(inside, np.uint8(NodeStatus.IN_GLASS), found.status),
        pixel=np.where(inside[..., None], np.nan, found.pixel),
        weight=np.where(inside, np.float32(0.0), found.weight),
    )


def _inside(capsule: Capsule, grid: PlaneGrid) -> NDArray[np.bool_]:
    """Nodes (h, w) inside a capsule."""
    start, end = np.array(capsule.start_mm), np.array(capsule.end_mm)
    axis = end - start
    nodes = np.concatenate((grid.nodes_mm(), np.zeros((*grid.shape, 1))), axis=-1) - start
    length2 = float(axis @ axis)
    along = np.clip(nodes @ axis / length2, 0.0, 1.0) if length2 > 0.0 else np.zeros(grid.shape)
    return np.asarray(np.linalg.norm(nodes - along[..., None] * axis, axis=-1) < capsule.radius_mm)
