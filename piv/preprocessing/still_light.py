"""Light that stands still beside a flow: bodies, walls, reflections, writing, and areas without light.

Windows in it have the clearest vectors of all, of no displacement. So where it lies is found from frames as they
are, and belongs to no window. Of cells of a few pixels, in frames a and b without the mean of their surroundings,

    E = (<a a'> + <b b'>)/2,      r = <a b'>/sqrt(<a a'> <b b'>),

where ' is the neighbouring pixel, whose noise is another: E is the square of the light that is structured, r the
share of it that both frames show at the same pixels, however bright each pulse was. E_0 is usual where light
moves (r < `MOVES`). A cell also has a floor: the level that an opening over `FLOOR_PX` leaves, between
particles and without them. A cell stands still where nearly nothing moves before it, (1 - r) E < `MOST_MOVING` E_0
(dust before a flow, or a wall behind it, has that flow's particles in its rest, whether or not they find their
partners), and

* it is far brighter than a flow, r E > `BRIGHT` E_0: particles in a fluid at rest are not (a line of
  r E > `GLARING` E_0, and of E around it, whatever moves before it, for no window sees that); or
* its floor is another than that of the cells where light moves, above it (a body, plain or saturated) or below it
  (an area without light), and hardly anything in it moves. A fluid at rest has the floor of its surroundings.

Cells count that make up squares of `SQUARE` x `SQUARE`, and with them what belongs to them. Where next to nothing
moves, nothing is said, for it may be a flow at rest.

**Writing and bars** are thinner: lines of cells (`LINE`) that stand still and are far brighter than a flow, and
what `piv.preprocessing.writing` finds by single pixels.

The frames may be those of one pair, or A of one and B of another, which no slow flow makes alike: then r and E are
means over all that are compared. A series finds its still light so, from frames whose background is not taken
off: what is left of a wall then flickers as the pulses do, and stands still no more.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.rows import map_parts
from piv.preprocessing.writing import BrightPixels, find_overlays, find_plateaus, find_ruled_lines

STILL_CELL_PX = 4
STILL_LEVEL_PX = 11  # side of the surroundings: larger than particle images, so that edges do not reach far
BLUR_CELLS = 1.0  # one cell holds too few particles
MOVES, LEAST_MOVING = 0.5, 0.1  # r below which light moves; share of the cells that must, for a usual brightness
SEEN = 0.05  # of the median of E: cells with less show nothing
BRIGHT, MOST_MOVING, ALIKE = 4.0, 0.25, 0.9  # of E_0, of E_0, of r
GLARING, GLARING_ALIKE = 10.0, 0.95  # of E_0, of r: with particles before it, which it outshines in any window
LINES = 15  # cells: higher than a line of writing
SLOWEST = 0.97  # r of a fluid beyond which nothing tells it from one at rest
FLOOR_PX = 12  # side of the opening: larger than particle images, smaller than bodies
RAISED, SUNK = 0.25, 0.1  # change of the floor in sqrt(E_0), beyond nearly all floors where light moves
EXTREME, BEYOND = 0.1, 0.5  # share of those that are more extreme; and of their range
HARDLY = 0.02  # of E_0: structure of a plain cell
SHAKEN = 0.5  # r of a plain cell before a raised floor, if the camera shakes
RIM_PX, IMAGE_PX = 32, 3  # beside a mask: how far windows reach, and particle images
CLEAN, CLEAN_SHARE, SAME = 0.25, 0.02, 0.1  # of the deviation of a flow; share that is brighter; of the mean
LEAK_PX = 6  # off a mask: light of what it hides
LEAKS, LEAK_SIDE_PX = 0.5, 5  # of the height of a body: its edge; side of the least that leaks
DARK, DARKER = 0.05, 1.6  # quantile of a flow's gaps; depth of a dark body, of that of these gaps and their noise
HALF = 0.5  # of cells, of a frame's structure, between a body and its surroundings
QUICK, SPREADS = 0.3, 9.0  # r of a usual cell below which flow is quick; of floors, in median deviations
GRAIN = 0.08  # of how much a floor is raised: change from frame to frame that is still that of a body
LINE = 2, 8  # cells of a line of writing
SQUARE, GAP = 4, 7  # cells along each axis that must stand still together; that may lack a grain between them

Floats = NDArray[np.float32]
Two = tuple[NDArray[Any], NDArray[Any]]


class Cells(NamedTuple):
    """Figures (ny, nx) of cells: r, E, level, floor, and E of the frame that is plainer."""

    alike: Floats
    square: Floats
    level: Floats
    floor: Floats
    least: Floats


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
        True where light stands still; None where nothing does, or that is not known.
    """
    if not valid.any():
        return None
    sums: list[Floats] = []
    bright_pixels: BrightPixels | None = None
    darkest = np.full(valid.shape, np.inf, np.float32)
    count, counts = 0, 0.0
    weight = None if valid.all() else np.maximum(_means_around(valid.astype(np.float32)), np.float32(1e-6))
    for a, b in frames:
        numbers = _numbers((a, b), valid)
        (one, of_a), (other, of_b) = map_parts(lambda frame: _remove_level(frame, valid, weight), numbers)
        ordered = (one, one), (other, other), (one, other), (other, one)
        exact = all(frame.dtype in (np.uint8, np.uint16) for frame in (a, b))
        tasks: list[Callable[[], Any]] = [
            partial(BrightPixels.of_pair, *((a, b) if exact else numbers)),
            *(partial(_products, *parts) for parts in ordered),
            partial(_floor, numbers[0], numbers[1], of_a.shape),
        ]
        shown, of_one, of_other, there, back, floor = map_parts(lambda task: task(), tasks)
        of_one, of_other = (np.maximum(part, 0.0) for part in (of_one, of_other))
        both = np.float32(0.5) * (there + back)
        if not (of_one.any() and of_other.any()):
            continue
        power = np.sqrt(of_one * of_other)
        share = np.clip(np.divide(both, power, out=np.zeros_like(both), where=power > 0.0), -1.0, 1.0)
        # Both pulses weigh the same, whatever their light.
        scales = [np.float32(1.0 / max(float(part.mean()), 1e-30)) for part in (of_one, of_other)]
        mean = np.float32(0.5) * (scales[0] * of_one + scales[1] * of_other)
        bright = np.sqrt(scales[0]) * of_a + np.sqrt(scales[1]) * of_b
        least = np.minimum(scales[0] * of_one, scales[1] * of_other)
        now = [np.asarray(part, np.float32) for part in (share, mean, bright, floor, least)]
        sums = [total + part for total, part in zip(sums, now, strict=True)] if sums else now
        counts += float(scales[0] * scales[1]) ** -0.25
        bright_pixels = shown if bright_pixels is None else bright_pixels.join(shown)
        for frame in numbers:
            np.minimum(darkest, frame, out=darkest)
        count += 1
    if bright_pixels is None or not sums[1].any():
        return None
    cells = Cells(*(total / np.float32(count) for total in sums))
    cells = cells._replace(floor=cells.floor * np.float32(count / counts))
    valid_cells = _share_of_cells(valid, cells.alike.shape) > HALF
    seen = np.asarray(valid_cells & (cells.square > SEEN * np.median(cells.square[cells.square > 0.0])))
    if not seen.any():
        return None
    moves = np.asarray(seen & (cells.alike < MOVES))
    # Single cells between sparse particles at rest hold nothing but noise, which is not alike either.
    areas = _dilate(_erode(moves, (SQUARE, SQUARE)), (SQUARE, SQUARE))
    if areas.sum() > LEAST_MOVING * seen.sum():
        moves = areas
    else:
        moves &= cells.square > HALF * np.median(cells.square[seen])
    rests = bool(moves.sum() <= LEAST_MOVING * seen.sum())
    if rests:
        # A fluid at rest looks like a wall, but has other light than places without any structure, and a slow one
        # moves more light than writing that is far brighter.
        usual, share = (float(np.median(part[seen])) for part in (cells.square, cells.alike))
        glares = (share < SLOWEST) & (cells.square > GLARING * np.maximum(usual, _around_lines(cells.square)))
        glares &= (1.0 - cells.alike) * cells.square < (1.0 - share) * usual
        moves = seen & ~glares
        cells = cells._replace(alike=np.where(glares, cells.alike, np.float32(0.0)))
    apart, changed = _floors(cells, moves)
    fluid = cells.alike[seen & ~changed]
    quick = bool(not rests and fluid.size and np.median(fluid) < QUICK)
    found = _still(cells, moves, apart, changed, quick)
    if not valid_cells.all():  # what a mask covers nearly is covered
        found = _dilate(_erode(found & valid_cells, (2, 2)), (2, 2))
    # The cells at its edge hold some of the flow, and too much of it for any window.
    found = _dilate(found, (3, 3))
    rows, columns = (
        np.minimum(np.arange(side) // STILL_CELL_PX, count - 1)
        for side, count in zip(valid.shape, found.shape, strict=True)
    )
    still = found[:, columns][rows]
    parts: list[Callable[[], NDArray[np.bool_]]] = [
        partial(find_ruled_lines, darkest, valid),
        partial(find_overlays, bright_pixels, valid),
    ]
    if quick or still.any():  # in a slow flow clumps stand still as well, but no letters are found beside them
        ground = float(np.median(cells.floor[moves])) * counts / count
        seen_at = valid, valid if quick else valid & still
        parts.append(partial(find_plateaus, bright_pixels, seen_at, ground, moves[:, columns][rows]))
    for part in map_parts(lambda find: find(), parts):
        still |= part
    return still if still.any() else None


def with_clean_rim(frames: Two, valid: NDArray[np.bool_], usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask (H, W) and up to `RIM_PX` beyond it, where frames show nothing but images of particles at its edge.

    A mask cuts these images, and windows beside it then match where they are cut. They reach `IMAGE_PX`; farther
    inside such a rim is as dark as the flow is between its particles. `usable` says where frames are numbers.
    """
    import cv2

    def grown(which: NDArray[np.bool_], reach_px: int) -> NDArray[np.bool_]:
        size = np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)
        return np.asarray(cv2.dilate(which.view(np.uint8), size) > 0)

    rim = grown(valid, RIM_PX) & ~valid & usable
    inner = rim & ~grown(valid, IMAGE_PX)
    if not inner.any():
        return valid
    one, other = _numbers(frames, valid | rim)
    darker = np.minimum(one, other)
    deviation, ground = float(np.maximum(one, other)[valid].std()), float(np.median(darker[valid]))
    bright = inner & ((darker > ground + CLEAN * deviation) | (np.abs(one - other) > 2.0 * deviation))
    # Where there is no such place inside, as in a thin body, nothing is known.
    around = (2 * RIM_PX + 1, 2 * RIM_PX + 1)
    spoilt, known, level = (
        cv2.blur(np.asarray(part, np.float32), around, borderType=cv2.BORDER_CONSTANT)
        for part in (bright, inner, np.where(inner, darker - np.float32(ground), np.float32(0.0)))
    )
    clean = (spoilt <= CLEAN_SHARE * known) & (np.abs(level) <= SAME * deviation * known)
    return np.asarray(valid | (rim & (known > 0.0) & clean))


def light_beside(frames: Two, valid: NDArray[np.bool_], usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (H, W) up to `LEAK_PX` off a mask that show, in either frame, the light of the body it hides.

    So it is where the body moves, the camera shakes, or the mask is too small. A body may be brighter than the
    flow, or darker than the gaps between its particles. `usable` says where frames are numbers.
    """
    import cv2

    size = np.ones((2 * LEAK_PX + 1, 2 * LEAK_PX + 1), np.uint8)
    within = ~valid & usable
    near = valid & usable & (cv2.dilate(within.view(np.uint8), size) > 0)
    found = np.zeros(valid.shape, bool)
    if not near.any():
        return found
    around = (4 * LEAK_PX + 1, 4 * LEAK_PX + 1)
    square = LEAK_SIDE_PX, LEAK_SIDE_PX
    body = np.maximum(cv2.blur(within.astype(np.float32), around), 1e-3)
    for frame in _numbers(frames, usable):
        some = frame[::3, ::3][valid[::3, ::3]]
        ground, deviation = (np.float32(part) for part in (np.median(some), some.std()))
        low = np.float32(np.quantile(some, DARK)) - ground
        above = frame - ground
        inside = np.where(within, above, np.float32(0.0))
        height = cv2.blur(inside, around) / body
        lit = (height > deviation) & (above > LEAKS * height)
        dark = (height < DARKER * low) & (above < HALF * (low + height))
        # Particles, and gaps between them, are smaller.
        found |= _dilate(_erode(lit | dark, square), square)
    return _dilate(found & near, (3, 3)) & near


def _floors(cells: Cells, moves: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the height (ny, nx) of floors above the usual one where light moves; and where it is large."""
    low, ground, high = (float(part) for part in np.quantile(cells.floor[moves], (EXTREME, 0.5, 1.0 - EXTREME)))
    apart = cells.floor - np.float32(ground)
    unit = float(np.sqrt(np.median(cells.square[moves])))
    above, below = high - ground, ground - low
    below = min(below, SPREADS * float(np.median(np.abs(apart[moves]))))  # cells at dark edges move, too
    other = (apart > above + max(RAISED * unit, BEYOND * above)) | (
        -apart > below + max(SUNK * unit, BEYOND * below)
    )
    return apart, np.asarray(other)


def _erode(cells: NDArray[np.bool_], size: tuple[int, int], beyond: int = 0) -> NDArray[np.bool_]:
    """Cells (ny, nx) whose rectangle all stands; `beyond` is what stands outside."""
    import cv2

    ones, middle = np.ones(size, np.uint8), (size[1] // 2, size[0] // 2)
    part = np.ascontiguousarray(cells).view(np.uint8)
    found = cv2.erode(part, ones, anchor=middle, borderType=cv2.BORDER_CONSTANT, borderValue=beyond)
    return np.asarray(found > 0)


def _dilate(cells: NDArray[np.bool_], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Cells (ny, nx) that a rectangle reaches around one that stands; it is that of `_erode`, mirrored."""
    return ~_erode(~cells[::-1, ::-1], size, beyond=1)[::-1, ::-1]


def _around_lines(square: Floats) -> Floats:
    """E of cells (ny, nx) without lines and letters narrower than `LINES` cells; a bright sheet of light stays.

    Infinite in frames that are not twice as large, where a bright spot of a flow is as narrow as writing.
    """
    import cv2

    if min(square.shape) < 2 * LINES:
        return np.full_like(square, np.inf)
    return np.asarray(cv2.morphologyEx(square, cv2.MORPH_OPEN, np.ones((LINES, LINES), np.uint8)))


def _still(
    cells: Cells, moves: NDArray[np.bool_], apart: Floats, other: NDArray[np.bool_], quick: bool
) -> NDArray[np.bool_]:
    """Cells (ny, nx) that stand still; in a `quick` flow its own cells are not alike in both frames."""
    import cv2

    alike, square, level, _, least = cells
    usual = float(np.median(square[moves]))
    moving = (1.0 - alike) * square
    bright, rest = alike * square > BRIGHT * usual, moving < MOST_MOVING * usual
    plain = square < HARDLY * usual
    if quick:
        plain |= (alike > ALIKE) | ((alike > SHAKEN) & (apart > 0.0))
    plain &= rest
    # A saturated frame shows no grain that the other has, and a shaking camera none at its place.
    shaken = (alike > SHAKEN) & (moving < np.square(GRAIN * apart))
    plain |= (apart > 0.0) & ((least < HARDLY * usual) | shaken)
    shines = rest & bright & (alike > ALIKE)
    shines |= (alike * square > GLARING * np.maximum(usual, _around_lines(square))) & (alike > GLARING_ALIKE)
    still = _dilate(_erode(shines | (other & plain), (SQUARE, SQUARE)), (SQUARE, SQUARE))
    for line in (LINE, LINE[::-1]):
        still |= _dilate(_erode(shines, line), line)
    if not still.any():
        return np.asarray(still)
    # A wall has places without a grain, and an edge where its cells see particles beside it. They belong to it
    # between what stands still, if nothing moves there, and beside it where they are as bright, or as dark.
    around = _dilate(still, (GAP, GAP))
    between = _erode(around, (GAP, GAP), beyond=1)
    dark, light = float(np.median(level[moves])), float(np.median(level[still]))
    beside = around & (level > 0.5 * (dark + light)) & (alike > ALIKE) & (light > dark)
    for sign in (1.0, -1.0):
        here = still & other & (sign * apart > 0.0)
        nearby = cv2.dilate(np.where(here, sign * apart, np.float32(0.0)), np.ones((GAP, GAP), np.uint8))
        beside |= (nearby > 0.0) & (sign * apart > 0.5 * nearby)
    return np.asarray(still | (between & rest) | beside)


def _share_of_cells(valid: NDArray[np.bool_], shape: tuple[int, ...]) -> Floats:
    """Share (ny, nx) of the pixels of cells that are valid."""
    import cv2

    if valid.all():
        return np.ones(shape, np.float32)
    part = valid[: shape[0] * STILL_CELL_PX, : shape[1] * STILL_CELL_PX].astype(np.float32)
    return np.asarray(cv2.resize(part, (shape[1], shape[0]), interpolation=cv2.INTER_AREA))


def _numbers(frames: Two, valid: NDArray[np.bool_]) -> list[Floats]:
    """Both frames as float32, what is no number at their mean; counts of any size are brought near 1 together."""
    if all(frame.dtype.kind != "f" and frame.dtype.itemsize <= 2 for frame in frames):
        return [frame.astype(np.float32) for frame in frames]
    inside = [frame[valid] for frame in frames]
    low, high = float(min(part.min() for part in inside)), float(max(part.max() for part in inside))
    span = max(high - low, np.finfo(float).tiny)
    with np.errstate(over="ignore", invalid="ignore"):
        near_one = [((frame - low) / span).astype(np.float32) for frame in frames]
    finite = [np.isfinite(part) for part in near_one]
    return [
        part if known.all() else np.where(known, part, np.float32(part[valid].mean()))
        for part, known in zip(near_one, finite, strict=True)
    ]


def _means_around(values: Floats) -> Floats:
    """Mean of the surroundings of every second row."""
    import cv2

    size = (STILL_LEVEL_PX, STILL_LEVEL_PX)
    return np.asarray(cv2.blur(values, size, borderType=cv2.BORDER_REFLECT)[::2])


def _remove_level(frame: Floats, valid: NDArray[np.bool_], weight: Floats | None) -> tuple[Floats, Floats]:
    """Every second row of a frame without the mean of its surroundings, 0 where masked; and the mean in cells."""
    if weight is None:
        mean = _means_around(frame)
        return frame[::2] - mean, _cells(mean)
    values = np.where(valid, frame, np.float32(0.0))
    mean = _means_around(values) / weight
    rest = values[::2] - mean
    rest *= valid[::2]
    return rest, _cells(mean)


def _floor(a: Floats, b: Floats, shape: tuple[int, ...]) -> Floats:
    """Level of cells (ny, nx) between particles, and without any: of the darker of both frames."""
    import cv2

    half_cell = STILL_CELL_PX // 2
    height, width = (half_cell * cells for cells in shape)
    darker = np.minimum(a, b)
    lacking = (max(2 * whole - side, 0) for whole, side in zip((height, width), a.shape, strict=True))
    down, right = lacking
    if down or right:
        darker = cv2.copyMakeBorder(darker, 0, down, 0, right, cv2.BORDER_REPLICATE)
    half = cv2.resize(darker[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    side = FLOOR_PX // 2
    opened = cv2.morphologyEx(half, cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    return np.asarray(cv2.resize(opened, (shape[1], shape[0]), interpolation=cv2.INTER_AREA), np.float32)


def _products(one: Floats, other: Floats) -> Floats:
    """Means over cells of products of neighbouring pixels."""
    whole = np.zeros(one.shape, np.float32)
    np.multiply(one[:, :-1], other[:, 1:], out=whole[:, :-1])
    return _cells(whole)


def _cells(values: Floats) -> Floats:
    """Means over whole cells and those around them, of every second row of a frame."""
    import cv2

    deep = STILL_CELL_PX // 2
    height, width = max(values.shape[0] // deep, 1), max(values.shape[1] // STILL_CELL_PX, 1)
    part = values[: height * deep, : width * STILL_CELL_PX]
    mean = cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(mean, (0, 0), BLUR_CELLS), np.float32)
