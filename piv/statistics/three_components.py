"""Three components of a velocity from several views of one place.

View i, whose ray meets the plane with the slopes a_i = dX/dz and b_i = dY/dz, measures

    u_i = u - a_i w,        v_i = v - b_i w        (`piv.statistics.out_of_plane`),

two equations a view for three unknowns.  Weighted least squares, p_i = 1/var(u_i) and q_i = 1/var(v_i), has a
closed form.  With the weighted means ~u, ~a (by p) and ~v, ~b (by q),

    S = sum p_i (a_i - ~a)^2 + sum q_i (b_i - ~b)^2
    w = -[sum p_i (a_i - ~a) u_i + sum q_i (b_i - ~b) v_i] / S
    u = ~u + ~a w,        v = ~v + ~b w

    var w = 1/S,        var u = 1/sum p_i + ~a^2/S,        var v = 1/sum q_i + ~b^2/S,
    cov(u, w) = ~a/S,        cov(v, w) = ~b/S,        cov(u, v) = ~a ~b/S.

**Where w is not determined** (one view, or slopes that hardly differ: 1/sqrt(S) above a limit) it is not reported,
and an assumed size sigma_w takes its place: 1/(S + 1/sigma_w^2) is written for 1/S in w and its variance.  With
one view that leaves u = u_1, var u = var u_1 + a_1^2 sigma_w^2: its vector with its perspective error.
Where w is reported no assumption enters, so it is not drawn towards zero, and means and stresses of it are not.

**Model test.**  n views leave 2 n - 3 residuals where w is determined.  Their sum of squares in sigmas, chi^2, is
2 n - 3 on average; a camera that stands elsewhere than calibrated, or another flow, makes it larger.

The result is linear in the data, so that `gains` carry any other part of their variance through.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MAX_SIGMA_W_PX = 0.3  # of a pair or a mean whose w is reported
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ThreeComponents:
    """Velocity of each place from its views, in the unit of the data.

    Parameters
    ----------
    gains : ndarray of float64, shape (n, ny, nx, 3, 2)
        Share of u_i and v_i of each view in u, v and w; 0 of a view that has no vector.
    uvw : ndarray of float64, shape (ny, nx, 3)
        u, v, w; NaN where there is no view, and w where it is not determined.
    covariance : ndarray of float64, shape (ny, nx, 3, 3)
        Of u, v and w by the variances given, with that of an assumed w where it is not determined.
    views : ndarray of uint8, shape (ny, nx)
        Number of views.
    chi2 : ndarray of float64, shape (ny, nx)
        Sum of squared residuals in sigmas; NaN where w is not determined.
    freedom : ndarray of int64, shape (ny, nx)
        Degrees of freedom 2 n - 3 of `chi2`; 0 where w is not determined.
    """

    gains: Floats
    uvw: Floats
    covariance: Floats
    views: NDArray[np.uint8]
    chi2: Floats
    freedom: NDArray[np.int64]

    @property
    def has_w(self) -> NDArray[np.bool_]:
        """Places (ny, nx) where w is determined."""
        return self.freedom > 0

    @property
    def residual_in_sigma(self) -> float:
        """Square root of chi^2 over its degrees of freedom of all places together; NaN where none has any."""
        freedom = int(self.freedom.sum())
        return float(np.sqrt(np.nansum(self.chi2) / freedom)) if freedom else float("nan")

    def propagate(self, variance: Floats) -> Floats:
        """Return the variances (ny, nx, 3) of u, v, w by parts (n, ny, nx, 2) of those of independent views."""
        there = np.where(np.any(self.gains != 0.0, axis=(-2, -1))[..., None], variance, 0.0)
        found = np.einsum("nyxkc,nyxc->yxk", np.square(self.gains), there)
        return np.where(np.isnan(self.uvw), np.nan, found)


def combine_views(
    uv: Floats, variance: Floats, slope: Floats, sigma_w: Floats, limit: float | Floats
) -> ThreeComponents:
    """Combine n views of one field into its three components.

    Parameters
    ----------
    uv : ndarray of float64, shape (n, ny, nx, 2)
        Vectors of each view; NaN where it has none.
    variance : ndarray of float64, shape (n, ny, nx, 2)
        Variances, independent between views; a view without a positive one counts as none.
    slope : ndarray of float64, shape (n, ny, nx, 2)
        dX/dz and dY/dz of the rays; a view without slopes counts as none.
    sigma_w : ndarray of float64, shape (ny, nx)
        Assumed size of w where it is not determined; NaN counts as 0.
    limit : float or ndarray of float64, shape (ny, nx)
        Standard uncertainty of w up to which it is reported.

    Returns
    -------
    ThreeComponents
        In the unit of `uv`.
    """
    known = np.isfinite(uv) & np.isfinite(variance) & (variance > 0.0) & np.isfinite(slope)
    usable: NDArray[np.bool_] = np.asarray(known.all(axis=-1))
    seen = usable[..., None]
    views = usable.sum(axis=0)
    data, slopes = np.where(seen, uv, 0.0), np.where(seen, slope, 0.0)
    weight = np.where(seen, 1.0 / np.where(seen, variance, 1.0), 0.0)
    total = weight.sum(axis=0)
    share = weight / np.where(total > 0.0, total, 1.0)
    middle = (share * slopes).sum(axis=0)
    lever = weight * (slopes - middle)  # centred: nothing cancels where slopes are alike
    information = (lever * (slopes - middle)).sum(axis=(0, -1))
    has_w = (views > 1) & (information > 0.0) & (information >= np.asarray(limit) ** -2.0)

    assumed = np.square(np.nan_to_num(sigma_w))
    # 1/(S + 1/sigma^2) = sigma^2/(1 + S sigma^2), which is 0 where nothing is assumed
    spread = np.where(has_w, 1.0 / np.where(has_w, information, 1.0), assumed / (1.0 + information * assumed))
    of_w = -lever * spread[..., None]
    identity = np.eye(2)
    in_plane = share[..., :, None] * identity + middle[..., :, None] * of_w[..., None, :]
    gains = np.concatenate((in_plane, of_w[..., None, :]), axis=-2)
    found = np.einsum("nyxkc,nyxc->yxk", gains, data)

    column = np.concatenate((middle, np.ones((*middle.shape[:-1], 1))), axis=-1)
    covariance = column[..., :, None] * column[..., None, :] * spread[..., None, None]
    with np.errstate(divide="ignore"):
        for axis in (0, 1):
            covariance[..., axis, axis] += np.where(total[..., axis] > 0.0, 1.0 / total[..., axis], np.nan)

    residual = data - (found[..., :2] - slopes * found[..., 2:])
    chi2 = np.where(has_w, (weight * np.square(residual)).sum(axis=(0, -1)), np.nan)
    is_found = np.stack((views > 0, views > 0, has_w), axis=-1)
    return ThreeComponents(
        gains,
        np.where(is_found, found, np.nan),
        covariance,
        views.astype(np.uint8),
        chi2,
        np.where(has_w, 2 * views - 3, 0),
    )
