"""What a mean is worth where some pairs have no vector: those that are left are not like those that were lost.

Outlier tests and weak peaks drop vectors where a window holds a shear layer or a core narrower than itself, and
which pairs are dropped depends on what the flow did in them. So a mean over those that are left is biased, and
neither their number nor their scatter says so. With p, the share of the pairs that looked at a place and have a
vector there:

* below `LEAST_SHARE` there is no mean: most of what it would be of is missing;
* above it, what was lost may have moved by anything that the mean shows around. With the range D of a component
  over 3 x 3 places, all of it alike, the mean is off by (1 - p) times a number of mean square D^2/3.

Where dropped vectors are chance, D is small, and so is this.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.statistics.moments import Moments

LEAST_SHARE = 0.5

Floats = NDArray[np.float64]


def measured_often(moments: Moments, looked: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Where (ny, nx) enough of the pairs that looked, `looked` (ny, nx) in number, have a vector."""
    return moments.count >= LEAST_SHARE * np.maximum(looked, 1)


def selection_sigma(moments: Moments, looked: NDArray[np.int64]) -> Floats:
    """Standard uncertainty (ny, nx) of a component of the mean by the vectors that were lost, see the top.

    Parameters
    ----------
    moments : Moments
        Of the vectors that are left; places without any do not count.
    looked : ndarray of int64, shape (ny, nx)
        Pairs in which the place was not masked.

    Returns
    -------
    ndarray of float64, shape (ny, nx)
        In the unit of the vectors; NaN where there is no mean.
    """
    here = moments.count > 0
    lost = 1.0 - moments.count / np.maximum(looked, 1)
    mean = np.where(here[..., None], moments.mean_uv, 0.0)
    ends = [np.where(here[..., None], sign * mean, -np.inf) for sign in (1.0, -1.0)]
    high, low = (scipy.ndimage.maximum_filter(end, (3, 3, 1)) for end in ends)
    with np.errstate(invalid="ignore"):
        square = np.square(high + low).mean(axis=-1)
    return np.where(here, np.maximum(lost, 0.0) * np.sqrt(square / 3.0), np.nan)
