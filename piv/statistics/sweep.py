"""Input of a sweep of the ensemble correlation: how frames are deformed.

The first sweep is deformed by the mean of vectors (`sweep_with`), the next by what a sweep has found (`next_sweep`
of `piv.statistics.ensemble_field`). In a turbulent flow each pair may be deformed by a field of its own
(`Sweep.of_pair`): its vectors as far as they are flow and not noise. With R the energy of the fluctuation and
sigma^2 the noise of a vector, its difference from the field of the sweep counts by R/(R + sigma^2), the best
linear guess of the flow.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.passes import interpolate_nodes
from piv.correlation.planes import fill_gaps, smooth_field
from piv.correlation.windows import WindowGrid
from piv.errors import SeriesError
from piv.statistics.cells import CELL_PX, cells_of

LEAST_REACH_PX, MOST_REACH_PX = 5, 15
SMOOTH_PX = 6.0  # standard deviation of what smooths a field before it deforms frames
LIKELY, OWN_NOISE_PX = 3.0, 0.05  # standard deviations that a pair may be off the mean; least noise of its vectors
GAP_STEPS, LEAST_AROUND = 1.5, 0.1  # how a pair's own field is continued: standard deviation, and share of vectors

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Cells = NDArray[np.bool_]


@dataclass(frozen=True)
class Sweep:
    """Input of a sweep, the same for all its parts.

    Parameters
    ----------
    shape : (int, int)
        Of the frames [px].
    field_px : ndarray of float64, shape (ny, nx, 2)
        Displacement u, v at the cells' centres that deforms the frames of a pair without a field, finite.
    energy_px2 : ndarray of float64, shape (ny, nx)
        Mean of R_uu and R_vv as far as they are known, not negative.
    spread_px2 : float
        Variance of a particle image (`piv.correlation.prepare`).
    reach_px : int
        Largest displacement left to look at, along each axis.
    solid : ndarray of bool, shape (ny, nx)
        Cells that the sweep before has found to be solid: they are masked in this one.
    """

    shape: tuple[int, int]
    field_px: Floats
    energy_px2: Floats
    spread_px2: float
    reach_px: int
    solid: Cells

    @property
    def fluid_px(self) -> Cells | None:
        """Pixels (H, W) outside solid cells; None where there is none. Beyond the cells, as the nearest one."""
        if not self.solid.any():
            return None
        cells = self.cells
        row, column = (
            np.clip((np.arange(side) - first[0]) // CELL_PX, 0, len(first) - 1)
            for side, first in zip(self.shape, (cells.row, cells.column), strict=True)
        )
        return np.asarray(~self.solid[row[:, None], column])

    @property
    def own_reach_px(self) -> int:
        """The same of a frame with itself, whose peak is only as wide as particle images."""
        return int(np.clip(np.ceil(3.0 * np.sqrt(2.0 * self.spread_px2)), LEAST_REACH_PX, self.reach_px))

    @property
    def variance_px2(self) -> Singles:
        """Expected variance (ny, nx) of the peak along an axis: that of the templates."""
        return (2.0 * self.spread_px2 + self.energy_px2).astype(np.float32)

    @property
    def cells(self) -> WindowGrid:
        """Places of the cells."""
        return cells_of(self.shape)

    def of_pair(self, vectors_px: Floats, sigma_px: Floats, good: NDArray[np.bool_], grid: WindowGrid) -> Floats:
        """Field (ny, nx, 2) at the cells that is most likely that of one pair, given its vectors on a grid.

        Each vector's difference from the field of the sweep is taken in the ratio R/(R + sigma^2) in which it is
        flow and not noise; not at all where it is larger than both allow. Where there is none around, the field is
        that of the sweep: a single pair continued over a rim goes astray.

        Parameters
        ----------
        vectors_px, sigma_px : ndarray of float64, shape (ny, nx, 2)
            Displacements and their standard uncertainty.
        good : ndarray of bool, shape (ny, nx)
            Vectors that were measured.
        grid : WindowGrid
            Where they belong.
        """
        energy = np.clip(interpolate_nodes(self.energy_px2[..., None], self.cells, grid)[..., 0], 0.0, None)
        noise = 0.5 * np.square(sigma_px).sum(axis=-1)
        off = vectors_px - interpolate_nodes(self.field_px, self.cells, grid)
        with np.errstate(invalid="ignore"):
            good = good & (np.square(off).sum(axis=-1) < LIKELY**2 * 2.0 * (energy + noise + OWN_NOISE_PX**2))
            flow = energy / (energy + noise + OWN_NOISE_PX**2)
        off = np.where(good[..., None], off * flow[..., None], 0.0)
        around = _blur(off, GAP_STEPS) / (_blur(good[..., None].astype(np.float64), GAP_STEPS) + LEAST_AROUND)
        off = _blur(np.where(good[..., None], off, around), SMOOTH_PX / grid.step_px)
        return self.field_px + interpolate_nodes(off, grid, self.cells)

    def same(self, other: "Sweep") -> bool:
        """Return whether parts of both may be added."""
        arrays = (
            (self.field_px, other.field_px),
            (self.energy_px2, other.energy_px2),
            (self.solid, other.solid),
        )
        numbers = (self.reach_px, self.spread_px2) == (other.reach_px, other.spread_px2)
        return numbers and all(np.array_equal(one, two) for one, two in arrays)


def sweep_with(
    shape: tuple[int, int],
    mean_px: Floats,
    stress_px2: Floats,
    grid: WindowGrid,
    spread_px2: float,
    solid: Cells | None = None,
) -> Sweep:
    """Get ready for a sweep.

    Parameters
    ----------
    shape : (int, int)
        Of the frames [px].
    mean_px : ndarray of float64, shape (ny, nx, 2)
        Mean displacement u, v as far as it is known, on `grid`; NaN elsewhere.
    stress_px2 : ndarray of float64, shape (ny, nx, 3)
        Reynolds stresses as far as they are known.
    grid : WindowGrid
        Where they belong.
    spread_px2 : float
        Variance of a particle image (`piv.correlation.prepare`).
    solid : ndarray of bool, shape (ny, nx), optional
        Cells that are known to be solid; default none.

    Raises
    ------
    SeriesError
        Not a single mean displacement is known.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(mean_px).all(axis=-1))
    if not known.any():
        raise SeriesError("ensemble correlation begins with the mean of vectors, and there is none; see the pairs")
    cells = cells_of(shape)
    energy = np.clip(0.5 * (stress_px2[..., 0] + stress_px2[..., 1]), 0.0, None)
    usable = np.isfinite(energy) & known
    energy = np.where(usable, energy, float(np.median(energy[usable])) if usable.any() else 0.25)
    spread = fill_gaps(np.repeat(energy[..., None], 2, axis=-1), np.ones_like(known))[0]
    energy = np.clip(interpolate_nodes(spread, grid, cells)[..., 0], 0.0, None)
    largest = 2.0 * spread_px2 + float(np.percentile(energy, 98))
    reach = int(np.clip(np.ceil(3.0 * np.sqrt(largest)), LEAST_REACH_PX, MOST_REACH_PX))
    smooth_px = smooth_field(np.where(known[..., None], mean_px, 0.0), known, SMOOTH_PX / grid.step_px)
    solid = np.zeros(cells.shape, np.bool_) if solid is None else solid
    return Sweep(shape, interpolate_nodes(smooth_px, grid, cells), energy, spread_px2, reach, solid)


def _blur(values: Floats, sigma_steps: float) -> Floats:
    blurred: Floats = scipy.ndimage.gaussian_filter(values, (sigma_steps, sigma_steps, 0.0), mode="nearest")
    return blurred
