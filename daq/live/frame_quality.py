"""Quality of the last frame, in numbers and as maps of tiles, and the direction of the focus.

Particles are Gaussian spots of diameter d = 4 s.  The autocorrelation of such an image falls by
R(k) ~ exp(-k^2 / (4 s^2)) at a shift of k px, whatever their number and brightness; noise of the sensor adds to
R(0) alone.  So

    s^2 = 3 / (4 ln(R(1) / R(2)))

without ever looking for a particle, R taken over its value far off, which is the mean brightness squared.  Their
number comes from the local maxima that stand out, their contrast from how far: brightness of the particles over
the noise between them.  The diameter as a map is the map of the focus, and behind a ball that of its depth of
field.

A chessboard has edges instead. An edge between dark and bright, A apart, that is blurred by a standard deviation s
is at its steepest A / (sqrt(2 pi) s); differences over two pixels add 1/3 px^2 to its variance. Squares have to be
some eight times as wide as the blur, or bright and dark do not reach what they are.

Which way to turn the ring of a lens follows from how sharp the view is while it is turned.  One frame
does not say on which side of the focus it was taken: the same spot is as wide before it as behind it.
What says it is a turn. Widths v(t) of the last looks are kept; the last two are compared with the two before, by
their scatter, which is taken from second differences, because those do not see a steady turn:

    sigma^2 = median((v(t-1) - 2 v(t) + v(t+1))^2) / (6 * 0.455)

(0.455: median of chi squared with one degree of freedom.) Further than `FOCUS_SIGMAS` sigmas apart the view
becomes sharper or softer. The sharpest of `MEMORY_S` is the wider one of two looks after each other, so that a bad
look is none.
"""

import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.live.monitor import Monitor
from daq.live.picture import white_of
from daq.pipeline.live_slot import SlotReader, Snapshot

MEMORY_S = 60.0
LOOKS = 8  # before anything is said: of fewer the scatter is not known
FOCUS_SIGMAS = 4.0
LEAST = 0.004  # of a width: scatter that no frame is better than
SIXTH, CHI = 6.0, 0.455
SPAN = 24  # looks whose scatter is taken


class FocusTrend:
    """Follows a width; smaller is sharper."""

    def __init__(self) -> None:
        self._looks: deque[tuple[float, float]] = deque()

    def forget(self) -> None:
        """Begin anew: what is seen is something else."""
        self._looks.clear()

    def see(self, now_s: float, width_px: float) -> None:
        """Add a look; times only go forward."""
        if math.isfinite(width_px):
            self._looks.append((now_s, width_px))
        while self._looks and now_s - self._looks[0][0] > MEMORY_S:
            self._looks.popleft()

    @property
    def sentence(self) -> str:
        """Advice for the person who turns the focus ring; "" while there is none."""
        if len(self._looks) < LOOKS:
            return ""
        times, widths = (np.array(column) for column in zip(*self._looks, strict=True))
        sigma = self._sigma(widths)
        now, before = float(widths[-2:].mean()), float(widths[-4:-2].mean())
        wider = np.maximum(widths[1:], widths[:-1])
        sharpest = int(wider.argmin())
        best, ago_s = float(wider[sharpest]), float(times[-1] - times[sharpest + 1])
        at_best = now - best <= FOCUS_SIGMAS * sigma
        was = f"it was {best:.2f} px {ago_s:.0f} s ago"
        if abs(now - before) > FOCUS_SIGMAS * sigma:
            if now < before:
                return f"{now:.2f} px, becoming sharper: go on"
            return f"{now:.2f} px, becoming softer: turn back" + ("" if at_best else f"; {was}")
        if not at_best:
            return f"{now:.2f} px: turn back the way you came; {was}"
        if float(widths.max()) - best > 2.0 * FOCUS_SIGMAS * sigma:
            return f"{now:.2f} px, as sharp as it was in the last minute"
        return f"{now:.2f} px: turn the ring a little, to see which way is sharper"

    @staticmethod
    def _sigma(widths: np.ndarray) -> float:
        """Scatter of one look."""
        some = widths[-SPAN:]
        bends = np.diff(some, 2) ** 2
        return max(math.sqrt(float(np.median(bends)) / (SIXTH * CHI)), LEAST * float(np.median(some)))


Rows = list[list[float | None]]  # a map, tile by tile
T = TypeVar("T")
TILES = 12  # along the longer side
LOOKED_AT_PX = 96  # side of what is looked at in the middle of a tile
NOISE_OF_MAD = 1.4826  # sigma of a normal distribution / median absolute deviation
STANDS_OUT = 5.0  # noise above the median, from which a maximum is a particle
BEYOND_PARTICLES_PX = 12  # a shift that no particle reaches over
# percentile, noise in bright less dark, pixels themselves
STEEPEST, OF_AN_EDGE, LEAST_EDGE_PX = 99.0, 20.0, 0.3
MIN_TILE_PARTICLES = 6  # maxima in a tile, below which nothing is said of it
BINS = 64


def share_of_saturated(pixels: NDArray[Any], white: int) -> float:
    """Share of saturated pixels, of those that are known."""
    known = np.isfinite(pixels)
    return float((pixels >= white).sum() / max(int(known.sum()), 1))


def brightness(pixels: NDArray[Any], white: int) -> float:
    """Grey level of the 99.9th percentile, as a share of white."""
    some = pixels[::4, ::4]
    some = some[np.isfinite(some)]
    return float(np.quantile(some, 0.999)) / white if some.size else 0.0


def histogram(pixels: NDArray[Any], white: int) -> list[int]:
    """Counts in BINS equal bins up to white, of every sixteenth pixel; a single saturated one is noticed."""
    some = pixels[::4, ::4]
    counts, _ = np.histogram(some[np.isfinite(some)], BINS, (0.0, white + 1.0))
    counts[-1] = max(counts[-1], np.any(pixels >= white))
    return [int(count) for count in counts]


def particle_maps(pixels: NDArray[Any]) -> dict[str, Rows]:
    """Diameter [px], density [1/px] and contrast of particles in tiles, row by row; None where unknown."""
    tiles = _tiles(pixels, _of_tile)
    return {
        name: [[tile[place] for tile in row] for row in tiles]
        for place, name in enumerate(("diameter_px", "density", "contrast"))
    }


def edge_map(pixels: NDArray[Any]) -> Rows:
    """Blur [px] of the edges of a board, standard deviation, in tiles; None where there is no edge."""
    return _tiles(pixels, _edge_of_tile)


def middle_of(rows: Rows) -> float:
    """Median of a map; NaN of an empty one."""
    known = [value for row in rows for value in row if value is not None]
    return float(np.median(known)) if known else math.nan


def _tiles(pixels: NDArray[Any], of_tile: Callable[[NDArray[Any]], T]) -> list[list[T]]:
    """Yield the values found in the middle of each tile."""
    height, width = pixels.shape
    side = max(16, -(-max(height, width) // TILES))
    rows, columns = (_middles(length, side) for length in (height, width))
    return [[of_tile(pixels[r.start : r.stop, c.start : c.stop]) for c in columns] for r in rows]


def _middles(length: int, side: int) -> list[range]:
    """Ranges of each tile that are evaluated along one axis."""
    tiles = [(first, min(first + side, length)) for first in range(0, length - side // 2, side)]
    spare = [max(0, last - first - LOOKED_AT_PX) // 2 for first, last in tiles]
    return [range(first + less, last - less) for (first, last), less in zip(tiles, spare, strict=True)]


def _of_tile(tile: NDArray[Any]) -> tuple[float | None, float | None, float | None]:
    image: NDArray[Any] = np.asarray(tile, np.float32)
    if not np.isfinite(image).mean() > 0.5:
        return None, None, None
    middle = float(np.nanmedian(image[::2, ::2]))  # a quarter of the pixels tells it as well
    image = np.where(np.isfinite(image), image, middle) - middle
    noise = max(NOISE_OF_MAD * float(np.median(np.abs(image[::2, ::2]))), 1e-6)
    inner = image[1:-1, 1:-1]
    top = inner > STANDS_OUT * noise
    for down in (0, 1, 2):
        for right in (0, 1, 2):
            if (down, right) < (1, 1):
                top &= inner > image[down : down + inner.shape[0], right : right + inner.shape[1]]
            elif (down, right) > (1, 1):
                top &= inner >= image[down : down + inner.shape[0], right : right + inner.shape[1]]
    count = int(top.sum())
    density = count / inner.size
    if count < MIN_TILE_PARTICLES:
        return None, density, None
    beyond = _autocorrelation(image, BEYOND_PARTICLES_PX)
    falls = [_autocorrelation(image, k) - beyond for k in (1, 2)]
    contrast = float(np.median(inner[top])) / noise
    if not falls[0] > falls[1] > 0.0:
        return None, density, contrast
    return 4.0 * math.sqrt(0.75 / math.log(falls[0] / falls[1])), density, contrast


def _edge_of_tile(tile: NDArray[Any]) -> float | None:
    image: NDArray[Any] = np.asarray(tile, np.float32)
    if not np.isfinite(image).all():
        return None
    dark, bright = np.percentile(image[::2, ::2], (5.0, 95.0))
    across, down = image[1:-1, 2:] - image[1:-1, :-2], image[2:, 1:-1] - image[:-2, 1:-1]
    bends = (
        image[:, 2:] - 2.0 * image[:, 1:-1] + image[:, :-2]
    )  # across, then down: edges along either leave nothing
    noise = NOISE_OF_MAD / 6.0 * float(np.median(np.abs(bends[2::2] - 2.0 * bends[1:-1:2] + bends[:-2:2])))
    steepest = 0.5 * float(np.percentile(np.hypot(across, down), STEEPEST))
    if bright - dark < OF_AN_EDGE * max(noise, 1e-6) or steepest <= 0.0:
        return None
    variance = ((bright - dark) / steepest) ** 2 / (2.0 * math.pi) - 1.0 / 3.0
    return math.sqrt(max(variance, LEAST_EDGE_PX**2))


def _autocorrelation(image: NDArray[Any], shift_px: int) -> float:
    """Mean product of an image and itself, shifted to the right and down."""
    k = shift_px
    return 0.5 * float((image[:, :-k] * image[:, k:]).mean() + (image[:-k] * image[k:]).mean())


FIGURES_EVERY_S = 0.5


class FrameQuality(Monitor):
    """Figures of the last frame, made anew twice a second at most, and which way the focus goes.

    Parameters
    ----------
    slot : SlotReader
        Where frames are shown.
    """

    def __init__(self, slot: SlotReader) -> None:
        super().__init__(slot, FIGURES_EVERY_S)
        self.figures: dict[str, Any] = {}
        self._trend, self._of = FocusTrend(), ""

    def see(self, snapshot: Snapshot) -> None:
        """Figure out what a frame is worth."""
        raw, white = snapshot.pictures["raw"], white_of(snapshot.words)
        is_board = snapshot.words.get("shows") == "chessboard"
        maps: dict[str, Rows] = {"edge_px": edge_map(raw)} if is_board else particle_maps(raw)
        self._follow(snapshot.words, middle_of(maps["edge_px" if is_board else "diameter_px"]))
        self.figures = {
            "of": snapshot.number,
            "saturated": share_of_saturated(raw, white),
            "bright": brightness(raw, white),
            "histogram": histogram(raw, white),
            "maps": maps,
        }

    def _follow(self, words: dict[str, Any], width_px: float) -> None:
        """Say which way to turn; another step or another target is another view."""
        of = f"{words.get('run')}, {words.get('shows')}"
        if of != self._of:
            self._of = of
            self._trend.forget()
        self._trend.see(time.monotonic(), width_px)
        self.said = {"focus": [self._trend.sentence, False]} if self._trend.sentence else {}
