"""Perspective error: out-of-plane motion seen as in-plane displacement under oblique viewing.

With the slope a = dX/dz, b = dY/dz of the ray at the plane and w the velocity through it, towards the camera, what
is measured is

    u_m = u - a w,        v_m = v - b w.

One camera cannot tell w from u and v: it stays unknown, of the size sigma_w, and is a part of sigma of its own,

    sigma of u by the slant = |a| sigma_w,        of v  |b| sigma_w.

w = W + w': a steady part, which is the same in all pairs and which no number of them makes smaller, and one that
changes from pair to pair.  The mean of many pairs errs by a W alone: what w' leaves is in the scatter of the pairs
already.  Reynolds stresses err by w' alone,

    R_uu,m = R_uu + a^2 R_ww - 2 a R_uw
    R_vv,m = R_vv + b^2 R_ww - 2 b R_vw
    R_uv,m = R_uv + a b R_ww - b R_uw - a R_vw

of which the terms in R_ww are a bias, known as well as R_ww is, and those in R_uw and R_vw are of either sign:
|R_uw| is taken as evenly spread up to CORRELATED of sqrt(R_uu R_ww), which is what shear layers have at most.

**How large w is.**  It may be given: `sigma_w_m_s` for w', and `w_over_u`, the ratio of |W| to the speed in the
plane (0: nothing flows through the sheet on average).  What is not given is assumed:

    of one field, single pair or mean    w varies around each place as much as u and v do there: half the sum of
                                         their variances over a neighbourhood, noise taken off
    of stresses                          w' is as strong as u' and v' are: R_ww = (R_uu + R_vv)/2

**Derivatives.**  Over two steps the error of du/dx is, with a+ and w+ one step ahead, a- and w- one behind,

    -(a+ w+ - a- w-)/(2 h) = -[(a+ - a-) (w+ + w-)/2 + (a+ + a-)/2 (w+ - w-)]/(2 h)

a part by the slopes, which jump at a rim, and a part by w, which changes from place to place.  A rate of
derivatives, k_ux du/dx + k_uy du/dy + k_vx dv/dx + k_vy dv/dy, has the variance

    sigma_w^2 (k_ux a_x + k_uy a_y + k_vx b_x + k_vy b_y)^2
        + sigma_wx^2 (k_ux a + k_vx b)^2 + sigma_wy^2 (k_uy a + k_vy b)^2

for w at a place, dw/dx and dw/dy are uncorrelated where turbulence is homogeneous.  w changes along x as v does
there and along y as u does: of an isotropic flow these three are alike, across the way that is gone.

A variance of which noise leaves nothing is not known to be nothing: it is known as well as so few windows tell it.
So what counts is not the difference x of what is measured and of noise but the mean of what it can be, given x,
its standard uncertainty s and that no variance is negative: x + s phi(x/s) / Phi(x/s), x where x is large.

An isotropic share is right for turbulence within some ten per cent, as long as eddies fit into the neighbourhood,
five windows across; a single field cannot tell shear of the mean from them, so near shear it is too much.  For
the steady part of a flow between walls or spheres it is a guess of the right size, and too much for a flow that
lies in its plane: then say so.  What is measured holds its share of w already, which is taken out: a^2 and b^2
below.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import scipy
from annotated_types import Interval
from numpy.typing import NDArray

from piv.errors import PairError

CORRELATED = 0.4  # of sqrt(R_uu R_ww): u'v' of shear layers, jets and walls
# Of R_ww where it is assumed: w'w' over (u'u' + v'v')/2 is 0.6 to 1 in jets, layers and channels
UNSURE = 0.5
# Standard deviation of the neighbourhood: less lacks eddies, more takes in the mean's shear
REACH_WINDOWS = 1.0
# Times its standard uncertainty that a variance may come out below 0 by chance, and far more
FAR_BELOW = -10.0
MIN_NEIGHBOUR_WEIGHT = (
    4.0  # vectors in it that say how much the field varies; where there are fewer, it is as elsewhere
)
NotNegative = Annotated[float, Interval(ge=0.0)]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class OutOfPlane:
    """Velocity w through the sheet as far as it is known; None: it is assumed.

    Parameters
    ----------
    sigma_w_m_s : float, optional
        Standard deviation of what changes from pair to pair [m/s].
    w_over_u : float, optional
        Steady part over the speed within the plane: standard uncertainty, as either sign is possible.

    Raises
    ------
    PairError
        One is negative, or no number.
    """

    sigma_w_m_s: NotNegative | None = None
    w_over_u: NotNegative | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not 0.0 <= value < np.inf:
                raise PairError(f"{name} is a size, 0 or more, not {value}")

    @property
    def sentence(self) -> str:
        """Description of the given and the assumed velocities."""
        assumed = "as much as u and v vary around each place (assumed, isotropic)"
        w = assumed if self.sigma_w_m_s is None else f"{self.sigma_w_m_s:g} m/s (given)"
        steady = assumed if self.w_over_u is None else f"{self.w_over_u:g} of the speed in the plane (given)"
        if w == steady:
            return f"w through the sheet: {assumed}"
        return f"w through the sheet, from pair to pair: {w}; steady: {steady}"

    def of_pair(self, field: "SlantedField", per_m_s: float) -> Floats:
        """Sigma of w (ny, nx) of a single pair, in the unit of its vectors.

        Parameters
        ----------
        field : SlantedField
            Its vectors.
        per_m_s : float
            1 m/s in their unit; NaN where the time between the frames is not known, and no speed is known.
        """
        given = None if self.sigma_w_m_s is None else self.sigma_w_m_s * per_m_s
        varying = field.variation() if given is None or np.isnan(given) else np.full(field.shape, given)
        return np.asarray(np.hypot(varying, 0.0 if self.w_over_u is None else self.w_over_u * field.speed))

    def of_mean(self, field: "SlantedField") -> Floats:
        """Sigma of the steady part of w (ny, nx), in the unit of the mean."""
        return field.variation() if self.w_over_u is None else self.w_over_u * field.speed

    def of_stresses(self, stresses: Floats, slope: Floats) -> "SlantedStresses":
        """Return the share of w' in measured Reynolds stresses R_uu, R_vv, R_uv (ny, nx, 3) [m2/s2]."""
        a, b = np.moveaxis(slope, -1, 0)
        normal = np.maximum(stresses[..., :2], 0.0)
        if self.sigma_w_m_s is None:
            r_ww = normal.sum(axis=-1) / (2.0 + a**2 + b**2)
            unsure = UNSURE * r_ww
        else:
            r_ww, unsure = np.full(a.shape, self.sigma_w_m_s**2), np.zeros(a.shape)
        products = np.stack((a * a, b * b, a * b), axis=-1)
        r_uw, r_vw = (CORRELATED / np.sqrt(3.0) * np.sqrt(normal[..., k] * r_ww) for k in (0, 1))
        either = np.stack((2.0 * a * r_uw, 2.0 * b * r_vw, np.hypot(b * r_uw, a * r_vw)), axis=-1)
        return SlantedStresses(products * r_ww[..., None], np.hypot(products * unsure[..., None], either))


NOTHING_TOLD = OutOfPlane()


class SlantedStresses(NamedTuple):
    """Excess of the stresses R_uu, R_vv, R_uv (ny, nx, 3), and its standard uncertainty, in their unit."""

    bias: Floats
    sigma: Floats


@dataclass(frozen=True, eq=False)
class SlantedField:
    """A field under oblique viewing.

    Parameters
    ----------
    uv : ndarray of float64, shape (ny, nx, 2)
        Vectors in any one unit; NaN where there is none.
    noise : ndarray of float64, shape (ny, nx, 2)
        Their random standard uncertainty; NaN where not known.
    slope : ndarray of float64, shape (ny, nx, 2)
        dX/dz, dY/dz of the rays; NaN where not known.
    windows : float
        Vectors in the side of a window.
    """

    uv: Floats
    noise: Floats
    slope: Floats
    windows: float

    @property
    def shape(self) -> tuple[int, int]:
        """Of the grid."""
        ny, nx, _ = self.uv.shape
        return ny, nx

    @property
    def speed(self) -> Floats:
        """Within the plane (ny, nx)."""
        return np.asarray(np.linalg.norm(self.uv, axis=-1))

    def sigma(self, sigma_w: Floats) -> Floats:
        """Standard uncertainty (ny, nx, 2) of u and v by w; NaN where there is no vector or no slope."""
        there = np.isfinite(self.uv).all(axis=-1, keepdims=True)
        return np.where(there, np.abs(self.slope) * sigma_w[..., None], np.nan)

    def through_sheet(self, sigma_w: Floats) -> "ThroughSheet":
        """Return the uncertainty by w of this size (ny, nx), and that of derivatives of the field."""
        varied = self.variation()
        with np.errstate(invalid="ignore", divide="ignore"):
            per_change = np.where(varied > 0.0, sigma_w / varied, 0.0)
        return ThroughSheet(self.slope, sigma_w, self.gradient_scale() * per_change[..., None])

    def variation(self) -> Floats:
        """Isotropic share (ny, nx) of what the field varies by around each place; NaN where nothing tells."""
        return self._share(self.uv, np.square(self.noise), self.slope)

    def gradient_scale(self) -> Floats:
        """The same of what w changes by over two vectors, along x and along y (ny, nx, 2)."""
        alike = np.exp(-4.0 / self.windows**2)  # noise of windows that share a part, see `piv.statistics.derived`
        parts = []
        for across, axis in ((1, 1), (0, 0)):
            (behind, ahead), (less, more) = (neighbours(part[..., across], axis) for part in (self.uv, self.noise))
            noise = less**2 + more**2 - 2.0 * alike * less * more
            there, slope = np.isfinite(ahead - behind), self.slope[..., across, None]
            change = np.where(there, ahead - behind, np.nan)[..., None]
            parts.append(self._share(change, noise[..., None], slope))
        return np.stack(parts, axis=-1)

    def _share(self, values: Floats, noise: Floats, slope: Floats) -> Floats:
        """Share of w in the variance of C values (ny, nx, C) around each place, of which `noise` is none."""
        good: NDArray[np.bool_] = np.asarray(np.isfinite(values).all(axis=-1), np.bool_)
        count = self._around(good.astype(np.float64))
        columns = values.shape[-1]

        def mean(values: Floats) -> Floats:
            shown = np.where(good[..., None], np.nan_to_num(values), 0.0)
            sums = [self._around(shown[..., k]) for k in range(columns)]
            with np.errstate(invalid="ignore", divide="ignore"):
                return np.asarray(np.stack(sums, axis=-1) / count[..., None])

        middle = mean(values)
        measured = (mean(np.square(values)) - np.square(middle)).sum(axis=-1)
        varied = measured - mean(noise).sum(axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):  # of so many windows that do not overlap
            unsure = measured / np.sqrt(2.0 * columns * np.pi * REACH_WINDOWS**2 * count)
        share = _not_negative(varied, unsure) / (columns + mean(np.square(slope)).sum(axis=-1))
        enough = good & (count * 2.0 * np.pi * (REACH_WINDOWS * self.windows) ** 2 >= MIN_NEIGHBOUR_WEIGHT)
        usual = float(np.sqrt(np.median(share[enough]))) if enough.any() else np.nan
        return np.where(enough, np.sqrt(share), usual)

    def _around(self, values: Floats) -> Floats:
        """Share of values (ny, nx) in the neighbourhood of each place."""
        reach = REACH_WINDOWS * self.windows
        return np.asarray(scipy.ndimage.gaussian_filter(values, reach, mode="constant"), np.float64)


@dataclass(frozen=True, eq=False)
class ThroughSheet:
    """Unknown part of w behind a field, rows in its order.

    Parameters
    ----------
    slope : ndarray of float64, shape (ny, nx, 2)
        dX/dz, dY/dz of the rays.
    sigma_w : ndarray of float64, shape (ny, nx)
        Standard uncertainty of w, in the unit of the field.
    change_w : ndarray of float64, shape (ny, nx, 2)
        That of its change over two vectors, along x and along y.
    """

    slope: Floats
    sigma_w: Floats
    change_w: Floats

    @property
    def upside_down(self) -> "ThroughSheet":
        """The same with the rows in the other order."""
        return ThroughSheet(self.slope[::-1], self.sigma_w[::-1], self.change_w[::-1])

    def times(self, unit: float) -> "ThroughSheet":
        """The same in another unit of velocity."""
        return ThroughSheet(self.slope, self.sigma_w * unit, self.change_w * unit)

    def variance(self, rate: "Rate", span: tuple[float, float], more: Floats | float = 0.0) -> Floats:
        """Variance (ny, nx) by w of a sum of derivatives, see the top of this file; 0 where slopes are not known.

        Parameters
        ----------
        rate : Rate
            How much of each derivative counts, numbers or (ny, nx).
        span : (float, float)
            Length of two steps along x and along y.
        more : (ny, nx) float64
            What else w counts with, by itself.
        """
        steady: Floats | float = more
        changing = np.zeros(self.sigma_w.shape)
        for axis, parts in ((1, (rate.ux, rate.vx)), (0, (rate.uy, rate.vy))):
            between: Floats | float = 0.0
            for component, part in enumerate(parts):
                behind, ahead = neighbours(self.slope[..., component], axis)
                steady = steady + part * (ahead - behind) / span[1 - axis]
                between = between + part * 0.5 * (ahead + behind)
            changing = changing + (between * self.change_w[..., 1 - axis] / span[1 - axis]) ** 2
        return np.nan_to_num((steady * self.sigma_w) ** 2 + changing)


class Rate(NamedTuple):
    """Weights of du/dx, du/dy, dv/dx and dv/dy in a rate: numbers, or arrays (ny, nx)."""

    ux: Floats | float
    uy: Floats | float
    vx: Floats | float
    vy: Floats | float


def neighbours(values: Floats, axis: int) -> tuple[Floats, Floats]:
    """Values (ny, nx) one step behind each place and one ahead along an axis of the arrays; NaN at its ends."""
    behind, ahead = np.full_like(values, np.nan), np.full_like(values, np.nan)
    middle: list[slice] = [slice(None), slice(None)]
    before, after = list(middle), list(middle)
    middle[axis], before[axis], after[axis] = slice(1, -1), slice(None, -2), slice(2, None)
    behind[tuple(middle)], ahead[tuple(middle)] = values[tuple(before)], values[tuple(after)]
    return behind, ahead


def _not_negative(variance: Floats, unsure: Floats) -> Floats:
    """Mean of what a variance can be that was found to be `variance` (perhaps below 0), give or take `unsure`."""
    with np.errstate(invalid="ignore", divide="ignore"):
        z = variance / unsure
        near = np.maximum(z, FAR_BELOW)
        ratio = np.exp(-0.5 * near * near - 0.5 * np.log(2.0 * np.pi) - scipy.special.log_ndtr(near))
        shown = np.where(z > FAR_BELOW, variance + unsure * ratio, -unsure / z)  # its limit, where terms cancel
    return np.where(unsure > 0.0, shown, np.maximum(variance, 0.0))
