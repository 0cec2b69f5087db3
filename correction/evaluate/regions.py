"""Which part of the view a vector belongs to: direct, through the middle of a ball, at its rim; errors by it.

A window is DIRECT if every recovered node in it is seen without glass, GLASS if every one is seen through one
and the same branch, and RIM if it joins several pictures of the plane.  The radius of a node is taken from the
sphere of its branch that stands nearest the plane, r = |node - centre| / R, as in Martins et al. (2018).

By region stands what their second test asks: how well the vectors of a particle sheet find the known amount by
which it was moved.  The sheet moves as a whole, so every vector has the same true
value; bias and scatter by region say what the glass costs.  The stage that moved the sheet has an error of
its own, which is part of the budget of the bias and of nothing else.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap
from piv.correlation.vector_field import VectorField
from tracer.scene.scene import Scene
from tracer.strategies.branches import last_sphere

MIDDLE = 0.75  # of the radius: where the paper quotes its accuracy behind glass
RINGS = tuple(np.round(np.arange(0.0, 1.375, 0.125), 3).tolist())


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


@dataclass(frozen=True)
class Scatter:
    """Errors of the vectors of one region, per axis (u right, v down), in corrected pixels.

    Parameters
    ----------
    count : int
        Measured vectors (flag VALID).
    bias_px, std_px : (float, float)
        Mean error and its standard deviation.
    sigma_px : (float, float)
        Root mean square of the uncertainty that the evaluation itself estimated.
    """

    count: int
    bias_px: tuple[float, float]
    std_px: tuple[float, float]
    sigma_px: tuple[float, float]

    @property
    def total_px(self) -> tuple[float, float]:
        """Root mean square error along u and v, bias included."""
        return float(np.hypot(self.bias_px[0], self.std_px[0])), float(np.hypot(self.bias_px[1], self.std_px[1]))


@dataclass(frozen=True)
class ShiftResult:
    """Errors against a known shift.

    Parameters
    ----------
    shift_px : (float, float)
        True displacement, u right, v down.
    stage_px : (float, float)
        Standard error of a position of the stage along u and v, in pixels: what a common bias may be without any
        fault of the optics.
    regions : mapping of str to Scatter
        "seen directly", "behind glass, r < 0.75 R", "behind glass", "across a rim".
    rings : mapping of (float, float) to Scatter
        Behind glass and at rims, by r / R from, to.
    valid, nodes : int
        Measured vectors, and nodes of the vector grid.
    """

    shift_px: tuple[float, float]
    stage_px: tuple[float, float]
    regions: Mapping[str, Scatter]
    rings: Mapping[tuple[float, float], Scatter]
    valid: int
    nodes: int

    def to_dict(self) -> dict[str, Any]:
        """JSON-able figures."""
        return {
            "shift_px": list(self.shift_px),
            "stage_px": list(self.stage_px),
            "valid_vectors": self.valid,
            "nodes": self.nodes,
            "regions": {name: vars(scatter) for name, scatter in self.regions.items()},
            "rings": [{"from": low, "to": high, **vars(scatter)} for (low, high), scatter in self.rings.items()],
        }


def shift_errors(field: VectorField, shift_px: tuple[float, float]) -> NDArray[np.float64]:
    """Errors (ny, nx, 2) of a field against a uniform displacement; NaN where there is no measured vector."""
    errors = np.stack((field.u_px - shift_px[0], field.v_px - shift_px[1]), axis=-1)
    return np.where(field.valid[..., None], errors, np.nan)


def evaluate_shift(
    field: VectorField,
    regions: Regions,
    shift_px: tuple[float, float],
    stage_px: tuple[float, float] = (0.0, 0.0),
) -> ShiftResult:
    """Compare a field with the shift of the sheet.

    Parameters
    ----------
    field : VectorField
        Vectors on the corrected image.
    regions : Regions
        Where each belongs.
    shift_px : (float, float)
        True displacement in corrected pixels, u right, v DOWN.
    stage_px : (float, float)
        Standard error of a position of the stage along u and v, in pixels.
    """
    errors = shift_errors(field, shift_px)
    sigma = np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)
    chosen = {
        "seen directly": regions.region == Region.DIRECT,
        f"behind glass, r < {MIDDLE} R": regions.middle,
        "behind glass": regions.region == Region.GLASS,
        "across a rim": regions.region == Region.RIM,
    }
    found = {name: scatter_of(errors, sigma, field.valid & where) for name, where in chosen.items()}
    through = (regions.region == Region.GLASS) | (regions.region == Region.RIM)
    rings = by_radius(errors, sigma, np.where(field.valid & through, regions.radius, np.nan))
    return ShiftResult(
        shift_px,
        stage_px,
        {name: scatter for name, scatter in found.items() if scatter.count},
        rings,
        int(field.valid.sum()),
        int(field.flags.size),
    )


def by_radius(
    errors: NDArray[np.float64], sigma: NDArray[np.float64], radius: NDArray[np.float64]
) -> dict[tuple[float, float], Scatter]:
    """Scatter of errors (..., 2) in rings of r / R (...), NaN where a vector has no place in any."""
    rings = {
        (low, high): scatter_of(errors, sigma, (radius >= low) & (radius < high)) for low, high in pairwise(RINGS)
    }
    return {ring: scatter for ring, scatter in rings.items() if scatter.count}


def scatter_of(errors: NDArray[np.float64], sigma: NDArray[np.float64], where: NDArray[np.bool_]) -> Scatter:
    """Bias, scatter and estimated sigma of errors (..., 2) [px] where `where` (...)."""
    count = int(where.sum())
    if not count:
        nan = (float("nan"), float("nan"))
        return Scatter(0, nan, nan, nan)
    bias, std = errors[where].mean(axis=0), errors[where].std(axis=0)
    known = sigma[where][np.isfinite(sigma[where]).all(axis=1)]
    rms = np.sqrt((known**2).mean(axis=0)) if len(known) else np.full(2, np.nan)
    return Scatter(
        count, (float(bias[0]), float(bias[1])), (float(std[0]), float(std[1])), (float(rms[0]), float(rms[1]))
    )
