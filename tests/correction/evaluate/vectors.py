"""Vector fields made by hand."""

import numpy as np

from piv.correlation.vector_field import VectorField, VectorFlag


def uniform_field(shape, shift_px, step_px=8, window_px=16):
    """Every node of a corrected image of `shape` measured the same displacement, without error."""
    y, x = (np.arange(window_px / 2, side - window_px / 2, step_px) for side in shape)
    ones = np.ones((len(y), len(x)))
    return VectorField(
        x_px=x,
        y_px=y,
        u_px=shift_px[0] * ones,
        v_px=shift_px[1] * ones,
        flags=np.full(ones.shape, VectorFlag.VALID, np.uint8),
        peak_ratio=3.0 * ones,
        correlation=0.9 * ones,
        sigma_u_px=0.01 * ones,
        sigma_v_px=0.01 * ones,
        valid_fraction=ones,
        window_px=window_px,
        step_px=step_px,
        nan_pixels=0,
    )
