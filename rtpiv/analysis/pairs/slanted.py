"""The slant of a pair: slopes of the rays that show its vectors, and what a flow through the sheet makes of them.

What is measured is u - w dX/dz (`correction.maps.slant`); w is given, or assumed (`piv.statistics.out_of_plane`).
What a stage has moved within the plane, by a known way, has no w, and is asked for none.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap
from correction.maps.slant import vector_slopes
from daq.runs.run_views import tells_a_scale_alone
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorField
from piv.correlation.windows import WindowGrid
from piv.statistics.out_of_plane import OutOfPlane, SlantedField, ThroughSheet
from tracer.scene.scene import Scene


@dataclass(frozen=True)
class Slanted:
    """Slant of the vectors of a pair, in the order of its field: rows from the top of the image.

    Parameters
    ----------
    sigma_px : (ny, nx, 2) float64
        Standard uncertainty of u and v by the velocity through the sheet; NaN where nothing was measured.
    through : ThroughSheet
        Slopes of the rays, y UP, and what is not known of that velocity [px].
    said : str
        What that velocity was taken to be.
    """

    sigma_px: NDArray[np.float64]
    through: ThroughSheet
    said: str


def viewing_slopes(
    found: CorrectionMap, scene: Scene, windows: WindowGrid, window_sigma: float
) -> NDArray[np.float64] | None:
    """`correction.maps.slant.vector_slopes`, or None where only a scale is given."""
    return None if tells_a_scale_alone(scene) else vector_slopes(found, scene, windows, window_sigma)


def perspective_error(
    field: VectorField,
    found: CorrectionMap,
    scene: Scene,
    settings: PivSettings,
    known: OutOfPlane,
    dt_s: float | None,
) -> Slanted | None:
    """Slant of the vectors of a corrected pair; None where nothing is known of the camera that would tell.

    Parameters
    ----------
    field : VectorField
        Its vectors.
    found : CorrectionMap
        That its frames were corrected with.
    scene : Scene
        Of the map.
    settings : PivSettings
        That it was correlated with.
    known : OutOfPlane
        What is known of the velocity through the sheet.
    dt_s : float, optional
        Time between its frames; without it a given speed is of no use.

    Raises
    ------
    StaleMap
        The map belongs to another scene.
    """
    windows = settings.result_grid(found.grid.shape)
    slope = viewing_slopes(found, scene, windows, settings.window_sigma)
    if slope is None:
        return None
    measured = field.valid[..., None]
    uv = np.where(measured, np.stack((field.u_px, field.v_px), axis=-1), np.nan)
    noise = np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)
    seen = SlantedField(uv, noise, slope, windows.size_px / windows.step_px)
    px_per_m_s = np.nan if dt_s is None else 1e3 * dt_s * found.grid.px_per_mm
    sigma_w = known.of_pair(seen, px_per_m_s)
    return Slanted(seen.sigma(sigma_w), seen.through_sheet(sigma_w), known.sentence)
