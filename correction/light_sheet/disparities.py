"""How far two views of the particles lie apart: correlation over many frames, cell by cell.

Frames become the deviation of each pixel from its own mean over the frames of its pulse, over its own standard
deviation: what stands still is gone, and glints that flicker count little.  Products of the two views are summed
over places of a cell and over all frames, for a small plane of lags along D and across (`double_views`).  No
picture is resampled, and no window needs a rectangle: a ring three pixels wide around a ball is as good as any.

The peak of a plane is a Gaussian whose widths all cells of a kind share (what the views make of a particle, and
the thickness of the sheet).  How sure its place is, the frames themselves say: one tenth of them after the other
is left out (jackknife).
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.light_sheet.double_views import ACROSS, DoubleViews
from correction.light_sheet.kernels.lagged import add_products
from ground.rows import thread_count

Pair = tuple[NDArray[np.float32], NDArray[np.float32]]
Pairs = Callable[[], Iterator[Pair]]  # the same pairs of raw frames (H, W), whenever it is called

BLOCKS = 10
BRIGHTEST = 6.0  # standard deviations; brighter ones count as so many
EVENED_PX = 5  # the standard deviation is that of so many pixels a side
CLEAR = 5.0  # standard deviations that a peak stands out by
STEPS = 4


@dataclass(frozen=True)
class Light:
    """What stands still: mean and 1 / standard deviation (2, H, W) of the pixels at pulse A and B."""

    mean: NDArray[np.float32]
    scale: NDArray[np.float32]

    @classmethod
    def of(cls, pairs: Pairs) -> tuple["Light", int]:
        """Gather it; also how many pairs there are."""
        total: list[NDArray[np.float64]] = []
        count = 0
        for pair in pairs():
            frames = [frame.astype(np.float64) for frame in pair]
            if not total:
                total = [np.zeros_like(frames[0]) for _ in range(4)]
            for pulse, frame in enumerate(frames):
                total[pulse] += frame
                total[2 + pulse] += frame * frame
            count += 1
        mean = np.array(total[:2]) / max(count, 1)
        variance = np.maximum(np.array(total[2:]) / max(count, 1) - mean**2, 0.0)
        evened = np.array([scipy.ndimage.uniform_filter(each, EVENED_PX) for each in variance])
        scale = 1.0 / np.sqrt(np.maximum(evened, 1e-3 * max(float(evened.mean()), 1e-12)))
        return cls(np.asarray(mean, np.float32), np.asarray(scale, np.float32)), count

    def deviation(self, frame: NDArray[np.float32], pulse: int) -> NDArray[np.float32]:
        """Deviation (H, W) of a frame in standard deviations."""
        off = (frame - self.mean[pulse]) * self.scale[pulse]
        return np.ascontiguousarray(np.minimum(off, np.float32(BRIGHTEST)), np.float32)


@dataclass(frozen=True)
class Disparities:
    """Disparities of C cells with a clear peak.

    Parameters
    ----------
    place_mm : (C, 2) float64
        Middle of the cell.
    kind : (C,) int64
        Which two views.
    parallax : (C,) float64
        |D|.
    along_px, across_px : (C,) float64
        Along D and across, corrected px; `along_sigma_px`, `across_sigma_px` their standard deviations.
    bend_px : (C,) float64
        What was taken off `along_px` because the second view bends: good to itself.
    places : (C,) int64
        Places of the cell.
    widths : dict
        Kind -> measured variance of its peak along and across [px^2], and the same of a particle of 1 px^2.
    pitch_mm : float
        A corrected pixel.
    """

    place_mm: NDArray[np.float64]
    kind: NDArray[np.int64]
    parallax: NDArray[np.float64]
    along_px: NDArray[np.float64]
    across_px: NDArray[np.float64]
    along_sigma_px: NDArray[np.float64]
    across_sigma_px: NDArray[np.float64]
    bend_px: NDArray[np.float64]
    places: NDArray[np.int64]
    widths: dict[int, tuple[float, float, float, float]]
    pitch_mm: float

    @property
    def height_mm(self) -> NDArray[np.float64]:
        """Height (C,) of the particles over the plane of the map."""
        return self.along_px * self.pitch_mm / self.parallax

    @property
    def height_sigma_mm(self) -> NDArray[np.float64]:
        """Its standard deviation."""
        return self.along_sigma_px * self.pitch_mm / self.parallax


def disparities(
    views: DoubleViews, cell: NDArray[np.int64], pairs: Pairs, light: Light, count: int, reach: int
) -> Disparities:
    """Measure the disparities of cells.

    Parameters
    ----------
    views : DoubleViews
        Places seen twice.
    cell : (N,) int64
        Cell of each place, 0 ...; all places of one are of one kind.
    pairs, light, count
        Frames, what stands still in them, how many pairs there are.
    reach : int
        Lags to either side along D, in units of `DoubleViews.units`.
    """
    cells = int(cell.max()) + 1
    planes = np.zeros((BLOCKS, cells, 2 * reach + 1, 2 * ACROSS + 1))
    units = views.units()
    steps = (views.along_px * units[:, :1], views.across_px * units[:, 1:])
    first, second, along, across = (
        np.ascontiguousarray(part) for part in (views.first_px, views.second_px, *steps)
    )

    def products(task: tuple[int, int, NDArray[np.float32]]) -> tuple[int, NDArray[np.float64]]:
        number, pulse, frame = task
        out = np.zeros(planes.shape[1:])
        add_products(light.deviation(frame, pulse), first, second, along, across, cell, out)
        return number * BLOCKS // count, out

    with ThreadPoolExecutor(thread_count()) as pool:
        batch: list[tuple[int, int, NDArray[np.float32]]] = []
        for number, pair in enumerate(pairs()):
            batch += [(number, pulse, frame) for pulse, frame in enumerate(pair)]
            if len(batch) >= 2 * thread_count():
                for block, found in pool.map(products, batch):
                    planes[block] += found
                batch = []
        for block, found in pool.map(products, batch):
            planes[block] += found
    places = np.bincount(cell, minlength=cells)
    planes /= np.maximum(places, 1)[None, :, None, None]
    return _measured(views, cell, places, planes, reach)


def _measured(
    views: DoubleViews,
    cell: NDArray[np.int64],
    places: NDArray[np.int64],
    planes: NDArray[np.float64],
    reach: int,
) -> Disparities:
    """Peaks of the planes (BLOCKS, C, ., .) of cells."""
    lags = np.meshgrid(np.arange(-reach, reach + 1.0), np.arange(-ACROSS, ACROSS + 1.0), indexing="ij")
    along, across = (lag.ravel() for lag in lags)
    blocks = planes.reshape(BLOCKS, len(places), -1)
    _, first = np.unique(cell, return_index=True)
    kind_of, whole = np.full(len(places), -1), blocks.sum(axis=0)
    kind_of[cell[first]] = views.kind[first]
    found, bend = np.full((len(places), 4), np.nan), np.zeros(len(places))
    widths: dict[int, tuple[float, float, float, float]] = {}
    for kind in np.unique(kind_of[kind_of >= 0]):
        here = np.nonzero(kind_of == kind)[0]
        shape = _shape(np.average(whole[here], axis=0, weights=places[here]), along, across)
        if shape is None:
            continue
        of_kind = views.kind == kind
        blob, unit = views.blob[of_kind].mean(axis=0), views.units()[np.argmax(of_kind)]
        wide = np.square(np.array(shape[2:]) * unit)
        if not _stands_out(blocks[:, here].mean(axis=1), along, across, shape):
            continue
        widths[int(kind)] = (float(wide[0]), float(wide[1]), float(blob[0]), float(blob[1]))
        for one in here:
            peak = _peak(whole[one], along, across, shape)
            if peak is None or not abs(peak[0]) < reach - 1.0:
                continue
            left = whole[one] - blocks[:, one]
            moved = [_peak(each, along, across, shape, peak) for each in left]
            steps = np.array([each if each is not None else (np.nan, np.nan) for each in moved])
            sigma = np.sqrt((BLOCKS - 1.0) / BLOCKS * np.sum((steps - steps.mean(axis=0)) ** 2, axis=0))
            if np.isfinite(sigma).all() and (sigma < 0.5 * np.array(shape[2:])).all():
                bend_px = float(views.bend[cell == one].mean()) * wide[1] / float(blob[1])
                at, bend[one] = np.array(peak) * unit - (bend_px, 0.0), bend_px
                found[one] = (*at, *np.maximum(sigma * unit, 1e-3))
        _even(found, here, places)
    good = np.isfinite(found).all(axis=1)
    weight = np.maximum(places, 1)
    middle = np.stack([np.bincount(cell, views.place_mm[:, k], len(places)) / weight for k in (0, 1)], axis=-1)
    parallax = np.bincount(cell, views.parallax, len(places)) / weight
    ahead, aside, ahead_sigma, aside_sigma = found[good].T
    return Disparities(
        middle[good], kind_of[good], parallax[good], ahead, aside, ahead_sigma, aside_sigma, bend[good],
        places[good], widths, views.pitch_mm,
    )  # fmt: skip


def _even(found: NDArray[np.float64], here: NDArray[np.int64], places: NDArray[np.int64]) -> None:
    """Let sigmas of the cells of a kind learn from each other: ten parts of the frames tell one to a quarter only.

    Half of each variance is its own, half what a place of this kind usually costs.
    """
    known = here[np.isfinite(found[here]).all(axis=1)]
    if len(known):
        usual = np.median(found[known, 2:] ** 2 * places[known, None], axis=0) / places[known, None]
        found[known, 2:] = np.sqrt(0.5 * (found[known, 2:] ** 2 + usual))


def _stands_out(
    planes: NDArray[np.float64], along: NDArray[np.float64], across: NDArray[np.float64], shape: Sequence[float]
) -> bool:
    """Whether a peak is in the blocks (BLOCKS, .) one by one, and not in some of them only."""
    u, v = (along - shape[0]) / shape[2], (across - shape[1]) / shape[3]
    design = np.stack((np.ones_like(u), np.exp(-0.5 * (u * u + v * v))), axis=-1)
    heights = np.linalg.lstsq(design, planes.T, rcond=None)[0][1]
    return bool(heights.mean() > CLEAR * heights.std(ddof=1) / np.sqrt(len(heights)))


def _shape(
    plane: NDArray[np.float64], along: NDArray[np.float64], across: NDArray[np.float64]
) -> tuple[float, float, float, float] | None:
    """Place and widths (standard deviations) of the peak of a kind; None if nothing stands out."""
    low = float(np.median(plane))
    noise = 1.4826 * float(np.median(np.abs(plane - low)))
    top = int(plane.argmax())
    if not plane[top] - low > CLEAR * noise:
        return None

    def misfit(x: NDArray[np.float64]) -> NDArray[np.float64]:
        bell = np.exp(-0.5 * ((along - x[2]) / x[4]) ** 2 - 0.5 * ((across - x[3]) / x[5]) ** 2)
        return np.asarray((x[0] + x[1] * bell - plane) / (plane[top] - low))

    limits = ([-np.inf, 0.0, along.min(), -2.0, 0.6, 0.6], [np.inf, np.inf, along.max(), 2.0, 5.0, 3.0])
    start = [low, plane[top] - low, along[top], np.clip(across[top], -1.9, 1.9), 1.2, 1.2]
    best = scipy.optimize.least_squares(misfit, start, bounds=limits).x
    return float(best[2]), float(best[3]), float(best[4]), float(best[5])


def _peak(
    plane: NDArray[np.float64],
    along: NDArray[np.float64],
    across: NDArray[np.float64],
    shape: Sequence[float],
    start: tuple[float, float] | None = None,
) -> tuple[float, float] | None:
    """Place of a peak whose widths are known: background, height and place by linear steps."""
    x, y = (shape[0], shape[1]) if start is None else start
    for _ in range(STEPS):
        u, v = (along - x) / shape[2], (across - y) / shape[3]
        bell = np.exp(-0.5 * (u * u + v * v))
        design = np.stack((np.ones_like(bell), bell, bell * u / shape[2], bell * v / shape[3]), axis=-1)
        answer = np.linalg.lstsq(design, plane, rcond=None)[0]
        if not answer[1] > 0.0:
            return None
        dx, dy = np.clip(answer[2:] / answer[1], -1.0, 1.0)
        x, y = float(x + dx), float(y + dy)
        if not (abs(x) <= along.max() and abs(y) <= across.max()):
            return None
    return x, y
