"""Sub-pixel centres of dots: of the ellipse whose blurred edge is most like what the frame shows.

Around a dot, with d = x - p, L symmetric and q = |L d|, which is 1 on the rim of an ellipse:

    I(x) = (A + B (1 + erf(z)) / 2) (1 + g . d0) + h . d0,      z = (1 - q) / |grad q| / (sqrt(2) s)

d0 from where the dot was looked for.  Ten numbers are free: p, L (three), the blur s, A, B, the slope g of the
light. On a plate with dark dots the slope h of what it reflects is free as well, which ink does not weaken, where
they are of RESOLVED_PX or more: smaller ones tell it from their place too poorly.  Pixels up to PAPER_MARGIN_PX
beyond the rim are asked, on staggered rows up to NEAR_WALLS_PX, or blurred edges of grooves pull the centre; none
farther than half a pitch along either axis, so that no other dot is among them.  Least squares by Levenberg and
Marquardt, all dots of a size at once.  The covariance of p is the sandwich of MacKinnon and White (HC3;
J. Econometrics 29, 305 (1985)) with the residuals of the dot itself.  On a plate half of the width that a shadow
takes from one side, or adds to it, is added.

What is found is the centre of the picture of a dot, which is not the picture of its centre: bent glass, and
perspective, shift it, and the fit takes that off from where rays of its rim land (`correction.fit.seen.dot_rims`).
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.target.corners import (
    LARGEST_RESIDUAL,
    LARGEST_SIGMA_PX,
    MIN_HALF_WINDOW_PX,
    CornerFit,
    CornerReason,
    CornerSearch,
    half_widths_px,
)
from ground.rows import run_rows
from tracer.board import Dots

REACH, REACH_ON_PLATE = 0.5, 0.4  # pitches: half side of what is asked at most; walls stand between levels
PAPER_MARGIN_PX, NEAR_WALLS_PX = 4.0, 3.0  # of paper around a dot that is asked
DOT_NUMBERS, SHINE_NUMBERS = 10, 2
RESOLVED_PX = 12.0  # diameter from which a dot tells the slope of a reflection from its place
STEPS, SETTLED_PX = 30, 1e-3  # of the optimiser, and a step that no longer matters
MIN_STEP_GAIN = 1e-3  # share of the squares that such a step may still save
SHARPEST_PX, BLUNTEST_PX = 0.2, 8.0
START_PX = 0.7  # blur
DOTS_AT_ONCE = 96
RIM_MARGIN_PX = 1.5  # beyond the rim of a dot that must be seen
SIZE = 0.6, 1.6  # area of a dot as found over that of the dot which should be there
MIN_CONTRAST = 1e-3  # of the span of the frame: saturated paper is fitted perfectly by a dot of no contrast
# Of the radius, that a dot may look narrower one way; and sigmas of its centre on top
UNROUND, SURE_CUT = 0.03, 4.0
BLURRED = 1.5  # of the variance of the blur, that the edge of a small dot may lie elsewhere


def refine_dots(
    pixels: NDArray[np.float32],
    start_px: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    share: NDArray[np.float64],
    dots: Dots,
    usable: NDArray[np.uint8],
    search: CornerSearch,
) -> CornerFit:
    """Fit dots from start positions.

    Parameters
    ----------
    pixels : (H, W) float32
        The frame, without NaN.
    start_px : (N, 2) float64
        Start positions.
    axes_px : (N, 2, 2) float64
        Columns: displacement in the image by one pitch along the board's +x and +y.
    share : (N,) float64
        Diameter of each dot in pitches.
    dots : Dots
        Whether they are bright, and whether on levels.
    usable : (H, W) or (1, 1) uint8
        0 where pixels may not be used.
    search : CornerSearch
        Of which the largest move counts.

    Returns
    -------
    CornerFit
        In the order of `start_px`; both blurs of a dot are one.
    """
    count, most = len(start_px), REACH_ON_PLATE if dots.levels else REACH
    margin_px = NEAR_WALLS_PX if dots.levels == "staggered" else PAPER_MARGIN_PX
    out, verdict = np.full((count, 11), np.nan), np.full(count, int(CornerReason.SMALL), np.uint8)
    thin = half_widths_px(axes_px, np.full(count, most))
    asked = (
        np.isfinite(start_px).all(axis=1) & np.isfinite(axes_px).all(axis=(1, 2)) & (thin >= MIN_HALF_WINDOW_PX)
    )
    reach = np.minimum(0.5 * share + margin_px / np.linalg.norm(axes_px, axis=1).min(axis=1), most)
    extent = np.ceil(reach * np.abs(axes_px).sum(axis=2).max(axis=1, initial=0.0))
    order = np.flatnonzero(asked)
    order = order[np.argsort(extent[order], kind="stable")]

    shadow = np.zeros((count, 3))

    def rows(first: int, last: int) -> None:
        for begin in range(first, last, DOTS_AT_ONCE):
            some = order[begin : min(begin + DOTS_AT_ONCE, last)]
            batch = _Batch(pixels, usable, start_px[some], axes_px[some], share[some], reach[some], dots)
            out[some], verdict[some] = batch.fit(search.max_shift)
            if dots.levels:
                shadow[some] = batch.shadow_covariance(out[some])

    run_rows(rows, len(order), block=DOTS_AT_ONCE)
    amplitude = out[:, 7]
    with np.errstate(invalid="ignore", divide="ignore"):
        residual, sigma = 2.0 * out[:, 5] / np.abs(amplitude), np.sqrt(out[:, 2:4])
        fitted = verdict == CornerReason.OK
        is_flat = ~(np.abs(amplitude) > MIN_CONTRAST * np.ptp(pixels))
        verdict[fitted & (is_flat | ~(sigma.max(axis=1) <= LARGEST_SIGMA_PX))] = CornerReason.UNSURE
        size = 4.0 * out[:, 10] / (share**2 * np.abs(np.linalg.det(axes_px)))
        rough = BLURRED * out[:, 8] ** 2 / (share**2 * np.abs(np.linalg.det(axes_px)))
        misfit = ~(residual <= LARGEST_RESIDUAL) | ~((size > SIZE[0] - rough) & (size < SIZE[1] + rough))
        verdict[fitted & misfit] = CornerReason.MISFIT
        verdict[fitted & ((amplitude > 0.0) != dots.bright)] = CornerReason.INVERTED
    if dots.levels:  # last: a dot in shadow is less certain, but no reason to refuse a frame
        out[:, 2:5] += shadow
        sigma = np.sqrt(out[:, 2:4])
    return CornerFit.of_rows(out, verdict, sigma, residual, amplitude.copy())


class _Batch:
    """Dots of about one size, n of them, each with the P pixels of its tile."""

    def __init__(
        self,
        pixels: NDArray[np.float32],
        usable: NDArray[np.uint8],
        start_px: NDArray[np.float64],
        axes_px: NDArray[np.float64],
        share: NDArray[np.float64],
        reach: NDArray[np.float64],
        dots: Dots,
    ) -> None:
        height, width = pixels.shape
        half = int(np.ceil((reach * np.abs(axes_px).sum(axis=2).max(axis=1)).max()))
        around = np.stack(np.meshgrid(*[np.arange(-half, half + 1)] * 2), axis=-1).reshape(-1, 2)
        at = np.rint(start_px).astype(np.int64)[:, None] + around
        inside = ((at >= 0) & (at < (width, height))).all(axis=-1)
        u, v = np.clip(at, 0, (width - 1, height - 1)).transpose(2, 0, 1)
        self.start, self.axes, self.share = start_px, axes_px, share
        self.light = pixels[v, u].astype(np.float64)
        self.off = at - start_px[:, None]
        place = np.einsum("nij,npj->npi", np.linalg.inv(axes_px), self.off)
        asked = (np.abs(place) <= reach[:, None, None]).all(axis=-1)
        clear = inside if usable.size == 1 else inside & (usable[v, u] > 0)
        if dots.levels == "staggered":  # without walls around the dot's own row: i + j is 1 in the next one
            asked &= np.abs(place.sum(axis=-1)) <= REACH_ON_PLATE
            asked &= np.linalg.norm(place, axis=-1) <= reach[:, None]
        self.weight = (asked & clear).astype(np.float64)
        # The symmetric L that makes a circle of the dot as the axes M show it: (r^2 M M^T)^(-1/2), r = share / 2.
        shape = axes_px @ axes_px.transpose(0, 2, 1) * (0.5 * share)[:, None, None] ** 2
        values, vectors = np.linalg.eigh(shape)
        root = vectors / np.sqrt(values)[:, None, :] @ vectors.transpose(0, 2, 1)
        self.free = np.zeros(
            (len(start_px), DOT_NUMBERS + SHINE_NUMBERS * (bool(dots.levels) and not dots.bright))
        )
        self.resolved = share * np.linalg.norm(axes_px, axis=1).min(axis=1) >= RESOLVED_PX
        self.free[:, 2], self.free[:, 3], self.free[:, 4] = root[:, 0, 0], root[:, 0, 1], root[:, 1, 1]
        self.free[:, 5] = START_PX
        self.inside, self.clear = inside, clear

    def fit(self, max_shift: float) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Return the rows (n, 11) that `refine_dots` keeps of each dot, and the outcome (n,)."""
        count = len(self.free)
        verdict = np.full(count, int(CornerReason.LOST), np.uint8)
        limit = max_shift * np.linalg.norm(self.axes, axis=1).min(axis=1)
        self._start_levels()
        going, damping = np.arange(count), np.full(count, 1e-3)
        best, normal, right = self._equations(self.free, going)[:3]
        for _ in range(STEPS):
            here, diagonal = self.free[going], np.maximum(np.einsum("nii->ni", normal[going]), 1e-12)
            damped = normal[going] + np.eye(self.free.shape[1]) * (damping[going, None] * diagonal)[:, None, :]
            step = np.linalg.solve(damped, right[going, :, None])[..., 0]
            trial = here + step
            trial[:, 5] = np.clip(trial[:, 5], np.maximum(0.5 * here[:, 5], SHARPEST_PX), BLUNTEST_PX)
            legal = np.hypot(trial[:, 0], trial[:, 1]) <= limit[going]
            legal &= trial[:, 2] * trial[:, 4] > trial[:, 3] ** 2
            trial[~legal] = here[~legal]
            now, trial_normal, trial_right = self._equations(trial, going)[:3]
            better = legal & (now <= best[going])
            moved = np.hypot(step[:, 0], step[:, 1])
            settled = (better & (moved < SETTLED_PX) & (best[going] - now <= MIN_STEP_GAIN * now)) | (moved < 1e-6)
            chosen = going[better]
            self.free[chosen], best[chosen] = trial[better], now[better]
            normal[chosen], right[chosen] = trial_normal[better], trial_right[better]
            damping[going] = np.clip(damping[going] * np.where(better, 0.1, 10.0), 1e-12, 1e10)
            verdict[going[settled]] = CornerReason.OK
            going = going[~settled]
            if not len(going):
                break
        out = np.full((count, 11), np.nan)
        total, normal, _, jacobian, residual = self._equations(self.free, np.arange(count))
        covariance, number = self._covariance(normal, jacobian, residual)
        p = self.free
        out[:, :2] = self.start + p[:, :2]
        out[:, 2], out[:, 3], out[:, 4] = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]
        out[:, 5] = np.sqrt(total / np.maximum(number - DOT_NUMBERS, 1.0))
        out[:, 6], out[:, 7], out[:, 8], out[:, 9] = p[:, 6], p[:, 7], p[:, 5], p[:, 5]
        out[:, 10] = 1.0 / np.maximum(
            p[:, 2] * p[:, 4] - p[:, 3] ** 2, 1e-12
        )  # squared radius of the circle alike
        self._must_be_seen(verdict)
        verdict[number < 2 * DOT_NUMBERS] = CornerReason.SMALL
        out[~np.isin(verdict, (CornerReason.OK,))] = np.nan
        return out, verdict

    def shadow_covariance(self, out: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return uu, vv, uv (n, 3) [px^2] of shadows over one side of a dot, zero where it is as wide as expected.

        A dot is cut where it is narrower one way than the other, against the axes of the lattice; its centre is
        then aside by half of the missing width.  Of dark dots this counts along both axes: shadows widen them, and
        walls cut them.
        """
        a, b, c = self.free[:, 2:5].T
        expected = self.axes * (0.5 * self.share)[:, None, None]
        cut = np.stack((a, b, b, c), axis=-1).reshape(-1, 2, 2) @ expected
        _, scales, ways = np.linalg.svd(cut)
        missing = 1.0 / scales[:, 1] - 1.0 / scales[:, 0]
        half = np.einsum("nij,nj->ni", expected, ways[:, 0]) * missing[:, None]
        noise = np.sqrt((out[:, 2] + out[:, 3]) / np.abs(np.linalg.det(expected)))
        half[~(missing > UNROUND + SURE_CUT * noise)] = 0.0
        covariance = np.stack((half[:, 0] ** 2, half[:, 1] ** 2, half[:, 0] * half[:, 1]), axis=-1)
        dark = self.free[:, 7] < 0.0
        covariance[dark] = (half[dark] ** 2).sum(axis=1)[:, None] * np.array((1.0, 1.0, 0.0))
        return covariance

    def _start_levels(self) -> None:
        """Least-squares A and B for the start geometry."""
        self.free[:, 6], self.free[:, 7] = 0.0, 1.0
        shade = self._model(self.free, np.arange(len(self.free)))[0]
        sums = self.weight.sum(axis=1)
        mean = np.sum(self.weight * shade, axis=1) / np.maximum(sums, 1.0)
        level = np.sum(self.weight * self.light, axis=1) / np.maximum(sums, 1.0)
        rise = self.weight * (shade - mean[:, None])
        self.free[:, 7] = np.sum(rise * self.light, axis=1) / np.maximum(np.sum(rise * shade, axis=1), 1e-9)
        self.free[:, 6] = level - self.free[:, 7] * mean

    def _model(
        self, p: NDArray[np.float64], which: NDArray[np.intp]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Intensity (n, P) and its derivatives by the free numbers (n, P, F) of some dots (n,)."""
        off = self.off[which]
        d = off - p[:, None, :2]
        x, y = d[..., 0], d[..., 1]
        a, b, c = (p[:, k, None] for k in (2, 3, 4))
        lx, ly = a * x + b * y, b * x + c * y
        q = np.sqrt(lx * lx + ly * ly) + 1e-9
        sx, sy = (a * lx + b * ly) / q, (b * lx + c * ly) / q  # grad q
        slope = np.sqrt(sx * sx + sy * sy) + 1e-12
        blur, dark, rise = p[:, 5, None], p[:, 6, None], p[:, 7, None]
        z = (1.0 - q) / slope / (np.sqrt(2.0) * blur)
        inside = 0.5 * (1.0 + scipy.special.erf(z))
        light = 1.0 + p[:, 8, None] * off[..., 0] + p[:, 9, None] * off[..., 1]
        level = dark + rise * inside
        edge = rise * light * np.exp(-np.minimum(z * z, 700.0)) / (np.sqrt(2.0 * np.pi) * blur)  # by the distance
        by = np.empty((*q.shape, p.shape[1]))
        by[..., 0], by[..., 1] = edge * sx / slope, edge * sy / slope
        by[..., 2] = -edge * lx * x / q / slope
        by[..., 3] = -edge * (lx * y + ly * x) / q / slope
        by[..., 4] = -edge * ly * y / q / slope
        by[..., 5] = -edge * z * np.sqrt(2.0)
        by[..., 6], by[..., 7] = light, inside * light
        by[..., 8], by[..., 9] = level * off[..., 0], level * off[..., 1]
        intensity = level * light
        if p.shape[1] > DOT_NUMBERS:
            by[..., DOT_NUMBERS:] = off * self.resolved[which, None, None]
            intensity += (off @ p[:, DOT_NUMBERS:, None])[..., 0]
        return intensity, by

    def _equations(
        self, p: NDArray[np.float64], which: NDArray[np.intp]
    ) -> tuple[
        NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]
    ]:
        """Sum of squares (n,), J^T J, J^T r, J and r of some dots (n,)."""
        value, by = self._model(p, which)
        weight = self.weight[which]
        by *= weight[..., None]
        left = weight * (self.light[which] - value)
        transposed = by.transpose(0, 2, 1)
        return (left**2).sum(axis=1), transposed @ by, (transposed @ left[..., None])[..., 0], by, left

    def _covariance(
        self, normal: NDArray[np.float64], jacobian: NDArray[np.float64], residual: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Covariance of the centres (n, 2, 2) [px^2] from the residuals, and how many pixels each has (n,)."""
        scale = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-12))
        scaled = normal / scale[:, :, None] / scale[:, None, :] + 1e-9 * np.eye(self.free.shape[1])
        inverse = np.linalg.inv(scaled) / scale[:, :, None] / scale[:, None, :]
        reach = jacobian @ inverse
        leverage = np.einsum("npi,npi->np", reach, jacobian)
        pull = reach[..., :2] * (residual / np.maximum(1.0 - leverage, 0.1))[..., None]
        return pull.transpose(0, 2, 1) @ pull, self.weight.sum(axis=1)

    def _must_be_seen(self, verdict: NDArray[np.uint8]) -> None:
        """Name those whose rim is not all in the frame, or in what may be used."""
        d = self.off - self.free[:, None, :2]
        a, b, c = (self.free[:, k, None] for k in (2, 3, 4))
        q = np.hypot(a * d[..., 0] + b * d[..., 1], b * d[..., 0] + c * d[..., 1])
        radius = 1.0 / np.sqrt(np.maximum(a * c - b * b, 1e-12))
        asked = q <= 1.0 + RIM_MARGIN_PX / radius
        verdict[(asked & ~self.clear).any(axis=1)] = CornerReason.MASKED
        verdict[(asked & ~self.inside).any(axis=1)] = CornerReason.EDGE
