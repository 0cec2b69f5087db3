"""Particle image velocimetry of one pair: multi-pass correlation with symmetric window deformation.

Each pass deforms frame A by minus and frame B by plus half of what the passes before have found, correlates
windows of the deformed frames, and adds the displacement that is left:

    measured(x) = predictor(x) + peak of  sum_x' A(x' - d(x')/2) B(x' + d(x')/2 + s)  over s.

* Frames are deformed with the float-exact quintic B-spline that also corrects them: peak locking of 3 px
  particles stays below 0.004 px, against 0.012 px with a cubic spline and 0.05 px with bilinear weights.
* The predictor is smoothed over one grid step.  Without it every further pass amplifies noise that no
  uncertainty estimate can see.
* A pixel counts where it is valid in both deformed frames.  Means are taken over these pixels and the others
  are 0; vectors need `min_valid` of them.  Rejected vectors never reach the predictor.

Scarano, Meas. Sci. Technol. 13, R1 (2002); Astarita, Cardone, Exp. Fluids 38, 233 (2005).
Sign and axis conventions: see `correction.evaluate.vector_field`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.errors import PairError
from correction.evaluate.correlate import Measured, correlate_windows, peak_ratios
from correction.evaluate.deform import DeformedPair, deform_pair
from correction.evaluate.evidence import proven, unproven
from correction.evaluate.outliers import filled, outliers, smoothed
from correction.evaluate.uncertainty import correlation_statistics, pass_gain
from correction.evaluate.vector_field import VectorField, VectorFlag
from correction.evaluate.windows import WindowGrid, interpolated, window_grid
from correction.resample.sample import checked_frame, prefilter

NO_TEXTURE = 1e-3  # of the frame's standard deviation; less in a window is rounding


@dataclass(frozen=True)
class PivSettings:
    """How to evaluate a pair.

    Parameters
    ----------
    windows_px : tuple of int
        Side of the square windows of each pass; the first one must hold about three times the largest
        displacement.
    overlap : float
        Shared part of neighbouring windows, in every pass.
    min_valid : float
        Smallest share of pixels in a window, valid in both deformed frames, that makes a vector.  The two
        masks move apart by the displacement, so near a mask edge this is less than the mask alone says.
    smoothing_steps : float
        Standard deviation of the predictor's Gaussian smoothing, in grid steps.
    outlier_threshold, outlier_epsilon_px : float
        Universal outlier detection: largest normalised residual, and usual noise.
    uncertainty : bool
        Estimate the random uncertainty of each vector.
    """

    windows_px: tuple[int, ...] = (64, 32, 32, 32)
    overlap: float = 0.5
    min_valid: float = 0.3
    smoothing_steps: float = 1.0
    outlier_threshold: float = 2.0
    outlier_epsilon_px: float = 0.1
    uncertainty: bool = True

    def __post_init__(self) -> None:
        if not self.windows_px or min(self.windows_px) < 8:
            raise PairError(f"windows_px needs at least one window of at least 8 px, got {self.windows_px}")
        if not 0.0 <= self.overlap < 1.0:
            raise PairError(f"overlap lies in 0 <= overlap < 1, got {self.overlap}")
        if not 0.0 < self.min_valid <= 1.0:
            raise PairError(f"min_valid lies in 0 < min_valid <= 1, got {self.min_valid}")


@dataclass(frozen=True)
class _Pair:
    """Frames ready to be deformed: float32 with masked pixels filled, one mask, the mean square of no texture."""

    a: NDArray[np.float32]
    b: NDArray[np.float32]
    valid: NDArray[np.uint8]
    floor: float
    nan_pixels: int


def evaluate_pair(
    frame_a: NDArray[Any],
    frame_b: NDArray[Any],
    valid: NDArray[np.bool_] | None = None,
    settings: PivSettings | None = None,
    threads: int | None = None,
) -> VectorField:
    """Measure the displacement from frame A to frame B.

    Parameters
    ----------
    frame_a, frame_b : ndarray, shape (H, W)
        uint8, uint16 or float32 intensities.  NaN pixels are treated as masked and counted.
    valid : ndarray of bool, shape (H, W), optional
        True where the frames show the flow; default everywhere.
    settings : PivSettings, optional
        How to evaluate.
    threads : int, optional
        Threads to use; default all cores of the process.

    Returns
    -------
    VectorField
        Displacements on the grid of the last pass.

    Raises
    ------
    PairError
        Different sizes, a mask of another size or kind, nothing valid, or a frame without texture.
    FrameError
        A frame that is none.
    """
    settings = settings or PivSettings()
    pair = _prepared(frame_a, frame_b, valid)
    shape = (pair.a.shape[0], pair.a.shape[1])
    grids = [window_grid(shape, size, settings.overlap) for size in settings.windows_px]
    coefficients = None
    deformed = DeformedPair(pair.a, pair.b, pair.valid, pair.floor)
    predictor = np.zeros((*grids[0].shape, 2))
    for number, grid in enumerate(grids):
        if number:
            coefficients = coefficients or (prefilter(pair.a, threads=threads), prefilter(pair.b, threads=threads))
            deformed = deform_pair(coefficients, pair.valid, predictor, grids[number - 1], pair.floor, threads)
            predictor = _moved(predictor, grids[number - 1], grid)
        last = number == len(grids) - 1
        measured = correlate_windows(deformed, grid, settings.min_valid, last, threads)
        vectors = predictor + measured.shift_px
        good = _accepted(vectors, measured, deformed, grid, settings, threads)
        if not last:
            predictor = smoothed(vectors, good, settings.smoothing_steps)
    sigma = np.full(vectors.shape, np.nan)
    if settings.uncertainty:
        repeats = sum(1 for earlier in grids if earlier.size_px == grid.size_px)
        gain = pass_gain(grid.size_px, grid.step_px, settings.smoothing_steps, repeats)
        sigma = correlation_statistics(deformed, grid, settings.min_valid, gain, threads)
        good = _judged(good & ~unproven(measured.peak_ratio, sigma), measured, settings)
    return _field(vectors, good, measured, sigma, grid, pair.nan_pixels)


def _prepared(frame_a: NDArray[Any], frame_b: NDArray[Any], valid: NDArray[np.bool_] | None) -> _Pair:
    """Check both frames and their mask; fill what is masked with the mean of what is not."""
    frames = [checked_frame(frame) for frame in (frame_a, frame_b)]
    if frames[0].shape != frames[1].shape:
        raise PairError(
            f"frame A is {frames[0].shape} and frame B {frames[1].shape} (rows, columns); pair equal sizes"
        )
    if valid is None:
        valid = np.ones(frames[0].shape, bool)
    valid = np.asarray(valid)
    if valid.dtype != np.bool_ or valid.shape != frames[0].shape:
        raise PairError(f"the mask is {valid.dtype} {valid.shape}; pass bool {frames[0].shape}, True where valid")
    finite = np.ones(valid.shape, bool)
    for frame in frames:
        if frame.dtype == np.float32:
            finite &= np.isfinite(frame)
    usable = valid & finite
    if not usable.any():
        raise PairError("no pixel is valid in both frames; check the mask (True = valid) and the frames for NaN")
    whole = bool(usable.all())
    values, variance = [], []
    for name, frame in zip("AB", frames, strict=True):
        inside = frame if whole else frame[usable]
        if inside.min() == inside.max():
            raise PairError(
                f"frame {name} is constant ({inside.flat[0]}) over its valid pixels; it shows no particles"
            )
        plain = frame.astype(np.float32)
        variance.append(float(inside.ravel()[::13].var(dtype=np.float64)))  # a sample will do for a floor
        values.append(plain if whole else np.where(usable, plain, np.float32(inside.mean(dtype=np.float64))))
    floor = NO_TEXTURE**2 * min(variance)
    return _Pair(values[0], values[1], usable.astype(np.uint8), floor, int(np.count_nonzero(valid & ~finite)))


def _moved(field: NDArray[np.float64], source: WindowGrid, target: WindowGrid) -> NDArray[np.float64]:
    """Field on the nodes of one grid, interpolated at the nodes of another."""
    if source is target or (np.array_equal(source.row, target.row) and source.size_px == target.size_px):
        return field
    along_u = interpolated(field, 1, source.x_px, target.x_px, source.step_px)
    return interpolated(along_u, 0, source.y_px, target.y_px, source.step_px)


def _accepted(
    vectors: NDArray[np.float64],
    measured: Measured,
    deformed: DeformedPair,
    grid: WindowGrid,
    settings: PivSettings,
    threads: int | None,
) -> NDArray[np.bool_]:
    """Vectors that were measured and fit their neighbours, or are proven by their own peak."""
    candidates: NDArray[np.bool_] = np.all(np.isfinite(vectors), axis=-1)
    suspects = outliers(vectors, candidates, settings.outlier_threshold, settings.outlier_epsilon_px)
    good = candidates & ~suspects
    if suspects.any():
        ratio = measured.peak_ratio
        if np.isnan(ratio[suspects]).all():  # not the last pass, which knows all of them
            ratio = peak_ratios(deformed, grid, suspects, settings.min_valid, threads)
        good |= proven(vectors, candidates, suspects, ratio, grid.size_px)
    return _judged(good, measured, settings)


def _judged(good: NDArray[np.bool_], measured: Measured, settings: PivSettings) -> NDArray[np.bool_]:
    """Return `good`; PairError if nothing is."""
    if not good.any():
        if measured.dense.any():
            raise PairError(
                "no window gave a vector that fits its neighbours; check exposure, seeding and pairing"
            )
        raise PairError(
            f"no window holds {settings.min_valid:.0%} valid pixels; check the mask or use smaller windows"
        )
    return good


def _field(
    vectors: NDArray[np.float64],
    good: NDArray[np.bool_],
    measured: Measured,
    sigma: NDArray[np.float64],
    grid: WindowGrid,
    nan_pixels: int,
) -> VectorField:
    """Flag every vector, interpolate the rejected ones, and put the result together."""
    fill, near = filled(vectors, good)
    flags = np.full(grid.shape, VectorFlag.REJECTED, np.uint8)
    flags[near] = VectorFlag.REPLACED
    flags[good] = VectorFlag.VALID
    flags[~measured.dense] = VectorFlag.MASKED
    nothing = (flags == VectorFlag.MASKED) | (flags == VectorFlag.REJECTED)
    fill = np.where(nothing[..., None], np.nan, fill)
    sigma = np.where((flags == VectorFlag.VALID)[..., None], sigma, np.nan)
    return VectorField(
        x_px=grid.x_px,
        y_px=grid.y_px,
        u_px=fill[..., 0],
        v_px=fill[..., 1],
        flags=flags,
        peak_ratio=measured.peak_ratio,
        correlation=measured.correlation,
        sigma_u_px=sigma[..., 0],
        sigma_v_px=sigma[..., 1],
        valid_fraction=measured.valid_fraction,
        window_px=grid.size_px,
        step_px=grid.step_px,
        nan_pixels=nan_pixels,
    )
