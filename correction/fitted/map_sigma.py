"""How sure the correction is at every node: the scene's covariance carried through the map.

Node X is shown by pixel u.  If the scene is off by dx, u really shows X + (dX/dx) dx, so the picture of X
stands that far from where it should: with C the covariance of x,

    sigma^2 = diag(G C G^T),        G = dX/dx / pitch        [corrected px]

Noise of the frame, PIV, and everything that is not a number of the scene come on top.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from correction.fit.judge.result import SceneFit
from correction.fitted.scene_sigma import SceneSigma
from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import CorrectionMap, build_correction_map
from ground.config import Pair, Table
from ground.errors import MapFileError
from ground.map_file import Hash, checked, load_arrays, save_arrays
from ground.short_repr import short_repr
from tracer.strategies.ray_map import build_ray_map

KIND = "map sigma"
STEP = 4  # nodes between those computed; sigma is smooth


class SigmaHeader(Table):
    """What the header of a stored map sigma holds."""

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
        said = checked(path, header, SigmaHeader)
        (x0, y0), (height, width) = said.origin_mm, behind.shape
        return cls(
            PlaneGrid((x0, y0), said.pitch_mm, (height, width)), sigma, behind != 0, said.px_mm, said.scene_hash
        )


def map_sigma(fit: SceneFit, step: int = STEP) -> MapSigma:
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
        chosen = _seen(sheets, glass)
        sigma[chosen] = sigma_at(fit, sheets.pixel[0][chosen], glass) / full_grid.pitch_mm
    return MapSigma(grid, sigma, sheets.behind_glass, full_grid.pitch_mm, fit.measured_scene.content_hash())


def sigma_at(fit: SceneFit, pixels: NDArray[np.float64], glass: bool) -> NDArray[np.float64]:
    """Standard deviation (N, 2) [mm] of the plane points that raw pixels (N, 2) show at z = 0."""
    return SceneSigma.of(fit).sigma(fit.measured_scene if glass else fit.measured_scene.bare(), pixels)


def _seen(sheets: CorrectionMap, glass: bool) -> NDArray[np.bool_]:
    """Nodes of the best layer seen through glass, or directly."""
    return sheets.behind_glass if glass else sheets.recovered & ~sheets.behind_glass
