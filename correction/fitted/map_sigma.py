"""Uncertainty of the correction: the scene's covariance carried through the map, to nodes and to vectors.

Node X is shown by pixel u.  If the scene is off by dx, u really shows X + (dX/dx) dx, so the picture of X
stands that far from where it should: with C the covariance of x,

    sigma^2 = diag(G C G^T),        G = dX/dx / pitch        [corrected px]

Noise of the frame, PIV, and everything that is not a number of the scene come on top.

LIMIT.  Left out is what the map does not know well enough: crescents behind a chain of balls, nodes beside a fold.
Most of a fitted map is known to thousandths of a pixel; where the view turns wildly with every number of the
scene, by tenths.  How much is too much is the user's to say.  Sigma is asked at every SIGMA_NODE_STEP-th node;
each answer stands for the nodes around it, and the worst of its neighbours counts, so that little that is worse
comes through.

VECTORS.  The picture of plane point X stands at X + e(X), e = (dX/dx) dx.  A particle that moves
from X1 to X2 is then measured at the wrong place by about e(X), but its displacement only by

    e(X2) - e(X1)  =  (d . grad) e  to first order,        d = X2 - X1,

because what both ends share moves nothing.  Both ends are traced, so no derivative is approximated: with the
spreads of `SceneSigma` the sigma of the displacement is |spread(X2) - spread(X1)|, and that of the place
|spread(X)|.  Where one end has no picture on the vector's own branch, twice the other half is taken.

These are errors of the map, common to all pairs of a calibration: averaging over pairs does not reduce them.
The random sigma of the correlation is added to it (root sum of squares).
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field

from correction.errors import MapUsageError
from correction.fitted.scene_sigma import SceneSigma
from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import CorrectionMap, build_correction_map
from correction.node_status import NodeStatus
from ground.config import Pair, Table
from ground.errors import MapFileError
from ground.map_file import Hash, check_header, load_arrays, save_arrays
from ground.short_repr import short_repr
from piv.correlation.vector_field import VectorField
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import trace

if TYPE_CHECKING:  # who reads a fit does not wait for all that makes one
    from correction.fit.judge.result import SceneFit

KIND = "map sigma"
SIGMA_NODE_STEP = 4  # nodes between those computed; sigma is smooth


class SigmaHeader(Table):
    """Header of a stored map sigma."""

    scene_hash: Hash
    px_mm: Annotated[float, Field(gt=0.0)]
    origin_mm: Pair
    pitch_mm: Annotated[float, Field(gt=0.0)]


@short_repr
@dataclass(frozen=True)
class MapSigma:
    """Standard deviation of the correction.

    Parameters
    ----------
    grid : PlaneGrid
        Its nodes.
    sigma_px : (h, w, 2) float32
        Per axis u, v, in pixels of a corrected frame; NaN where nothing is recovered.
    behind_glass : (h, w) bool
        Nodes shown through glass.
    px_mm : float
        A corrected pixel on the plane.
    scene_hash : str
        Of the fitted scene.
    """

    grid: PlaneGrid
    sigma_px: NDArray[np.float32]
    behind_glass: NDArray[np.bool_]
    px_mm: float
    scene_hash: str

    def save(self, path: Path | str) -> None:
        """Write to a map file, atomically."""
        header = {"scene_hash": self.scene_hash, "px_mm": self.px_mm, "origin_mm": list(self.grid.origin_mm)}
        header["pitch_mm"] = self.grid.pitch_mm
        arrays: dict[str, NDArray[Any]] = {
            "sigma_px": self.sigma_px,
            "behind_glass": self.behind_glass.astype(np.uint8),
        }
        save_arrays(path, KIND, header, arrays)

    @classmethod
    def load(cls, path: Path | str) -> "MapSigma":
        """Read what `save` wrote.

        Raises
        ------
        MapFileError
            The file is damaged or holds something else.
        """
        header, arrays = load_arrays(path, KIND)
        try:
            sigma, behind = arrays["sigma_px"], arrays["behind_glass"]
        except KeyError as error:
            raise MapFileError(f"{path}: lacks {error}; run the calibration again") from None
        fits = sigma.dtype.str == "<f4" and behind.dtype.str == "|u1" and sigma.shape == (*behind.shape, 2)
        if not fits or behind.ndim != 2:
            raise MapFileError(f"{path}: arrays do not fit together; run the calibration again")
        said = check_header(path, header, SigmaHeader)
        (x0, y0), (height, width) = said.origin_mm, behind.shape
        return cls(
            PlaneGrid((x0, y0), said.pitch_mm, (height, width)), sigma, behind != 0, said.px_mm, said.scene_hash
        )


def map_sigma(fit: "SceneFit", step: int = SIGMA_NODE_STEP) -> MapSigma:
    """Carry the covariance of a fit through its correction map.

    Parameters
    ----------
    fit : SceneFit
        The fit.
    step : int
        Every how many nodes; 1 is every pixel of a corrected frame.
    """
    full_grid = grid_of(fit.measured_scene.camera)
    rows, columns = (-(-size // step) for size in full_grid.shape)
    grid = PlaneGrid(full_grid.origin_mm, full_grid.pitch_mm * step, (rows, columns))
    sheets = build_correction_map(
        fit.measured_scene,
        build_ray_map(fit.measured_scene),
        grid,
        min_magnification=0.5 * step,
        max_magnification=16.0 * step,
    )
    sigma = np.full((*sheets.status.shape, 2), np.nan, np.float32)
    for glass in (False, True):
        chosen = _nodes_seen(sheets, glass)
        sigma[chosen] = sigma_at(fit, sheets.pixel[0][chosen], glass) / full_grid.pitch_mm
    return MapSigma(grid, sigma, sheets.behind_glass, full_grid.pitch_mm, fit.measured_scene.content_hash())


def sigma_at(fit: "SceneFit", pixels: NDArray[np.float64], glass: bool) -> NDArray[np.float64]:
    """Standard deviation (N, 2) [mm] of the plane points that raw pixels (N, 2) show at z = 0."""
    return SceneSigma.of(fit).sigma(fit.measured_scene if glass else fit.measured_scene.bare(), pixels)


def _nodes_seen(sheets: CorrectionMap, glass: bool) -> NDArray[np.bool_]:
    """Nodes of the best layer seen through glass, or directly."""
    return sheets.behind_glass if glass else sheets.recovered & ~sheets.behind_glass


@dataclass(frozen=True)
class SigmaLimit:
    """Largest standard deviation of the map that is still used.

    Parameters
    ----------
    sigma : SceneSigma
        Of the scene.
    limit_px : float
        Corrected pixels, the worse axis.

    Raises
    ------
    MapUsageError
        The limit is not positive.
    """

    sigma: SceneSigma
    limit_px: float

    def __post_init__(self) -> None:
        if not self.limit_px > 0.0:
            raise MapUsageError(
                f"a limit of sigma of {self.limit_px:g} px leaves nothing; give some pixels, such as 0.1"
            )

    def within(self, found: CorrectionMap, scene: Scene) -> CorrectionMap:
        """Return the map with its nodes beyond the limit UNSURE, and nothing shown there.

        Raises
        ------
        StaleMap
            Map and scene are not those of the fit.
        """
        self.sigma.check(scene)
        found.check(scene)
        return found.without(self._beyond(found, scene) & found.recovered, NodeStatus.UNSURE)

    def _beyond(self, found: CorrectionMap, scene: Scene) -> NDArray[np.bool_]:
        """Nodes (h, w) that may be beyond the limit; those that are not recovered, too, as it happens."""
        height, width = found.grid.shape
        chosen = found.status[::SIGMA_NODE_STEP, ::SIGMA_NODE_STEP] == NodeStatus.RECOVERED
        pixels, glass = (
            found.pixel[0, ::SIGMA_NODE_STEP, ::SIGMA_NODE_STEP],
            found.branch[0, ::SIGMA_NODE_STEP, ::SIGMA_NODE_STEP] != 0,
        )
        worst = np.zeros(chosen.shape)
        for behind in (False, True):
            here = chosen & (glass == behind)
            seen = scene if behind else scene.bare()
            spread = self.sigma.sigma(seen, pixels[here]) / found.grid.pitch_mm
            worst[here] = np.nan_to_num(spread.max(axis=1), nan=np.inf)
        worst = scipy.ndimage.maximum_filter(worst, 3)
        return np.asarray(
            np.repeat(np.repeat(worst, SIGMA_NODE_STEP, 0), SIGMA_NODE_STEP, 1)[:height, :width] > self.limit_px
        )


@dataclass(frozen=True)
class VectorMapSigma:
    """Standard uncertainty of vectors from the scene fit.

    Parameters
    ----------
    position_px : (ny, nx, 2) float64
        Of the place, along u and v, in corrected pixels; NaN where nothing is known.
    displacement_px : (ny, nx, 2) float64
        Of the displacement.
    relative_px : (ny, nx, 2) float64
        Of the displacement against the median one of the field: without what an error of the scene, such as of the
        size of the print, makes of all vectors alike.
    common_px : (ny, nx, 2, C) float64
        Errors of the displacement by the draws that cameras of a joint fit have in common (`SceneSigma.joint`),
        one standard deviation each; a part of `displacement_px`.
    """

    position_px: NDArray[np.float64]
    displacement_px: NDArray[np.float64]
    relative_px: NDArray[np.float64]
    common_px: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0, 2, 0)))


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
    position, displacement, relative = np.full((3, *shape, 2), np.nan)
    position[known] = np.sqrt((here**2).sum(axis=2)) / pitch
    displacement[known] = np.sqrt((difference**2).sum(axis=2)) / pitch
    finite = np.isfinite(difference).all(axis=(1, 2))
    if finite.any():
        beside = difference - np.median(difference[finite], axis=0)
        relative[known] = np.sqrt((beside**2).sum(axis=2)) / pitch
    common = np.full((*shape, 2, sigma.joint[1]), np.nan)
    common[known] = difference[:, :, : sigma.joint[1]] / pitch
    return VectorMapSigma(position, displacement, relative, common)


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
