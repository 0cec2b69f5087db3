"""What the fitted map is unsure of in the mean of a series, beside what more pairs would make surer."""

from dataclasses import replace

import numpy as np

from correction.evaluate.vector_map_sigma import vector_map_sigma
from correction.fit.scene_sigma import SceneSigma
from correction.piv.vector_field import VectorField, VectorFlag
from correction.piv.windows import WindowGrid
from correction.prepared import PreparedCorrection
from daq.analysis.series.mean_flow import MeanFlow


def with_map_sigma(
    mean: MeanFlow, prepared: PreparedCorrection, windows: WindowGrid, sigma: SceneSigma
) -> MeanFlow:
    """The same statistics with the map's uncertainty of their mean.

    Parameters
    ----------
    mean : MeanFlow
        The statistics.
    prepared : PreparedCorrection
        Correction that its frames went through.
    windows : WindowGrid
        Where its vectors lie on the corrected image.
    sigma : SceneSigma
        Uncertainty of the fitted scene.
    """
    found = vector_map_sigma(image_field(mean, windows), prepared.corrector.map, prepared.scene, sigma)
    return replace(
        mean,
        map_sigma_m_s=found.displacement_px[::-1] / mean.px_per_m_s,
        map_sigma_position_mm=found.position_px[::-1] / mean.px_per_mm,
    )


def image_field(mean: MeanFlow, windows: WindowGrid) -> VectorField:
    """The mean as vectors on the corrected image: rows from the top, v DOWN, sigma that of the mean."""
    shift, sigma = mean.mean_px[::-1], mean.sigma_m_s[::-1] * mean.px_per_m_s
    known = np.isfinite(shift).all(axis=-1)
    nothing = np.full(windows.shape, np.nan)
    return VectorField(
        x_px=windows.x_px,
        y_px=windows.y_px,
        u_px=shift[..., 0],
        v_px=-shift[..., 1],
        flags=np.where(known, VectorFlag.VALID, VectorFlag.MASKED).astype(np.uint8),
        peak_ratio=nothing,
        correlation=nothing,
        sigma_u_px=sigma[..., 0],
        sigma_v_px=sigma[..., 1],
        valid_fraction=np.where(known, 1.0, 0.0),
        window_px=windows.size_px,
        step_px=windows.step_px,
        nan_pixels=0,
    )
