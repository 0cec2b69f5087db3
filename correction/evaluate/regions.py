"""Which part of the view a vector belongs to: seen directly, through the middle of a ball, at its rim.

A window is DIRECT if every recovered node in it is seen without glass, GLASS if every one is seen through one
and the same branch, and RIM if it joins several pictures of the plane.  The radius of a node is taken from the
sphere of its branch that stands nearest the plane, r = |node - centre| / R, as in Martins et al. (2018).
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap
from piv.correlation.vector_field import VectorField
from tracer.scene.scene import Scene
from tracer.strategies.branches import last_sphere

MIDDLE = 0.75  # of the radius: where the paper quotes its accuracy behind glass


class Region(IntEnum):
    """Region of a vector."""

    NONE = 0  # nothing recovered in the window
    DIRECT = 1
    GLASS = 2
    RIM = 3


@dataclass(frozen=True)
class Regions:
    """Region and radius of every vector.

    Parameters
    ----------
    region : (ny, nx) uint8
        `Region`.
    radius : (ny, nx) float64
        r / R of the window centre behind glass or at a rim; NaN elsewhere.
    """

    region: NDArray[np.uint8]
    radius: NDArray[np.float64]

    @property
    def middle(self) -> NDArray[np.bool_]:
        """Vectors through the middle of a ball (ny, nx)."""
        return np.asarray((self.region == Region.GLASS) & (self.radius < MIDDLE))


def regions_of(field: VectorField, correction_map: CorrectionMap, scene: Scene) -> Regions:
    """Sort the vectors of a corrected pair.

    Parameters
    ----------
    field : VectorField
        Vectors on the corrected image.
    correction_map : CorrectionMap
        Its map: branches and mask.
    scene : Scene
        Its scene: where the spheres stand.
    """
    import cv2

    recovered = correction_map.recovered
    branch = np.where(recovered, correction_map.branch[0].astype(np.int64) + 1, 0)
    # An even window lies around x + 1/2: its anchor is the pixel after the centre.
    columns, rows = np.ceil(field.x_px).astype(int), np.ceil(field.y_px).astype(int)
    size = (field.window_px, field.window_px)
    lowest = cv2.erode(np.where(branch == 0, 65535, branch).astype(np.uint16), np.ones(size, np.uint8))
    highest = cv2.dilate(branch.astype(np.uint16), np.ones(size, np.uint8))
    low, high = lowest[np.ix_(rows, columns)], highest[np.ix_(rows, columns)]
    region = np.full(low.shape, Region.RIM, np.uint8)
    region[low == high] = Region.GLASS
    region[(low == high) & (low == 1)] = Region.DIRECT
    region[high == 0] = Region.NONE
    radius = _radii(field, correction_map, scene, np.where(high > 1, high.astype(np.int64) - 1, 0))
    return Regions(region, radius)


def _radii(
    field: VectorField, correction_map: CorrectionMap, scene: Scene, branch: NDArray[np.int64]
) -> NDArray[np.float64]:
    """R / R of each window centre from the sphere nearest the plane on its branch; NaN for the direct view."""
    nodes = correction_map.grid.to_mm(field.grid_px)
    radius = np.full(branch.shape, np.nan)
    for number in np.unique(branch[branch > 0]):
        last = last_sphere(scene, correction_map.branches[int(number)])
        if last is None:
            continue
        here = branch == number
        off = nodes[here] - np.array(last.centre_mm[:2])
        radius[here] = np.hypot(off[:, 0], off[:, 1]) / last.radius_mm
    return radius
