"""Preprocessing of both frames of a pair, before they are correlated.

1. **Level.** The mean of the surroundings (the last window's side wide) is taken off, once: uneven light and a
   bright background then stand in no window, and a window needs no mean of its own. Frames are divided by the
   usual deviation within a window, the median over the frame, so that counts of any size (also 1e20) fit a
   float32 and one bright reflection does not make all others small.
   Where light of coarse structure outshines the particles, as out-of-focus images and bodies do, a median that
   follows its edges goes off too (`piv.preprocessing.coarse_light`). Before all, pixels of unequal gain are made
   equal (`piv.preprocessing.colour_mosaic`).
2. **Masked pixels** are filled from the valid ones around them (`piv.correlation.fill`), so that the spline
through
   the frame makes no step there, and weigh nothing; single dead pixels as little as their filling is unsure.
3. **Coefficients.** A frame is sampled through its quintic B-spline. Particle images below 3 px are
   undersampled: beyond what the pixels hold the spline invents, always towards the pixel centres (peak locking).
   The smoothing spline, whose coefficients are the pixels themselves, damps all that lies near the sampling limit
   by (sinc)^6: locking falls to a third, while particles of 3 px and more would only be blurred. So both are
   blended by the size of the particle images, which the correlation of a frame with itself tells: at 1 and 2 px
   its logarithm falls by 3/(4 s^2), s^2 the variance of a particle image. Below 1.5 px a little more blur pays
   with a third more noise for half of what locking is left.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.rows import map_parts
from piv.correlation.fill import FilledPixels, Texture, blur_frame, without_gaps
from piv.errors import FrameError, PairError
from piv.preprocessing.coarse_light import coarse_light, shows_particles, without_coarse_light
from piv.preprocessing.colour_mosaic import without_mosaic
from piv.resampling.sample import MIN_SIDE_PX, prefilter

NO_TEXTURE = 0.01  # of the usual deviation in a window; less is no particles, not even noise
SHARPEST, SMOOTHEST = 0.25, 0.8  # variance of a particle image [px^2]: smoothing spline below, plain spline above
TINY, TINIEST, BLUR = 0.215, 0.175, 0.8  # below TINY pixels are blurred too, by up to BLUR [px^2]
QUINTIC_PX2 = 0.5  # variance of the quintic B-spline: six boxes of a pixel
MOST_NOISE = 0.9  # of a frame's variance

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Pair:
    """Frames ready to be deformed.

    Parameters
    ----------
    a, b : ndarray of float32, shape (H, W)
        Levelled frames, masked pixels filled.
    valid : ndarray of float32, shape (H, W)
        1 where both frames show the flow, or single pixels have been filled, else 0.
    floor : float
        Mean square up to which a window counts as constant.
    spread_px2 : float
        Variance of a particle image.
    nan_pixels : int
        Pixels that the mask calls valid and that are not finite.
    filled : FilledPixels, optional
        How unsure what stands in single pixels is.
    noise : float
        Variance of a pixel's noise over that of the picture.
    given : ndarray of float32, shape (H, W), optional
        1 where a mask that was given is True, if `valid` is more (`piv.preprocessing.still_light.with_clean_rim`).
    hidden : ndarray of bool, shape (H, W), optional
        True where coarse light hides the particles, or is all there is (`piv.preprocessing.coarse_light`).
    """

    a: Floats
    b: Floats
    valid: Floats
    floor: float
    spread_px2: float
    nan_pixels: int
    filled: FilledPixels | None = None
    noise: float = 0.0
    given: Floats | None = None
    hidden: NDArray[np.bool_] | None = None

    @property
    def spread_as_sampled_px2(self) -> float:
        """Variance of a particle image in frames that are sampled through these coefficients.

        Those that are the pixels themselves widen it by the variance of the quintic B-spline.
        """
        share, blur = self._smoothing()
        return self.spread_px2 + QUINTIC_PX2 * share + blur

    def _smoothing(self) -> tuple[float, float]:
        """Share of the smoothing spline, and more blur [px^2], see 3. above."""
        share = min(max((SMOOTHEST - self.spread_px2) / (SMOOTHEST - SHARPEST), 0.0), 1.0)
        return share, BLUR * min(1.0, max(0.0, (TINY - self.spread_px2) / (TINY - TINIEST)))

    def coefficients(self, threads: int | None = None) -> tuple[Floats, Floats]:
        """Coefficients (H, W) of both frames, see 3. above."""
        import cv2

        smoothing, blur = self._smoothing()
        share = np.float32(smoothing)
        if share == 1.0:
            pair = self.a, self.b
            return (blur_frame(self.a, blur**0.5), blur_frame(self.b, blur**0.5)) if blur > 0.02 else pair
        spline = prefilter(self.a, threads=threads), prefilter(self.b, threads=threads)
        if share > 0.0:
            for coefficients, frame in zip(spline, (self.a, self.b), strict=True):
                cv2.addWeighted(coefficients, float(1.0 - share), frame, float(share), 0.0, dst=coefficients)
        return spline

    def half_resolution(self) -> "Pair":
        """The same at half the resolution, for a search of whole pixels."""
        import cv2

        size = self.a.shape[1] // 2 * 2, self.a.shape[0] // 2 * 2
        a, b, valid = (
            np.asarray(
                cv2.resize(part[: size[1], : size[0]], (size[0] // 2, size[1] // 2), interpolation=cv2.INTER_AREA),
                np.float32,
            )
            for part in (self.a, self.b, self.valid)
        )
        return Pair(a, b, valid, self.floor, self.spread_px2 / 4.0, self.nan_pixels)


def prepare_pair(
    frame_a: NDArray[Any], frame_b: NDArray[Any], valid: NDArray[np.bool_] | None, window_px: int
) -> Pair:
    """Check both frames and their mask, and make them ready.

    Parameters
    ----------
    frame_a, frame_b : ndarray, shape (H, W)
        Real numbers of any kind; NaN, infinite and masked elements (`numpy.ma`) do not count.
    valid : ndarray of bool, shape (H, W), optional
        True where the frames show the flow.
    window_px : int
        Side of the last windows.

    Raises
    ------
    FrameError
        A frame that is none.
    PairError
        Two frames that are no pair, or a mask that is none of theirs.
    """
    frames, mask, seen = check_frames(frame_a, frame_b, valid)
    whole = bool(seen.all())
    weight = seen.astype(np.float32)
    side_px = window_px | 1
    named = zip(frames, "AB", strict=True)
    a, b = map_parts(lambda each: _remove_level(each[0], weight, whole, side_px, each[1]), named)
    coarse, hidden = coarse_light(a, b, window_px), None
    if coarse is not None:
        coarse = coarse * weight
        coarse_share = coarse
        (a, dim_a), (b, dim_b) = map_parts(
            lambda each: without_coarse_light(each, coarse_share, window_px), (a, b)
        )
        shown = shows_particles(a, b, coarse, window_px) & ((dim_a & dim_b) | (coarse == 0.0))
        hidden = ~shown & seen
        weight *= shown
        whole = bool(weight.all())
        a, b = a * weight, b * weight
    texture, filled = texture_of(a, weight, whole), None
    if not whole:
        filled = without_gaps(a, b, seen, texture)
        if filled is not None:
            weight[filled.variance > 0.0] = 1.0
    nan_pixels = int(np.count_nonzero(mask & ~seen))
    return Pair(a, b, weight, NO_TEXTURE**2, texture.spread_px2, nan_pixels, filled, texture.noise, hidden=hidden)


def check_frames(
    frame_a: NDArray[Any], frame_b: NDArray[Any], valid: NDArray[np.bool_] | None
) -> tuple[tuple[NDArray[Any], ...], NDArray[np.bool_], NDArray[np.bool_]]:
    """Two frames of plain numbers, where their mask is True, and where both count; raises as `prepare_pair`."""
    frames, usable = zip(*(_numbers(frame) for frame in (frame_a, frame_b)), strict=True)
    shape = frames[0].shape
    if shape != frames[1].shape:
        raise PairError(f"frame A is {shape} and frame B {frames[1].shape} (rows, columns); pair equal sizes")
    mask = np.ones(shape, bool) if valid is None else np.asarray(valid)
    if mask.dtype != np.bool_ or mask.shape != shape:
        raise PairError(f"the mask is {mask.dtype} {mask.shape}; pass bool {shape}, True where valid")
    seen = mask & usable[0] & usable[1]
    if not seen.any():
        raise PairError("no pixel is valid in both frames; check the mask (True = valid) and the frames for NaN")
    return without_mosaic(frames, seen), mask, seen


def _numbers(frame: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return a frame of plain numbers and where they count; FrameError if it is none."""
    values = np.ma.getdata(frame)
    if values.ndim != 2 or values.dtype.kind not in "uif":
        raise FrameError(f"a frame is a 2-D array of real numbers, this one is {values.dtype} {values.shape}")
    if min(values.shape) < MIN_SIDE_PX:
        raise FrameError(f"a frame needs at least {MIN_SIDE_PX} px a side, got {values.shape}")
    usable = ~np.ma.getmaskarray(frame) if np.ma.isMaskedArray(frame) else np.ones(values.shape, bool)
    if values.dtype.kind == "f":
        usable = usable & np.isfinite(values)
    return values, usable


def _remove_level(frame: NDArray[Any], weight: Floats, whole: bool, side_px: int, name: str) -> Floats:
    """Frame without the mean of its surroundings, of unit deviation, 0 where it is masked; see the top."""
    inside = frame if whole else frame[weight > 0]
    low, high = inside.min(), inside.max()
    if low == high:
        raise PairError(f"frame {name} is constant ({low}) over its valid pixels; it shows no particles")
    middle = inside.mean(dtype=np.float64)
    values: Floats
    if frame.dtype.kind == "f" or frame.dtype.itemsize > 2:  # brought near 1 first: float32 has seven digits
        with np.errstate(over="ignore", invalid="ignore"):
            values = ((frame - middle) / (float(high) - float(low))).astype(np.float32)
    else:
        values = frame.astype(np.float32) - np.float32(middle)
    if not whole:
        values = np.where(weight > 0, values, np.float32(0.0))
    mean = _mean_around(values, side_px)
    if not whole:
        mean /= np.maximum(_mean_around(weight, side_px), np.float32(1e-6))
    values = values - mean
    if not whole:
        values *= weight
    return np.ascontiguousarray(values * np.float32(1.0 / _usual_deviation(values, side_px)))


def _usual_deviation(values: Floats, side_px: int) -> float:
    """Median over the frame of the root mean square within a window."""
    rows, columns = (max(side // side_px, 1) for side in values.shape)
    part = values[: rows * side_px, : columns * side_px]
    tall, wide = part.shape[0] // rows, part.shape[1] // columns
    blocks = part[: rows * tall, : columns * wide].reshape(rows, tall, columns, wide)
    square = np.einsum("ijkl,ijkl->ik", blocks, blocks) / (tall * wide)
    seen = square[square > 1e-6 * square.max()]  # not what is dark or masked
    return float(np.sqrt(np.median(seen))) if seen.size else 1.0


def _mean_around(values: Floats, side_px: int) -> Floats:
    import cv2

    mean: Any = cv2.blur(values, (side_px, side_px), borderType=cv2.BORDER_REFLECT)
    return np.asarray(mean, np.float32)


def texture_of(frame: Floats, weight: Floats, whole: bool) -> Texture:
    """Measure the texture of a frame from its correlation with itself at 0, 1 and 2 px along rows."""
    every = slice(None, None, max(1, frame.shape[0] // 256))
    rows, seen = frame[every], weight[every]

    def match_at(lag: int) -> float:
        end = rows.shape[1] - lag
        mean = float(np.mean(rows[:, lag:] * rows[:, :end], dtype=np.float64))
        return mean if whole else mean / max(float(np.mean(seen[:, lag:] * seen[:, :end])), 1e-6)

    one, two = match_at(1), match_at(2)
    if one <= 0.0:
        return Texture(SHARPEST, MOST_NOISE / (1.0 - MOST_NOISE))  # hardly more than single pixels
    fall = max(float(np.log(one / max(two, 1e-3 * one))), 1e-3)
    noise = float(np.clip(1.0 - one * np.exp(fall / 3.0) / match_at(0), 0.0, MOST_NOISE))
    return Texture(0.75 / fall, noise / (1.0 - noise))
