"""What sampling between pixels makes of a camera's noise.

White noise of variance 1 that is sampled at a fraction f of a pixel through an interpolation h_f correlates with
itself over K(s) = sum_k h_f(k) h_f(k + s). Frames are sampled through c (1 - m) + b m, the cardinal spline and the
B-spline of degree 5 mixed by the size of the particle images (`piv.correlation.prepare`), both products of a
factor along u and one along v. Frame A is sampled at -d/2 and frame B at d/2: K is the same for both.
"""

from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.prepare import SHARPEST, SMOOTHEST

DEGREE = 5
FRACTIONS = 33  # of a pixel that are tabulated
LENGTH = 20  # pixels to each side after which a cardinal spline is none any more

Floats = NDArray[np.float64]


def noise_correlation(field_px: Floats, lags: NDArray[np.int64], spread_px2: float) -> Floats:
    """K (L, ny, nx) at displacements (L, 2), v and u, for frames deformed by a field (ny, nx, 2)."""
    mix = float(np.clip((SMOOTHEST - spread_px2) / (SMOOTHEST - SHARPEST), 0.0, 1.0))
    place = (0.5 * field_px) % 1.0 * (FRACTIONS - 1)
    first = np.minimum(place.astype(np.int64), FRACTIONS - 2)
    rest = place - first
    own, across, smooth = _tables(int(np.abs(lags).max()))
    result = np.empty((len(lags), *field_px.shape[:2]))
    for n, (v, u) in enumerate(lags):
        parts = []
        for table, way in ((own, 1), (across, 1), (across, -1), (smooth, 1)):
            along, down = (
                table[first[..., axis], middle] * (1.0 - rest[..., axis])
                + table[first[..., axis] + 1, middle] * rest[..., axis]
                for axis, middle in ((0, way * u + table.shape[1] // 2), (1, way * v + table.shape[1] // 2))
            )
            parts.append(along * down)
        result[n] = (1 - mix) ** 2 * parts[0] + mix * (1 - mix) * (parts[1] + parts[2]) + mix**2 * parts[3]
    return result


@cache
def _tables(reach: int) -> tuple[Floats, Floats, Floats]:
    """Correlations (FRACTIONS, 2 reach + 1) of c with c, c with b and b with b, along one axis."""
    impulse = np.zeros(2 * LENGTH + 1)
    impulse[LENGTH] = 1.0
    cardinal = scipy.ndimage.spline_filter1d(impulse, DEGREE, mode="mirror")
    basis = scipy.interpolate.BSpline.basis_element(
        np.arange(DEGREE + 2.0) - 0.5 * (DEGREE + 1), extrapolate=False
    )
    at = np.arange(-LENGTH, LENGTH + 1.0)
    tables = np.empty((3, FRACTIONS, 2 * reach + 1))
    for n, fraction in enumerate(np.linspace(0.0, 1.0, FRACTIONS)):
        b = np.nan_to_num(basis(at + fraction))
        c = np.convolve(cardinal, b, mode="same")
        for table, (one, two) in zip(tables, ((c, c), (c, b), (b, b)), strict=True):
            middle = len(at) - 1
            table[n] = np.correlate(two, one, mode="full")[middle - reach : middle + reach + 1]
    return tables[0], tables[1], tables[2]
