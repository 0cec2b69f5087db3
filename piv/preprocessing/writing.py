"""Writing and bars in frames, found by single pixels: they are brighter than particles, or written into the files.

* Plateaus are areas of 3 x 3 px whose darkest pixel is `PLATEAU` times brighter than those of moving particles in
  most areas of the frame, in either frame: digits of a clock change between both.
* Overlays were put into the files by a program: they have the very same numbers in all frames, which light with
  its noise has not, however slow the flow is and however thin their strokes are.
* Ruled lines are rows or columns that are bright over `LINE_PX` in all frames: those of a graticule or a sensor.
"""

from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

PLATEAU, PLATEAU_QUANTILE = 1.3, 0.999  # over the plateaus of particles, and how many of these are darker
AREAS, USUAL_AREA = 8, 0.8  # along each axis; share of areas that writing does not reach
# Of a stroke or plateau: side of a square, and pixels that it must hold
LETTER_SIDE_PX, LEAST_LETTER_PX2 = 5, 5
LETTER_GAP_PX, HALO_PX = 15, 7  # side of gaps between letters, and of what an edge reaches
FLAT = 0.01  # of a pixel: by which plateaus differ that are resampled
EQUAL = 0.1  # of a plateau's height: difference between both frames
LEAST_KNOWN, HALF = 0.15, 0.5  # share of a line of writing that does not change; of an area or a frame
OVERLAY_QUANTILE, MOST_SAME = 0.9, 0.3  # of the pixels, which are darker; share of bright pixels that are alike
OVERLAY_PX2, OVERLAY_PX, UNWRITTEN = 20, 24, 0.7  # of an overlay: pixels, length of its line; areas without
WRITTEN = 0.75  # of what is as bright as an overlay in either frame: share in both
LINE_PX = 48  # length of a line that is ruled
RULED_HALO_PX = 3  # what its edges reach, beyond one pixel
RULED, RULED_QUANTILE = 0.45, 0.85  # how bright it is: of the brightest; share of the pixels that are darker

Floats = NDArray[np.float32]
Places = NDArray[np.bool_]


class BrightPixels(NamedTuple):
    """Figures of frames, as they are, in which writing is sought.

    Parameters
    ----------
    both, either : (H, W)
        The darkest of 3 x 3 px around each: in all frames, and in the brightest one.
    uneven : (H/2, W/2)
        `either` of every second pixel where it is not flat.
    same, brightest : (H, W)
        Numbers that are the very same in all frames, and the lowest number elsewhere; the largest of all frames.
    """

    both: NDArray[Any]
    either: NDArray[Any]
    uneven: NDArray[Any]
    same: NDArray[Any]
    brightest: NDArray[Any]

    @classmethod
    def of_pair(cls, a: NDArray[Any], b: NDArray[Any]) -> Self:
        """Collect them of two frames (H, W)."""
        import cv2

        size = np.ones((3, 3), np.uint8)
        one, other = (np.asarray(cv2.erode(part, size)) for part in (a, b))
        either, brightest = np.maximum(one, other), np.maximum(a, b)
        top, plateau = np.asarray(cv2.dilate(brightest, size))[::2, ::2], either[::2, ::2]
        uneven = np.where(top - plateau > np.asarray(FLAT * top, top.dtype), plateau, 0)
        return cls(np.minimum(one, other, out=one), either, uneven, _same_numbers(a, b), brightest)

    def join(self, other: Self) -> Self:
        """Collect them of the frames of both."""
        return type(self)(
            np.minimum(self.both, other.both),
            np.maximum(self.either, other.either),
            np.maximum(self.uneven, other.uneven),
            _same_numbers(self.same, other.same),
            np.maximum(self.brightest, other.brightest),
        )


def find_plateaus(
    pixels: BrightPixels,
    seen_at: tuple[Places, Places],
    ground: float,
    moves: Places,
) -> Places:
    """Pixels (H, W) of plateaus far brighter than particles, and what their edges reach.

    `seen_at`: valid pixels, and those that hold a share of each line of writing.
    """
    import cv2

    both, either, (valid, known) = pixels.both, pixels.either, seen_at
    # Digits that change seem to move; but they are flat, and particles are not, or they lie in a few areas.
    particles = float(np.quantile(_brightest_of_areas(pixels.uneven, moves[::2, ::2]), USUAL_AREA))
    least = ground + PLATEAU * (particles - ground)
    core = (both > least) & known
    if not core.any():
        return core
    core &= either - both < EQUAL * (either - ground)  # clumps that drift by less than their size are not
    around = cv2.boxFilter(core.view(np.uint8), -1, (LETTER_SIDE_PX, LETTER_SIDE_PX), normalize=False)
    core &= around >= LEAST_LETTER_PX2
    if not core.any():
        return core
    # Digits that change stand beside those that do not.
    bright = ((either > least) & valid).view(np.uint8)
    number, parts = cv2.connectedComponents(
        cv2.morphologyEx(bright, cv2.MORPH_CLOSE, np.ones((LETTER_GAP_PX, LETTER_GAP_PX), np.uint8))
    )
    known_px, all_px = (np.bincount(parts[part], minlength=number) for part in (core, bright > 0))
    kept = known_px > LEAST_KNOWN * all_px
    kept[0] = False
    # The darkest of 3 x 3 px stands at their middle.
    reach = np.ones((3 + HALO_PX - 1, 3 + HALO_PX - 1), np.uint8)
    return np.asarray(cv2.dilate(bright * kept[parts], reach) > 0)


def find_overlays(pixels: BrightPixels, valid: Places) -> Places:
    """Pixels (H, W) of bright writing and bars that a program put into the files of frames.

    Nothing is said where bright pixels are alike all over the frame, as those of saturated particles at rest are.
    """
    import cv2

    same, brightest = pixels.same, pixels.brightest
    letters, gaps = (np.ones((side, side), np.uint8) for side in (LETTER_SIDE_PX, LETTER_GAP_PX))

    def strokes(which: Places) -> Places:
        around = cv2.boxFilter(which.view(np.uint8), -1, letters.shape, normalize=False)
        return np.asarray(which & (around >= LEAST_LETTER_PX2))

    def lines(which: Places) -> tuple[int, NDArray[np.int32], NDArray[np.int32]]:
        closed = cv2.morphologyEx(which.view(np.uint8), cv2.MORPH_CLOSE, gaps)
        number, parts, sizes, _ = cv2.connectedComponentsWithStats(closed)
        return number, np.asarray(parts), np.asarray(sizes)

    lit = (brightest > np.quantile(brightest[::3, ::3], OVERLAY_QUANTILE)) & valid
    core = strokes(lit & (same == brightest))
    if not core.any():
        return core
    shares = [(same == brightest)[area][lit[area]].mean() for area in _areas_of(lit.shape) if lit[area].any()]
    if np.quantile(shares, UNWRITTEN) > MOST_SAME:
        return np.zeros_like(core)
    number, parts, sizes = lines(core)
    known_px = np.bincount(parts[core], minlength=number)
    kept = (known_px >= OVERLAY_PX2) & (sizes[:, 2:4].max(axis=1) >= OVERLAY_PX)
    kept[0] = False
    core &= kept[parts]
    if not core.any():
        return core
    # Digits that change between frames are as bright as the others. Light that saturates now and then, as that of
    # particles before bright lines, seldom does so in both frames.
    values, times = np.unique(brightest[core], return_counts=True)
    usual = (brightest == values[times.argmax()]) & valid
    number, parts, _ = lines(core | strokes(usual))
    known_px, same_px, usual_px = (
        np.bincount(parts[which], minlength=number) for which in (core, usual & (same == brightest), usual)
    )
    kept = (known_px > 0) & (same_px >= WRITTEN * usual_px)
    kept[0] = False
    bright = (core | usual) & kept[parts]
    return np.asarray(cv2.dilate(bright.view(np.uint8), np.ones((HALO_PX, HALO_PX), np.uint8)) > 0)


def find_ruled_lines(darkest: Floats, valid: Places) -> Places:
    """Pixels (H, W) in and beside bright lines along rows or columns, such as those of a graticule or a sensor.

    No row of particles is so long and nowhere dark in all frames.
    """
    import cv2

    some = darkest[::3, ::3][valid[::3, ::3]]
    if not some.size:
        return np.zeros(valid.shape, bool)
    ground, high, top = (float(part) for part in np.quantile(some, (0.5, RULED_QUANTILE, 1.0)))
    lit = ((darkest > max(high, ground + RULED * (top - ground))) & valid).view(np.uint8)
    # Lines are thin; what is wide is a body, or glare on it.
    lit[cv2.morphologyEx(lit, cv2.MORPH_OPEN, np.ones((HALO_PX, HALO_PX), np.uint8)) > 0] = 0
    found = np.zeros(valid.shape, bool)
    for along in ((1, LINE_PX), (LINE_PX, 1)):
        wide = cv2.dilate(lit, np.ones((3, 1) if along[0] == 1 else (1, 3), np.uint8))
        found |= np.asarray(cv2.morphologyEx(wide, cv2.MORPH_OPEN, np.ones(along, np.uint8)) > 0)
    found = np.asarray(cv2.dilate(found.view(np.uint8), np.ones((RULED_HALO_PX, RULED_HALO_PX), np.uint8)) > 0)
    # More is a pattern, between whose lines there is nothing (`piv.correlation.common_light`).
    return found if found.mean() <= HALF else np.zeros(valid.shape, bool)


def _brightest_of_areas(plateaus: NDArray[Any], moves: Places) -> Floats:
    """Quantiles of the plateaus (h, w) of areas in which most moves; of all that moves where there is none."""
    most = [area for area in _areas_of(moves.shape) if moves[area].sum() > HALF * moves[area].size] or [
        np.s_[:, :]
    ]
    return np.array([np.quantile(plateaus[area][moves[area]], PLATEAU_QUANTILE) for area in most], np.float32)


def _areas_of(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """Parts of a frame, `AREAS` along each axis."""
    edges = [np.linspace(0, side, AREAS + 1).astype(int) for side in shape]
    return [
        np.s_[top:bottom, left:right] for top, bottom in pairwise(edges[0]) for left, right in pairwise(edges[1])
    ]


def _same_numbers(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """Pixels that are the same in two frames, number by number, and the lowest number of a frame elsewhere."""
    return np.where(one == other, one, min(one.min(), other.min()))
