"""What the paper does to flow frames before they are correlated, after the correction.

1. The background is the smallest value that a pixel takes within +-4 time steps; it is subtracted.  Both
   lasers differ, so pulse A and pulse B each have their own series.
2. Particles are brought to one height by a sliding window of 10 x 10 px: (f - min) / (max - min).  Both
   envelopes are averaged over the same window first; their steps would cost three times the random error.

Both are the same for two frames of one pair, hence neither moves the correlation peak.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from correction.errors import FrameError

REACH_STEPS = 4
WINDOW_PX = 10


def without_background(frames: NDArray[Any], reach_steps: int = REACH_STEPS) -> NDArray[np.float32]:
    """Subtract the time minimum from each frame of a series of one pulse.

    Parameters
    ----------
    frames : ndarray, shape (N, H, W)
        Frames of pulse A, or of pulse B, in their order in time; at least two.
    reach_steps : int
        Time steps before and after that are looked at; fewer at both ends of the series.

    Returns
    -------
    ndarray of float32, shape (N, H, W)
        Frames without their background, not negative; NaN where any frame within reach is NaN.

    Raises
    ------
    FrameError
        Not a series, or nothing to compare with.
    """
    series = np.asarray(frames)
    if series.ndim != 3 or len(series) < 2:
        raise FrameError(f"a series of one pulse has shape (N >= 2, H, W), not {series.shape}")
    if reach_steps < 1:
        raise FrameError(f"the time minimum needs a reach of at least 1 step, got {reach_steps}")
    result = np.empty(series.shape, np.float32)
    for step in range(len(series)):
        near = series[max(0, step - reach_steps) : step + reach_steps + 1]
        result[step] = series[step].astype(np.float32) - near.min(0).astype(np.float32)
    return result


def min_max_normalised(
    frame: NDArray[Any],
    least_range: float,
    valid: NDArray[np.bool_] | None = None,
    window_px: int = WINDOW_PX,
) -> NDArray[np.float32]:
    """Bring particle images to one height by their surroundings.

    Parameters
    ----------
    frame : ndarray, shape (H, W)
        Intensities.
    least_range : float
        Smallest max - min to divide by, in counts: a few times the noise, or an empty spot becomes all noise.
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
    if not least_range > 0 or window_px < 2:
        raise FrameError(f"least_range must be positive and window_px at least 2, got {least_range}, {window_px}")
    usable = np.isfinite(values)
    if valid is not None:
        if valid.shape != values.shape:
            raise FrameError(f"the mask has shape {valid.shape}, the frame {values.shape}")
        usable = usable & valid
    share = _window_mean(usable.astype(np.float32), window_px)[usable]
    low = ndimage.minimum_filter(np.where(usable, values, np.float32(np.inf)), window_px)
    high = ndimage.maximum_filter(np.where(usable, values, np.float32(-np.inf)), window_px)
    result = np.full(values.shape, np.nan, np.float32)
    floor, top = (_window_mean(np.where(usable, x, np.float32(0)), window_px)[usable] / share for x in (low, high))
    result[usable] = (values[usable] - floor) / np.maximum(top - floor, np.float32(least_range))
    return result


def _window_mean(values: NDArray[np.float32], window_px: int) -> NDArray[np.float32]:
    """Mean over the window; of even size, it leans to the side that the minimum does not lean to."""
    mean: NDArray[np.float32] = ndimage.uniform_filter(values, window_px, origin=-1 if window_px % 2 == 0 else 0)
    return mean
