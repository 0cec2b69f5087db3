"""Light that stands still beside a flow: a wall that shines, a reflection, a scratch of the glass.

Windows in it have the clearest vectors of all, of no displacement. So where it lies is found from frames as they
are, and belongs to no window. Of cells of a few pixels, in frames a and b without the mean of their surroundings,

    E = (<a a'> + <b b'>)/2,      r = <a b'>/sqrt(<a a'> <b b'>),

where ' is the neighbouring pixel, whose noise is another: E is the square of the light that is structured, r the
share of it that both frames show at the same pixels, however bright each pulse was. With E_0 usual where light
moves (r < `MOVES`), a cell stands still where

* it is far brighter than a flow, r E > `BRIGHT` E_0: particles in a fluid at rest are not;
* nothing moves before it, (1 - r) E < `MOST_MOVING` E_0: dust before a flow, or a wall behind it, has that flow's
  particles in its rest, whether or not they find their partners.

Walls are large: cells count that make up squares of `SQUARE` x `SQUARE`, and with them what belongs to them.
Where next to nothing moves, nothing is said, for it may be a flow at rest.

The frames may be those of one pair, or A of one and B of another, which no slow flow makes alike: then r and E are
means over all that are compared. A series finds its still light so, from frames whose background is not taken
off: what is left of a wall then flickers as the pulses do, and stands still no more.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

CELL_PX = 4
LEVEL_PX = 11  # side of the surroundings: larger than a particle image, so that a wall's edge does not reach far
BLUR_CELLS = 1.0  # one cell holds too few particles
MOVES, LEAST_MOVING = 0.5, 0.1  # r below which light moves; share of the cells that must, for a usual brightness
SEEN = 0.05  # of the median of E: cells with less show nothing
BRIGHT, MOST_MOVING, ALIKE = 4.0, 0.25, 0.9  # of E_0, of E_0, of r
SQUARE, GAP = 4, 7  # cells along each axis that must stand still together; that may lack a grain between them

Floats = NDArray[np.float32]
Two = tuple[NDArray[Any], NDArray[Any]]


def across_pairs(pairs: Iterable[Two]) -> Iterator[Two]:
    """Frame A of each pair (A, B) with frame B of the next; of a single pair its own."""
    first: Two | None = None
    before: NDArray[Any] | None = None
    for pair in pairs:
        if before is not None:
            first = None
            yield before, pair[1]
        else:
            first = pair
        before = pair[0]
    if first is not None:
        yield first


def still_light(frames: Iterable[Two], valid: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Find the light that stands still.

    Parameters
    ----------
    frames : iterable of (ndarray, ndarray), shape (H, W) each
        Real numbers of frames to compare, as they are.
    valid : ndarray of bool, shape (H, W)
        True where they show the flow and are finite.

    Returns
    -------
    ndarray of bool, shape (H, W), or None
        True where light stands still; None where nothing does, or that cannot be told.
    """
    if not valid.any():
        return None
    sums: list[Floats] = []
    count = 0
    for a, b in frames:
        (one, of_a), (other, of_b) = (_levelled(frame, valid) for frame in (a, b))
        of_one, of_other = (np.maximum(_products(part, part), 0.0) for part in (one, other))
        both = np.float32(0.5) * (_products(one, other) + _products(other, one))
        power = np.sqrt(of_one * of_other)
        share = np.clip(np.divide(both, power, out=np.zeros_like(both), where=power > 0.0), -1.0, 1.0)
        # Both pulses weigh the same, whatever their light.
        scales = [np.float32(1.0 / max(float(part.mean()), 1e-30)) for part in (of_one, of_other)]
        mean = np.float32(0.5) * (scales[0] * of_one + scales[1] * of_other)
        bright = np.sqrt(scales[0]) * of_a + np.sqrt(scales[1]) * of_b
        now = [np.asarray(part, np.float32) for part in (share, mean, bright)]
        sums = [total + part for total, part in zip(sums, now, strict=True)] if sums else now
        count += 1
    if not sums or not sums[1].any():
        return None
    alike, square, level = sums
    found = _still(alike / np.float32(count), square / np.float32(count), level)
    if not found.any():
        return None
    # The cells at its edge hold some of the flow, and too much of it for any window.
    found = scipy.ndimage.binary_dilation(found, np.ones((3, 3), bool))
    row, column = (
        np.minimum(np.arange(side) // CELL_PX, cells - 1)
        for side, cells in zip(valid.shape, found.shape, strict=True)
    )
    return np.asarray(found[np.ix_(row, column)])


def _still(alike: Floats, square: Floats, level: Floats) -> NDArray[np.bool_]:
    """Cells (ny, nx) that stand still, from r, E and how bright they are."""
    seen = square > SEEN * np.median(square[square > 0.0])
    moves = seen & (alike < MOVES)
    if moves.sum() <= LEAST_MOVING * seen.sum():
        return np.zeros(square.shape, bool)
    usual = float(np.median(square[moves]))
    bright, rest = alike * square > BRIGHT * usual, (1.0 - alike) * square < MOST_MOVING * usual
    still = scipy.ndimage.binary_opening(bright & rest & (alike > ALIKE), np.ones((SQUARE, SQUARE), bool))
    if not still.any():
        return np.asarray(still)
    # A wall has places without a grain, and an edge where its cells see particles beside it. They belong to it
    # between what stands still, if nothing moves there, and beside it where it is as bright.
    around = scipy.ndimage.binary_dilation(still, np.ones((GAP, GAP), bool))
    between = scipy.ndimage.binary_erosion(around, np.ones((GAP, GAP), bool), border_value=1)
    dark, light = float(np.median(level[moves])), float(np.median(level[still]))
    beside = around & (level > 0.5 * (dark + light)) & (alike > ALIKE) & (light > dark)
    return np.asarray(still | (between & rest) | beside)


def _levelled(frame: NDArray[Any], valid: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Every second row of a frame without the mean of its surroundings, 0 where masked; and the mean in cells."""
    import cv2

    whole = bool(valid.all())
    values = frame
    if frame.dtype.kind == "f" or frame.dtype.itemsize > 2:  # counts of any size fit a float32 only near 1
        inside = frame if whole else frame[valid]
        low, high = float(inside.min()), float(inside.max())
        with np.errstate(over="ignore", invalid="ignore"):
            values = (frame - low) / max(high - low, np.finfo(float).tiny)
    values = values.astype(np.float32)
    if not whole:
        values = np.where(valid, values, np.float32(0.0))
    size = (LEVEL_PX, LEVEL_PX)
    mean: Any = cv2.blur(values, size, borderType=cv2.BORDER_REFLECT)
    if not whole:
        mean /= np.maximum(cv2.blur(valid.astype(np.float32), size, borderType=cv2.BORDER_REFLECT), 1e-6)
    rest = values[::2] - mean[::2]
    if not whole:
        rest *= valid[::2]
    return np.asarray(rest, np.float32), _cells(np.asarray(mean[::2], np.float32))


def _products(one: Floats, other: Floats) -> Floats:
    """Means over cells of products of neighbouring pixels."""
    whole = np.zeros(one.shape, np.float32)
    np.multiply(one[:, :-1], other[:, 1:], out=whole[:, :-1])
    return _cells(whole)


def _cells(values: Floats) -> Floats:
    """Means over whole cells and those around them, of every second row of a frame."""
    import cv2

    deep = CELL_PX // 2
    height, width = max(values.shape[0] // deep, 1), max(values.shape[1] // CELL_PX, 1)
    part = values[: height * deep, : width * CELL_PX]
    mean = cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(mean, (0, 0), BLUR_CELLS), np.float32)
