"""Particles brought to one height by their surroundings, after the correction.

A sliding window of 10 x 10 px: (f - min) / (max - min).  Both envelopes are averaged over the same window first;
their steps would cost three times the random error.  It is the same at every place of both frames, hence it does
not move the correlation peak; particles that glass dims then count as much as those beside it.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.errors import FrameError

WINDOW_PX = 10
NOISES = 6.0  # least range to divide by, in deviations of the noise, where nobody says one


def min_max_normalised(
    frame: NDArray[Any],
    least_range: float | None = None,
    valid: NDArray[np.bool_] | None = None,
    window_px: int = WINDOW_PX,
) -> NDArray[np.float32]:
    """Bring particle images to one height by their surroundings.

    Parameters
    ----------
    frame : ndarray, shape (H, W)
        Intensities.
    least_range : float, optional
        Smallest max - min to divide by, in counts: a few times the noise, or an empty spot becomes all noise.
        Default NOISES times the deviation of the dark half of the frame.
    valid : ndarray of bool, shape (H, W), optional
        True where pixels count; default wherever they are finite.
    window_px : int
        Side of the sliding window.

    Returns
    -------
    ndarray of float32, shape (H, W)
        Values from about 0 to about 1; NaN where not valid.

    Raises
    ------
    FrameError
        Not a 2-D frame, a mask of another shape, or a range or window that is not positive.
    """
    values = np.asarray(frame, np.float32)
    if values.ndim != 2:
        raise FrameError(f"a frame is a 2-D array, this one has shape {values.shape}")
    usable = np.isfinite(values)
    if valid is not None:
        if valid.shape != values.shape:
            raise FrameError(f"the mask has shape {valid.shape}, the frame {values.shape}")
        usable = usable & valid
    if least_range is None:
        least_range = NOISES * _noise(values[usable])
    if not least_range > 0 or window_px < 2:
        raise FrameError(f"least_range must be positive and window_px at least 2, got {least_range}, {window_px}")
    share = _window_mean(usable.astype(np.float32), window_px)[usable]
    low = scipy.ndimage.minimum_filter(np.where(usable, values, np.float32(np.inf)), window_px)
    high = scipy.ndimage.maximum_filter(np.where(usable, values, np.float32(-np.inf)), window_px)
    result = np.full(values.shape, np.nan, np.float32)
    floor, top = (_window_mean(np.where(usable, x, np.float32(0)), window_px)[usable] / share for x in (low, high))
    result[usable] = (values[usable] - floor) / np.maximum(top - floor, np.float32(least_range))
    return result


def _noise(values: NDArray[np.float32]) -> float:
    """Deviation of the noise, from those values that lie below the median: particles only add light."""
    if not values.size:
        return 1.0
    middle, low = (float(each) for each in np.percentile(values, (50.0, 15.87)))
    return max(middle - low, 1e-6 * max(1.0, abs(middle)))


def _window_mean(values: NDArray[np.float32], window_px: int) -> NDArray[np.float32]:
    """Mean over the window; of even size, it leans to the side that the minimum does not lean to."""
    mean: NDArray[np.float32] = scipy.ndimage.uniform_filter(
        values, window_px, origin=-1 if window_px % 2 == 0 else 0
    )
    return mean
