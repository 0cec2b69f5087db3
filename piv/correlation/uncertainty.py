"""Random uncertainty of each vector, from how unevenly its window leans.

At the final displacement both frames should match; what does not match is noise, and its effect on the
correlation peak can be added up (Wieneke, Meas. Sci. Technol. 26, 074002 (2015)). Along one axis the products of
neighbours, forwards minus backwards, q(x) = a(x) b(x+1) - a(x+1) b(x), sum to C+ - C-, on which the peak's place
depends. With the weights W of the window the variance of that sum is

    var = sum_x W(x)^2 G,      G = sum of all covariances of q at one place.

1. q is summed over blocks of about a particle's size. The square of a block's sum over its area is an estimate
   of G that lacks the covariances across its borders, by a share of 1/side: with sides h and 2 h, G = (2
   sqrt(E_2h) - sqrt(E_h))^2, taken over windows of about the same noise, where it is known well (lost particles
   lean over more than a block, the noise of pixels over less). Its place in the frame comes from the blocks.
2. What is left to find, r, makes q lean too: by r (m'(x) m(x+1) - m(x) m'(x+1)), m the mean of both frames. This
   is no noise and is taken off first, block by block. Since r was measured in the same windows, noise goes with
   it: of that of a block the share h that the block has in the r at its place, the leverage of a fitted value.
   With p, what a displacement makes of a block, that is h = f b p/sum W p, b the blocks that lean together and f
   what is left of it by interpolation between windows (`OWN_SHARE`). So each block counts l/(1 - h) (MacKinnon,
   White, J. Econometrics 29, 305 (1985)): where one bright particle makes the vector, nothing contradicts it.
3. With C = (C+ + C-)/2 and s = sqrt(var) the 3-point Gaussian fit moves by sigma = [ln(C + s/2) - ln(C - s/2)] /
   [4 ln C0 - 2 ln(C + s/2) - 2 ln(C - s/2)]. Where the peak is flat, C near C0, that has no limit, but the peak
   was looked for within a pixel: sigma is never more than that of any place within it, 1/sqrt(3) px.

That is the noise of one correlation; what passes and the last filter make of it says
`piv.correlation.response`. Particle images of a few pixels leave an error that no noise betrays and no
filter takes off: where they lie between the pixels moves the peak. It depends on their size alone (`SAMPLING`,
measured without noise) and is added as it is. What windows do not resolve is separate
(`piv.correlation.resolution`); calibration is not seen.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_parts, run_rows
from piv.correlation.deform import DeformedPair
from piv.correlation.kernels.statistics import KINDS, block_sums
from piv.correlation.refine import Refined
from piv.correlation.windows import WindowGrid, interpolation_matrix

Floats = NDArray[np.float64]
GROUPS, FEWEST = 8, 50  # of windows with about the same noise, and how many are one
TOGETHER = 4.0  # blocks that lean together: those of a particle image
OWN_SHARE = (0.25, 0.5, 1.0), (1.0, 0.4, 0.2)  # spacing of windows in sides; share of r that is their own
LARGEST_LEVERAGE = 0.4  # noise that is said to be larger hides, beside walls, what small windows miss
LARGEST_PX = 3.0**-0.5  # one pixel to either side, all places alike
SAMPLING = (  # variance of a particle image [px^2] as frames show it, and the error that it leaves [px]
    (0.127, 0.158, 0.209, 0.262, 0.315, 0.46, 0.64, 1.06, 2.2, 3.8, 7.6),
    (0.0095, 0.0055, 0.0038, 0.0029, 0.0025, 0.0023, 0.0019, 0.0011, 0.0005, 0.0005, 0.001),
)


class Blocks(NamedTuple):
    """Sums over blocks of pixels of a pair, for u and v.

    `lean` and `by_shift` (2, rows, columns) float32: how a block leans, and what a displacement of 1 px makes of
    it; `centres` positions of rows and of columns [px], `side_px` of a block.
    """

    lean: NDArray[np.float32]
    by_shift: NDArray[np.float32]
    centres: tuple[Floats, Floats]
    side_px: int


class CorrelationAsymmetry(NamedTuple):
    """Asymmetry of the correlation of windows, all (ny, nx, 2) for u and v.

    `variance` is that of the asymmetry summed over a window; `light` and `squares` are sums of what a displacement
    makes of each block, with the window's weights, and of its square, with their squares.
    """

    variance: Floats
    light: Floats
    squares: Floats


class Statistics(NamedTuple):
    """Sigma (ny, nx, 2) of u and v [px], NaN without a clear peak; independent pieces (ny, nx) of a window."""

    sigma_px: Floats
    pieces: Floats


def sampling_error_px(spread_px2: float) -> float:
    """Standard deviation of what the pixels make of particle images whose variance is `spread_px2`."""
    sizes, errors = SAMPLING
    return float(np.exp(np.interp(spread_px2, sizes, np.log(errors))))


def blocks_of(pair: DeformedPair, spread_px2: float, threads: int | None = None) -> Blocks:
    """Asymmetry of the correlation of blocks of about a particle's size.

    Parameters
    ----------
    pair : DeformedPair
        Frames deformed by (nearly) the final field, and how far their pixels are valid.
    spread_px2 : float
        Variance of a particle image.
    threads : int, optional
        Threads to use.
    """
    height, width = pair.a.shape
    image_px = float(np.sqrt(spread_px2))
    side = max(int(np.clip(round(2.0 * image_px), 2, 3)), min(round(1.7 * image_px), 6))
    sums = np.empty((KINDS, height // side, width // side), np.float32)

    def rows(first: int, last: int) -> None:
        block_sums(pair.a, pair.b, side, first, last, np.empty((KINDS, width), np.float32), sums)

    run_rows(rows, sums.shape[1], threads=threads)
    down, along = ((np.arange(count) + 0.5) * side - 0.5 for count in sums.shape[1:])
    return Blocks(sums[:2], sums[2:], (down, along), side)


def correlation_asymmetry(
    blocks: Blocks,
    grid: WindowGrid,
    window_sigma: float,
    left_px: Floats,
    found_by: Callable[[Floats], tuple[Floats, Floats]] | None = None,
) -> CorrelationAsymmetry:
    """Sum the asymmetry over windows, without that of the displacement that is left.

    Parameters
    ----------
    blocks : Blocks
        Of the deformed frames.
    grid : WindowGrid
        Windows.
    window_sigma : float
        Their weights, see `piv.correlation.refine.window_weights`.
    left_px : ndarray of float64, shape (ny, nx, 2)
        Displacement that was left to find, finite everywhere.
    found_by : callable, optional
        From sums (ny, nx) over the windows of `grid` those over the windows that found it, and the sides of these;
        default the same windows.
    """
    nodes = (grid.y_px, grid.x_px)
    along = [
        _square_weights(place, node, grid.size_px, window_sigma)
        for place, node in zip(blocks.centres, nodes, strict=True)
    ]
    sides = [np.sqrt(weights) for weights in along]
    between = [
        interpolation_matrix(node, place, grid.step_px) for place, node in zip(blocks.centres, nodes, strict=True)
    ]
    found = CorrelationAsymmetry(*(np.empty(left_px.shape) for _ in range(3)))

    def sum_component(axis: int) -> None:
        lean, by_shift = blocks.lean[axis], blocks.by_shift[axis]
        left = between[0] @ (left_px[..., axis].astype(np.float32) @ between[1].T)
        left *= by_shift
        power = float(np.vdot(left, left))
        share = np.float32(np.clip(float(np.vdot(lean, left)) / power, 0.0, 1.5) if power > 0.0 else 0.0)
        light = by_shift + np.roll(by_shift, -1, 0)
        light = np.maximum(light + np.roll(light, -1, 1), 0.0)
        found.light[..., axis] = sides[0] @ light @ sides[1].T
        found.squares[..., axis] = along[0] @ np.square(light) @ along[1].T
        rest = 1.0 - _leverage(by_shift, found.light[..., axis], blocks, grid, found_by)
        left *= -share
        left += lean
        left /= rest
        found.variance[..., axis] = _window_variance(left, along)

    run_parts(sum_component, range(2))
    return found


def correlation_statistics(lean: CorrelationAsymmetry, refined: Refined) -> Statistics:
    """Standard uncertainty of u and v for every window, of one correlation.

    Parameters
    ----------
    lean : CorrelationAsymmetry
        Asymmetry of the correlation of the windows.
    refined : Refined
        What was measured with them.
    """
    pieces = np.maximum(lean.light**2 / np.maximum(4.0 * lean.squares, 1e-30), 1.0)
    sums = refined.sums
    c = np.stack([sums[..., 1 + 2 * axis : 3 + 2 * axis].mean(axis=-1) for axis in range(2)], axis=-1)
    sigma = _peak_sigma(sums[..., :1], c, np.sqrt(lean.variance)) / refined.gain[..., None]
    return Statistics(np.minimum(sigma, LARGEST_PX), pieces.mean(axis=-1))


def _leverage(
    by_shift: NDArray[np.float32],
    light: Floats,
    blocks: Blocks,
    grid: WindowGrid,
    found_by: Callable[[Floats], tuple[Floats, Floats]] | None,
) -> NDArray[np.float32]:
    """Share (rows, columns) that blocks have in what was left to find at their place, see 2. above."""
    import cv2

    whole, side = (light, np.full(light.shape, float(grid.size_px))) if found_by is None else found_by(light)
    share = 4.0 * TOGETHER * np.interp(grid.step_px / side, *OWN_SHARE)  # light is over 2 x 2 blocks
    share /= np.maximum(whole, 1e-6 * float(whole.max()) + 1e-30)
    scale = blocks.side_px / grid.step_px
    first = [
        (place[0] - node[0]) / grid.step_px
        for place, node in zip(blocks.centres, (grid.y_px, grid.x_px), strict=True)
    ]
    found: Any = cv2.warpAffine(
        share.astype(np.float32),
        np.array([[scale, 0.0, first[1]], [0.0, scale, first[0]]]),
        by_shift.shape[::-1],
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    found *= by_shift
    return np.asarray(np.clip(found, 0.0, LARGEST_LEVERAGE, out=found), np.float32)


def _square_weights(place_px: Floats, node_px: Floats, size_px: int, window_sigma: float) -> NDArray[np.float32]:
    """Squares of the weights (nodes, places) that windows around nodes give to places along one axis."""
    off = place_px[None] - node_px[:, None]
    weights = np.exp(-2.0 * (off / (window_sigma * size_px)) ** 2) if window_sigma else np.ones_like(off)
    return np.where(np.abs(off) <= size_px / 2, weights, 0.0).astype(np.float32)


def _window_variance(noise: NDArray[np.float32], along: list[NDArray[np.float32]]) -> Floats:
    """Variance (ny, nx) of the sum over a window, from blocks and from blocks of twice their side; see 1. above.

    How much larger the whole is than its blocks is found for windows of about the same noise together.
    """
    rows, columns = noise.shape[0] // 2 * 2, noise.shape[1] // 2 * 2
    even = noise[:rows, :columns]
    pairs = even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]
    half = [
        (weights[:, :count:2] + weights[:, 1:count:2]) * np.float32(0.5)
        for weights, count in zip(along, (rows, columns), strict=True)
    ]
    small: Floats = np.asarray(along[0] @ np.square(noise) @ along[1].T, float)
    large: Floats = np.asarray(half[0] @ np.square(pairs) @ half[1].T, float)
    order = np.argsort(small, axis=None)
    groups = np.array_split(order, max(1, min(GROUPS, small.size // FEWEST)))
    at = np.array([float(np.log(np.maximum(small.flat[group].mean(), 1e-30))) for group in groups])
    over = [large.flat[group].sum() / max(small.flat[group].sum(), 1e-30) for group in groups]
    ratio = (2.0 * np.sqrt(over) - 1.0) ** 2
    return small * np.interp(np.log(np.maximum(small, 1e-30)), at, ratio)


def _peak_sigma(c0: Floats, c: Floats, deviation: Floats) -> Floats:
    """Standard deviation of the 3-point Gaussian peak whose sides differ at random; see 3. above."""
    with np.errstate(invalid="ignore", divide="ignore"):
        high, low = np.log(c + 0.5 * deviation), np.log(c - 0.5 * deviation)
        bottom = 4.0 * np.log(c0) - 2.0 * high - 2.0 * low
        return np.where((c0 > 0.0) & (bottom > 0.0), (high - low) / bottom, np.nan)
