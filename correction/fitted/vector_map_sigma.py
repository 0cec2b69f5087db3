"""What the uncertainty of a fitted scene does to vectors: to their place, and to their length.

If the scene is off by dx, the picture of plane point X stands at X + e(X), e = G(X) dx.  A particle that moves
from X1 to X2 is then measured at the wrong place by about e(X), but its displacement only by

    e(X2) - e(X1)  =  (d . grad) e  to first order,        d = X2 - X1,

because what both ends share moves nothing.  Both ends are traced, so no derivative is approximated: with the
spreads of `SceneSigma` the sigma of the displacement is |spread(X2) - spread(X1)|, and that of the place
|spread(X)|.  Where one end has no picture on the vector's own branch, twice the other half is taken.

These are errors of the map, common to all pairs of a calibration: averaging over pairs does not reduce them.
The random sigma of the correlation comes on top, in squares.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from correction.fitted.scene_sigma import SceneSigma
from correction.maps.correction_map import CorrectionMap
from piv.correlation.vector_field import VectorField
from tracer.scene.scene import Scene
from tracer.strategies.trace import trace


@dataclass(frozen=True)
class VectorMapSigma:
    """Standard uncertainty of vectors from the scene fit.

    Parameters
    ----------
    position_px : (ny, nx, 2) float64
        Of the place, along u and v, in corrected pixels; NaN where nothing is known.
    displacement_px : (ny, nx, 2) float64
        Of the displacement.
    """

    position_px: NDArray[np.float64]
    displacement_px: NDArray[np.float64]


def vector_map_sigma(
    field: VectorField, correction_map: CorrectionMap, scene: Scene, sigma: SceneSigma
) -> VectorMapSigma:
    """Carry the scene's uncertainty to the vectors of a corrected pair.

    Parameters
    ----------
    field : VectorField
        Vectors on the corrected image.
    correction_map : CorrectionMap
        Its map.
    scene : Scene
        The scene of the map: the fitted one, or the same without its bodies.
    sigma : SceneSigma
        Of the fitted scene.

    Raises
    ------
    StaleMap
        The map or the fit belongs to another scene.
    """
    correction_map.check(scene)
    shape = field.flags.shape
    known = np.isfinite(field.u_px) & np.isfinite(field.v_px)
    centre = field.grid_px[known]
    half = 0.5 * np.stack((field.u_px, field.v_px), axis=-1)[known]
    branch = _branch(correction_map, centre)
    pixels = [_pixels(correction_map, scene, centre + way * half, branch) for way in (0, -1, 1)]
    here, before, after = (sigma.spread(scene, some) for some in pixels)
    difference = after - before
    for gap, one_sided in ((before, 2.0 * (after - here)), (after, 2.0 * (here - before))):
        missing = np.isnan(gap).any(axis=(1, 2))
        difference[missing] = one_sided[missing]
    pitch = correction_map.grid.pitch_mm
    position, displacement = np.full((2, *shape, 2), np.nan)
    position[known] = np.sqrt((here**2).sum(axis=2)) / pitch
    displacement[known] = np.sqrt((difference**2).sum(axis=2)) / pitch
    return VectorMapSigma(position, displacement)


def _nearest(correction_map: CorrectionMap, points: NDArray[np.float64]) -> tuple[NDArray[np.int64], ...]:
    """Row and column of the node nearest to each point u, v."""
    height, width = correction_map.grid.shape
    column, row = np.rint(points).astype(np.int64).T
    return np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)


def _branch(correction_map: CorrectionMap, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Branch of the best view of each point, -1 where there is none."""
    at = _nearest(correction_map, points)
    seen = correction_map.branch[0][at].astype(np.int64)
    return np.asarray(np.where(correction_map.recovered[at], seen, -1), dtype=np.int64)


def _pixels(
    correction_map: CorrectionMap, scene: Scene, points: NDArray[np.float64], branch: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Raw pixels (N, 2) that show points of the corrected image on a given branch; NaN where there is none."""
    row, column = _nearest(correction_map, points)
    off = points - np.stack((column, row), axis=-1)
    jacobian = correction_map.jacobian[0, row, column].reshape(-1, 2, 2).astype(np.float64)
    found: NDArray[np.float64] = correction_map.pixel[0, row, column] + (jacobian @ off[:, :, None])[:, :, 0]
    found[(_branch(correction_map, points) != branch) | (branch < 0) | (np.abs(off) > 1.0).any(axis=1)] = np.nan
    asked = np.nonzero(np.isfinite(found).all(axis=1))[0]
    rays = trace(scene, found[asked])
    right = [rays.branches.get(int(key)) == correction_map.branches[number]
             for key, number in zip(rays.rays["key"], branch[asked], strict=True)]  # fmt: skip
    found[asked[~np.array(right, bool) | ~rays.recovered]] = np.nan  # half a pixel beside a rim is another branch
    return found
