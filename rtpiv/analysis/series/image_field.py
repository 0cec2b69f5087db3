"""A mean flow on the plane turned back to where its frames show it: rows from the top, v DOWN, in px."""

import numpy as np
from numpy.typing import NDArray

from piv.correlation.vector_field import VectorField, VectorFlag
from piv.correlation.windows import WindowGrid

Floats = NDArray[np.float64]


def image_field(mean_m_s: Floats, sigma_m_s: Floats, px_per_m_s: float, windows: WindowGrid) -> VectorField:
    """A mean as vectors on the corrected image.

    Parameters
    ----------
    mean_m_s, sigma_m_s : (ny, nx, 2) float64
        Velocity and its uncertainty, rows from the lowest y up, v UP; NaN where there is none.
    px_per_m_s : float
        Displacement [px] of 1 m/s.
    windows : WindowGrid
        Where the vectors lie on the corrected image.
    """
    shift, sigma = mean_m_s[::-1] * px_per_m_s, sigma_m_s[::-1] * px_per_m_s
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
