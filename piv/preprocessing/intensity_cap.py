"""Bright particles held down, after the correction: intensity capping.

One particle that outshines its window draws the correlation to its own displacement.  Values above

    median + 2 standard deviations

of the frame are set to that (Shavit, Lowe, Steinbuck, Exp. Fluids 42, 225 (2007), who cap at median + n sigma).
The limit is one number a frame, hence nothing moves.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.errors import FrameError

DEVIATIONS = 2.0


def intensity_capped(
    frame: NDArray[Any], valid: NDArray[np.bool_] | None = None, deviations: float = DEVIATIONS
) -> NDArray[np.float32]:
    """Cap the bright end of a frame.

    Parameters
    ----------
    frame : ndarray, shape (H, W)
        Intensities; NaN does not count and stays.
    valid : ndarray of bool, shape (H, W), optional
        Pixels that the limit is taken from; default all.
    deviations : float
        Standard deviations above the median.

    Returns
    -------
    ndarray of float32, shape (H, W)

    Raises
    ------
    FrameError
        Not a 2-D frame, a mask of another shape, or a number of deviations that is not positive.
    """
    values = np.asarray(frame, np.float32)
    if values.ndim != 2:
        raise FrameError(f"a frame is a 2-D array, this one has shape {values.shape}")
    if valid is not None and valid.shape != values.shape:
        raise FrameError(f"the mask has shape {valid.shape}, the frame {values.shape}")
    if not deviations > 0.0:
        raise FrameError(f"a frame is capped a positive number of deviations above its median, not {deviations}")
    usable = np.isfinite(values)
    known = values[usable if valid is None else usable & valid]
    if not known.size:
        return values.copy()
    limit = np.float32(float(np.median(known)) + deviations * float(known.std(dtype=np.float64)))
    return np.where(values > limit, limit, values)
