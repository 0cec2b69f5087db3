"""Displacements of particles that keep their height while they cross a light whose height changes.

Both frames are looked up on the surface of the light, z = h(x, y) (`correction.maps.light_height`).  Of the
particles at x those shine in both that are near both heights: on average, at the middle of their way, they are at
h(x).  In frame A the map expects them at h(x - d/2) and in frame B at h(x + d/2), and a particle that is dz higher
than expected is seen dz dX/dz before its place.  So what is measured is

    d + (h(x + d/2) - h(x - d/2)) dX/dz

apart from what a flow through the sheet adds (`correction.maps.slant`); to first order d + (d . grad h) dX/dz.

A window measures where the peak of its correlation is, which is no mean: particles displaced by c beside the
others pull the peak by c exp(-c^2 / 2 s^2), s the width of a peak.  Where two bundles of light meet, the mean
height has a step that no particle takes; there the pull is small as well.  What is dark or in glass in one of the
frames pulls nothing.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap
from correction.maps.lit import PlaneLight
from correction.maps.slant import SLOPE_NODE_STEP, WindowMeans, node_slopes
from piv.correlation.vector_field import RESOLUTION_LENGTHS, VectorField
from piv.correlation.windows import WindowGrid
from tracer.scene.scene import Scene

PEAK_PX = 0.4  # standard deviation of the peak that a window of the corrected frame follows
# Of the rms of what pulls within a window: left as error where the light has steps, 0.02 px of 0.06
UNSURE = 0.3
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HeightChange:
    """Bias of displacements by the change of the light's height.

    Parameters
    ----------
    light : PlaneLight
        The light that the map was looked up on.
    nodes_mm : (h, w, 2) float64
        Every SLOPE_NODE_STEP-th node of the map.
    slope : (h, w, 2) float64
        dX/dz, dY/dz of its best view there, y up; NaN where it shows nothing.
    px_per_mm : float
        Of the corrected frame.
    shape : (int, int)
        Of the corrected frame.
    """

    light: PlaneLight
    nodes_mm: Floats
    slope: Floats
    px_per_mm: float
    shape: tuple[int, int]

    @classmethod
    def of(cls, found: CorrectionMap, scene: Scene, light: PlaneLight) -> "HeightChange":
        """Trace the slopes of a map of the surface of a light; StaleMap if the map belongs to another scene."""
        grid, every = found.grid, SLOPE_NODE_STEP
        nodes_mm = grid.nodes_mm()[::every, ::every]
        slope = node_slopes(found, scene, every)[0]
        return cls(light, nodes_mm, slope, grid.px_per_mm, grid.shape)

    def bias_px(self, shift_px: Floats, windows: WindowGrid, window_sigma: float) -> tuple[Floats, Floats]:
        """Return the bias of displacements, and how far it may be off.

        Parameters
        ----------
        shift_px : (ny, nx, 2) float64
            Displacements, v DOWN [px of the corrected frame]; NaN where there is none.
        windows, window_sigma
            That they were measured with, see `correction.maps.slant.vector_slopes`.

        Returns
        -------
        (ny, nx, 2), (ny, nx) float64
            Bias, v DOWN, and the standard uncertainty of a component of it [px]; 0 where nothing is known.
        """
        means = WindowMeans(windows, window_sigma, self.shape)
        up = np.array((1.0, -1.0))
        shift_mm = means.at_nodes(shift_px) * up / self.px_per_mm
        half_mm = 0.5 * np.nan_to_num(shift_mm)
        first = self.light.height_where_lit(self.nodes_mm - half_mm)
        last = self.light.height_where_lit(self.nodes_mm + half_mm)
        beside = (last - first)[..., None] * self.slope * self.px_per_mm
        far = np.square(beside / PEAK_PX).sum(axis=-1)
        pull = beside * np.exp(-0.5 * far)[..., None]
        bias = np.nan_to_num(means.of(pull))
        squares = np.nan_to_num(means.of(pull**2))
        return bias * up, UNSURE * np.sqrt(squares.mean(axis=-1))

    def remove_from(self, field: VectorField, windows: WindowGrid, window_sigma: float) -> VectorField:
        """Return a field of corrected frames without its bias, which vectors before the noise filter have as well.

        What is left of it is the same in every pair of a steady flow.
        """
        shift_px, lengths = np.stack((field.u_px, field.v_px), axis=-1), field.lengths
        bias, sigma_px = self.bias_px(shift_px, windows, window_sigma)
        u_px, v_px = np.moveaxis(shift_px - bias, -1, 0)
        more: dict[str, Any] = {
            name: np.hypot(lengths[name], sigma_px) for name in RESOLUTION_LENGTHS if name in lengths
        }
        if "unfiltered_px" in lengths:
            more["unfiltered_px"] = lengths["unfiltered_px"] - bias
        return replace(field, u_px=u_px, v_px=v_px, **more)
