"""Is the model right?  A test of what is left, way by way, with a stated rate of false alarms.

A right model leaves in every corner its own noise, of which a SMOOTH_SHARE at most may be common to neighbours:
what the corner fit and the print do.  A wrong one (a ball out of round, a bent board, a lens term that is missing)
leaves a field that bends smoothly across a view.  So the residuals r, in sigmas, of every way through the glass
are split, frame by frame, by low polynomials of the pixel (columns of Q, orthonormal):

    S = |Q^T r|^2 of k dimensions, the smooth part;        R = |r|^2 - S of m dimensions, the rest,

and F = (S/k) / (R/m) is asked whether corners with no more than that SMOOTH_SHARE of smooth error would reach it:
Fisher's lack-of-fit test with the non-central F distribution, lambda = 2 N SMOOTH_SHARE for N corners, and the
squares of what is known to be smooth (`Remainder.known_smooth_px`).  A residual's size does not matter: what the
corners can do is the measure.  The chance of one alarm among all ways of a right lab is at most
MODEL_FALSE_ALARMS. Corners beyond RESIDUAL_CLIP sigmas count as RESIDUAL_CLIP: a few wrong ones must not hide the
rest, nor a wrong model itself among outliers.

S - k R/m is an unbiased estimate of the squares of the smooth error: its root per corner and axis is `smooth_px`,
an error of the map of its own, because corners stand in the plane of the map.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

MODEL_FALSE_ALARMS = 0.01  # chance that a right lab raises any alarm
# Of a corner's squares that may be smooth though the model is right; rendered frames show 0.00-0.04
SMOOTH_SHARE = 0.1
RESIDUAL_CLIP = 5.0  # sigmas
SmoothPart = tuple[NDArray[np.float64], NDArray[np.int64]]
DEGREES = ((6, 112), (4, 60), (3, 40), (2, 24), (1, 12))  # of the polynomials, from so many corners of a view


@dataclass(frozen=True)
class Remainder:
    """Residuals of the corners of one frame, N of them.

    Parameters
    ----------
    branch_name : (N,) str
        Way through the glass; empty for the direct view.
    pixel, residual_px : (N, 2) float64
        Where measured, and measured minus fitted.
    sigma_px : (N, 2) float64
        As used by the fit.
    magnified : (N, 2, 2) float64
        Corrected px a raw px: d plane point / d pixel over the pitch.
    known_smooth_px : (N,) float64
        Standard deviation of what is smooth and known of, and counted in sigma_px already.
    """

    branch_name: NDArray[np.str_]
    pixel: NDArray[np.float64]
    residual_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    magnified: NDArray[np.float64]
    known_smooth_px: NDArray[np.float64]

    @property
    def robust_residuals(self) -> NDArray[np.float64]:
        """Residuals (N, 2) in sigmas, cut to RESIDUAL_CLIP."""
        value = self.residual_px / self.sigma_px
        length = np.maximum(np.linalg.norm(value, axis=1, keepdims=True), 1e-300)
        return np.asarray(np.where(np.isfinite(value), value * np.minimum(1.0, RESIDUAL_CLIP / length), 0.0))


@dataclass(frozen=True)
class WayTest:
    """The test of one way through the glass, all frames.

    Parameters
    ----------
    way : str
        Spheres crossed; empty for the direct view.
    corners : int
        Measured on it.
    smooth_px, rough_px : float
        Root mean square of the smooth part and of the rest of the residuals, raw px per axis.
    largest_px : float
        Largest value of the smooth part at a corner, raw px.
    map_px : float
        What the smooth part is worth in the corrected frame: root mean square of its length, corrected px.
    excess : float
        S - k R/m: squares, in sigmas, that noise does not explain.
    rough_square : float
        R/m.
    chance : float
        Chance that a right model leaves as much.
    chance_of_noise : float
        The same for corners without any smooth error of their own.
    alarm : bool
        Whether the model is taken to be wrong here.
    """

    way: str
    corners: int
    smooth_px: float
    rough_px: float
    largest_px: float
    map_px: float
    excess: float
    rough_square: float
    chance: float
    chance_of_noise: float
    alarm: bool


def smooth_basis(pixel: NDArray[np.float64]) -> NDArray[np.float64]:
    """Low polynomials (N, K) of pixels (N, 2); K = 0 where corners are too few to tell smooth from rough."""
    degree = next((degree for degree, least in DEGREES if len(pixel) >= least), -1)
    if degree < 0:
        return np.zeros((len(pixel), 0))
    off = pixel - pixel.mean(axis=0)
    x, y = (off / max(float(np.abs(off).max()), 1.0)).T
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)


def smooth_part(rest: Remainder) -> SmoothPart:
    """Smooth part of the residuals (N, 2) [px], and the dimensions that it took on the way of each corner (N,)."""
    smooth, taken = np.zeros_like(rest.residual_px), np.zeros(len(rest.pixel), np.int64)
    value = rest.robust_residuals
    for way in np.unique(rest.branch_name):
        here = rest.branch_name == way
        basis = smooth_basis(rest.pixel[here])
        for axis in range(2):
            sigma = rest.sigma_px[here, axis]
            q, _ = np.linalg.qr(basis / sigma[:, None])
            smooth[here, axis] = sigma * (q @ (q.T @ value[here, axis]))
        taken[here] = 2 * basis.shape[1]
    return smooth, taken


def ways_tested(frames: Sequence[Remainder], parts: Sequence[SmoothPart] | None = None) -> list[WayTest]:
    """Test every way of all frames that shows enough corners, the direct view first; parts by `smooth_part`."""
    parts = [smooth_part(rest) for rest in frames] if parts is None else parts
    ways = sorted({str(way) for rest in frames for way in np.unique(rest.branch_name)}, key=lambda w: (len(w), w))
    tests = []
    for way in ways:
        energy = rough = known = 0.0
        k = m = count = 0
        squares, weights, left, on_map, largest = 0.0, 0.0, 0.0, 0.0, 0.0
        for rest, (smooth, taken) in zip(frames, parts, strict=True):
            here = (rest.branch_name == way) & (taken > 0)
            if not here.any():
                continue
            size = int(np.count_nonzero(here))
            own = float(np.sum((smooth[here] / rest.sigma_px[here]) ** 2))
            energy += own
            rough += float(np.sum(rest.robust_residuals[here] ** 2)) - own
            known += float(np.sum((rest.known_smooth_px[here, None] / rest.sigma_px[here]) ** 2)) / 2.0
            k, m, count = k + int(taken[here][0]), m + 2 * size - int(taken[here][0]), count + size
            squares += float(np.sum(smooth[here] ** 2))
            weights += float(np.sum(rest.sigma_px[here] ** -2.0))
            left += float(np.sum((rest.robust_residuals * rest.sigma_px - smooth)[here] ** 2))
            shown = (rest.magnified[here] @ smooth[here, :, None])[:, :, 0]
            on_map += float(np.sum(shown**2))
            largest = max(largest, float(np.linalg.norm(smooth[here], axis=1).max()))
        if m < 4:
            continue
        rough_square = max(rough / m, 1e-12)
        excess = max(energy - k * rough_square, 0.0)
        ratio = energy / k / rough_square
        allowed = 2.0 * count * SMOOTH_SHARE + known / rough_square
        chance = float(np.nan_to_num(1.0 - scipy.special.ncfdtr(k, m, allowed, ratio), nan=0.0))
        shrink = np.sqrt(excess / max(energy, 1e-300))
        tests.append(
            WayTest(
                way,
                count,
                float(np.sqrt(excess / weights)),
                float(np.sqrt(left / m)),
                largest,
                float(np.sqrt(on_map / count) * shrink),
                excess,
                rough_square,
                chance,
                float(scipy.special.fdtrc(k, m, ratio)),
                False,
            )
        )
    return [replace(test, alarm=test.chance < MODEL_FALSE_ALARMS / len(tests)) for test in tests]
