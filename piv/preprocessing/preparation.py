"""Preprocessing steps by name: at most one for raw frames, then steps for corrected ones.

Raw frames lose their background, whose pixels stand still there; the correction follows; then particles are
brought to one height.  Every step is the same at every place of a frame, or takes off what does not move: none
moves a correlation peak.  What is not so is refused by name.

**min-max**: particles brought to one height by their surroundings.  A sliding window of 10 x 10 px: (f - min) /
(max - min).  Both envelopes are averaged over the same window first; their steps would cost three times the
random error.  It is the same at every place of both frames, hence it does not move the correlation peak;
particles that glass dims then count as much as those beside it.

**cap**: bright particles held down.  One particle that outshines its window draws the correlation to its own
displacement.  Values above

    median + 2 standard deviations

of the frame are set to that (Shavit, Lowe, Steinbuck, Exp. Fluids 42, 225 (2007), who cap at median + n sigma).
The limit is one number a frame, hence nothing moves.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.errors import FrameError, PairError

CAP_DEVIATIONS = 2.0
MIN_MAX_PX = 10
NOISES = 6.0  # least range to divide by, in deviations of the noise, by default
SLIDING_MINIMUM, MINIMUM, MEAN, POD, UNSEEDED = "sliding-minimum", "minimum", "mean", "pod", "unseeded"
RAW = {
    SLIDING_MINIMUM: "the smallest value within 4 frames of its pulse before and after is taken off",
    MINIMUM: "the smallest value in all frames of its pulse is taken off",
    MEAN: "the mean of all frames of its pulse is taken off",
    POD: "patterns that the frames of its pulse share are taken off",
    UNSEEDED: "the mean of the frames of its pulse that the run took without seeding is taken off",
}
CORRECTED = {
    "min-max": "particles are brought to one height within 10 x 10 px",
    "cap": "values above median + 2 deviations are cut to that",
}
REFUSED = {
    "clahe": "it changes a particle with its place in a tile, so it moves correlation peaks",
    "histogram": "it changes a particle with what lies around it, so it moves correlation peaks",
}


def intensity_capped(
    frame: NDArray[Any], valid: NDArray[np.bool_] | None = None, deviations: float = CAP_DEVIATIONS
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


def min_max_normalised(
    frame: NDArray[Any],
    least_range: float | None = None,
    valid: NDArray[np.bool_] | None = None,
    window_px: int = MIN_MAX_PX,
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


@dataclass(frozen=True)
class Preparation:
    """Steps in their order.

    Parameters
    ----------
    steps : tuple of str
        At most one of RAW, then those of CORRECTED, each once.

    Raises
    ------
    PairError
        A step that is unknown, refused, given twice, or in the wrong place.
    """

    steps: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for place, name in enumerate(self.steps):
            if name in REFUSED:
                raise PairError(f"{name} is no step for a measurement: {REFUSED[name]}; leave it out")
            if name not in RAW and name not in CORRECTED:
                raise PairError(f"there is no step {name!r} for frames; there are {', '.join((*RAW, *CORRECTED))}")
            if name in self.steps[:place]:
                raise PairError(f"the step {name} is given twice; give it once")
            if name in RAW and place:
                before = self.steps[place - 1]
                what = "only one background is taken off" if before in RAW else "raw frames come first"
                raise PairError(f"the step {name} stands behind {before}: {what}")

    @property
    def background(self) -> str | None:
        """The step for raw frames."""
        return next((name for name in self.steps if name in RAW), None)

    @property
    def descriptions(self) -> list[str]:
        """Description of each step, a sentence."""
        return [(RAW | CORRECTED)[name] for name in self.steps]

    def apply(self, corrected: NDArray[Any], valid: NDArray[np.bool_]) -> NDArray[Any]:
        """Corrected frame (h, w), NaN where not `valid`, after the steps for corrected frames."""
        for name in self.steps:
            if name == "min-max":
                corrected = min_max_normalised(corrected, valid=valid)
            elif name == "cap":
                corrected = intensity_capped(corrected, valid)
        return corrected
