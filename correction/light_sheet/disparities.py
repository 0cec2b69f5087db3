"""Disparity of two views of the particles: correlation over many frames, cell by cell.

Frames become the deviation of each pixel from its own mean over the frames of its pulse, so what stands still is
gone.  A place counts by the standard deviations around its two pixels, so glints that flicker count little.  They
are those of a square wide enough to hold many particles: of a few pixels they follow the particles themselves, a
place counts the less the better both views agree there, and a sheet behind one ball was found 0.06 mm too high and
three times as thick.  Pixels are not divided by their own, which would move every particle towards the darker side
of a view: by 0.2 px of a blurred picture at a rim.  Products of the two views are summed
over places of a cell and over all frames, for a small plane of lags along D and across (`double_views`).  No
picture is resampled, and no window needs a rectangle: a ring three pixels wide around a ball is as good as any.

The planes are matched with what layers of particles would make of them (`layers.py`): first those of all cells
of a kind together, then each cell's.  A cell that stands out (`ALONE`) is searched for its own height.  Faint ones
are not: which cells have a height would go by what noise made of them, and so would the height.  One tells its
height by a linear step from the match of its kind, and no cell is left out.  How sure a height is, the frames
themselves say: one tenth of them after the other is left out (jackknife).
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.errors import SheetError
from correction.light_sheet.double_views import ACROSS, UNIT, DoubleViews, some_of_each
from correction.light_sheet.kernels.lagged import add_products
from correction.light_sheet.layers import SIZES, Match, Model, layers
from ground.rows import thread_count
from tracer.scene.scene import Scene

Pair = tuple[NDArray[np.float32], NDArray[np.float32]]
Pairs = Callable[[], Iterator[Pair]]  # the same pairs of raw frames (H, W), whenever it is called

BLOCKS = 10
# Standard deviations of a glint; particles of 0.03 a px have 4 to 8, and cut ones look flat
BRIGHTEST = 12.0
# Side of the square whose standard deviation counts: of 5, single particles weigh their own place down
EVENED_PX = 25
CLEAR_PEAK_SIGMAS = 8.0  # standard deviations, from ten blocks, that the best of thirty places must stand out by
# The same of a cell that is matched alone: noise draws it by 1 / 400 of the width of its peak
ALONE = 20.0
MIN_VALID_SHARE = 0.25  # of the heights and lags looked at
LONG_MM = 2.0  # height for a lag, from which on heights of cells are near enough for one step
HEIGHT, SHIFT, SPREAD, SIZE = range(4)  # numbers of a `Match`
USUAL_MM = 0.18  # spread of the light of a sheet of 1 mm
USUAL_SPREAD2, USUAL_SIZE = (USUAL_MM**2, 0.1), (0.45, 1.0)  # and how far they may be from that
MODELLED, LEAST_MODELLED = 2000, 30  # places, and of a cell
MODELLED_TO = 0.3  # of what bend and fading make of a height; flows behind two balls left 0.22, a ball more


@dataclass(frozen=True)
class Light:
    """Static light: mean and 1 / standard deviation (2, H, W) of the pixels at pulse A and B."""

    mean: NDArray[np.float32]
    scale: NDArray[np.float32]

    @classmethod
    def of(cls, pairs: Pairs, fewest: int, question: str) -> tuple["Light", int]:
        """Gather it; also how many pairs there are; SheetError if they are too few to answer the question."""
        total: list[NDArray[np.float64]] = []
        count = 0
        for pair in pairs():
            frames = [frame.astype(np.float64) for frame in pair]
            sums = [*frames, *map(np.square, frames)]
            total = [one + more for one, more in zip(total, sums, strict=True)] if total else sums
            count += 1
        if count < fewest:
            raise SheetError(f"{count} pairs of frames do not tell {question}; give {fewest} or more, best 50")
        mean = np.array(total[:2]) / count
        variance = np.maximum(np.array(total[2:]) / count - mean**2, 0.0)
        evened = np.array([scipy.ndimage.uniform_filter(each, EVENED_PX) for each in variance])
        scale = 1.0 / np.sqrt(np.maximum(evened, 1e-3 * max(float(evened.mean()), 1e-12)))
        return cls(np.asarray(mean, np.float32), np.asarray(scale, np.float32)), count

    def deviation(self, frame: NDArray[np.float32], pulse: int) -> NDArray[np.float32]:
        """Deviation (H, W) of a frame."""
        most = np.float32(BRIGHTEST) / self.scale[pulse]
        return np.ascontiguousarray(np.minimum(frame - self.mean[pulse], most), np.float32)

    def weight(self, views: DoubleViews, pulse: int) -> NDArray[np.float64]:
        """Weights of places (N,)."""
        weight = np.ones(len(views.kind))
        for pixel in (views.first_px, views.second_px):
            column, row = np.rint(pixel).astype(np.int64).T
            weight *= self.scale[pulse][row, column]
        return weight


@dataclass(frozen=True)
class Disparities:
    """Disparities of C cells with a clear peak.

    Parameters
    ----------
    place_mm : (C, 2) float64
        Middle of the cell.
    number : (C,) int64
        Of the cell, among all that were asked for.
    kind : (C,) int64
        Which two views.
    parallax : (C,) float64
        |D|.
    height_mm, height_sigma_mm : (C,) float64
        Height of the particles over the plane of the map, and its standard deviation.
    common_mm : (C, Q) float64
        Errors of the heights that cells share, one standard deviation a column: what the model of bend and fading
        makes of each kind, what depth of the sheet and size of pictures that are given too large make of all, and
        what the scene is unsure of.
    across_px, across_sigma_px : (C,) float64
        Disparity across D [corrected px].
    width_px : (C,) float64
        Standard deviation of a peak across D.
    places : (C,) int64
        Places of the cell.
    spread2_mm2 : (float, float)
        Variance of the sheet's light across it, and its standard deviation.
    pitch_mm : float
        A corrected pixel.
    """

    place_mm: NDArray[np.float64]
    number: NDArray[np.int64]
    kind: NDArray[np.int64]
    parallax: NDArray[np.float64]
    height_mm: NDArray[np.float64]
    height_sigma_mm: NDArray[np.float64]
    common_mm: NDArray[np.float64]
    across_px: NDArray[np.float64]
    across_sigma_px: NDArray[np.float64]
    width_px: NDArray[np.float64]
    places: NDArray[np.int64]
    spread2_mm2: tuple[float, float]
    pitch_mm: float


def disparities(
    scene: Scene,
    views: DoubleViews,
    cell: NDArray[np.int64],
    pairs: Pairs,
    light: Light,
    count: int,
    reach: int,
    reach_mm: float,
) -> Disparities:
    """Measure the disparities of cells.

    Parameters
    ----------
    scene : Scene
        In the plane of the map.
    views : DoubleViews
        Its places seen twice.
    cell : (N,) int64
        Cell of each place, 0 ...; all places of one are of one kind.
    pairs, light, count
        Frames, what stands still in them, how many pairs there are.
    reach : int
        Lags to either side along D, in units of `DoubleViews.units`.
    reach_mm : float
        Heights to either side of the plane.
    """
    cells = int(cell.max()) + 1
    planes = np.zeros((BLOCKS, cells, 2 * reach + 1, 2 * ACROSS + 1))
    units = views.units()
    steps = (views.along_px * units[:, :1], views.across_px * units[:, 1:])
    first, second, along, across = (
        np.ascontiguousarray(part) for part in (views.first_px, views.second_px, *steps)
    )

    weights = [light.weight(views, pulse) for pulse in (0, 1)]

    def products(task: tuple[int, int, NDArray[np.float32]]) -> tuple[int, NDArray[np.float64]]:
        number, pulse, frame = task
        out = np.zeros(planes.shape[1:])
        add_products(light.deviation(frame, pulse), weights[pulse], first, second, along, across, cell, out)
        return number * BLOCKS // count, out

    with ThreadPoolExecutor(thread_count()) as pool:
        tasks = ((number, pulse, pair[pulse]) for number, pair in enumerate(pairs()) for pulse in (0, 1))
        while batch := list(islice(tasks, 2 * thread_count())):  # no more frames in memory than are worked on
            for block, found in pool.map(products, batch):
                planes[block] += found
    places = np.bincount(cell, minlength=cells)
    planes /= np.maximum(places, 1)[None, :, None, None]
    return _match_planes(scene, views, cell, weights[0] + weights[1], planes, reach_mm)


def _match_planes(
    scene: Scene,
    views: DoubleViews,
    cell: NDArray[np.int64],
    weight: NDArray[np.float64],
    planes: NDArray[np.float64],
    reach_mm: float,
) -> Disparities:
    """Match the planes (BLOCKS, C, ., .) of cells."""
    places = np.bincount(cell)
    models = _models(scene, views, cell, weight, planes.shape[2] // 2, reach_mm)
    blocks = planes.reshape(BLOCKS, len(places), -1)
    _, first = np.unique(cell, return_index=True)
    units_of = views.units()
    kind_of, units = views.kind[first], units_of[first]
    found = np.full((len(places), 4), np.nan)
    kinds: Kinds = {}
    for kind in np.unique(kind_of):
        here = np.nonzero(kind_of == kind)[0]
        share = places[here] / places[here].sum()
        model = Model(models[0].height_mm, *(
            np.tensordot(share, np.array([getattr(models[one], part) for one in here]), axes=1)
            for part in ("small", "large")
        ))  # fmt: skip
        summed = np.tensordot(share, blocks[:, here], axes=(0, 1))
        start = model.start(summed.sum(axis=0), USUAL_MM**2)
        match = None if start is None else model.fit(summed.sum(axis=0), start, [HEIGHT, SHIFT, SIZE])
        if match is not None and model.clearness(summed, match) > CLEAR_PEAK_SIGMAS:
            kinds[int(kind)] = model, summed, match
    usual = _common(kinds, SIZE, USUAL_SIZE)
    kinds = _with(kinds, SIZE, usual[0], [HEIGHT, SHIFT, SPREAD])
    spread2 = _common(kinds, SPREAD, USUAL_SPREAD2)
    kinds = _with(kinds, SPREAD, spread2[0], [HEIGHT, SHIFT])
    parallax, across = (np.bincount(cell, part) / places for part in (views.parallax, units_of[:, 1] / UNIT))
    common = np.zeros((len(places), 2 * len(kinds) + 2))
    unsure = [
        _with(kinds, number, sum(known), [HEIGHT, SHIFT]) for number, known in ((SPREAD, spread2), (SIZE, usual))
    ]
    for number, (kind, (whole_model, summed, match)) in enumerate(kinds.items()):
        here = np.nonzero(kind_of == kind)[0]
        # Kinds are alike: what the model leaves of one, it leaves of all, and their number does not make it less.
        misfit = whole_model.number_sigmas(summed, match, [HEIGHT, SHIFT])[1, 0] * np.sqrt(len(kinds))
        common[here, 2 * number + 1] = misfit
        for column, others in enumerate(unsure, 2 * len(kinds)):
            if kind in others:
                common[here, column] = others[kind][2].values[HEIGHT] - match.values[HEIGHT]
        for one in here:
            whole = blocks[:, one].sum(axis=0)
            lags = models[one].offset(*match.values[[SPREAD, SIZE]]) * units[one, 0]
            common[one, 2 * number] = MODELLED_TO * lags * views.pitch_mm / parallax[one]
            own = models[one].fit(whole, match.values, [HEIGHT, SHIFT])
            is_long = units[one, 0] * views.pitch_mm / parallax[one] > LONG_MM
            if is_long and (own is None or models[one].clearness(blocks[:, one], own) < ALONE):
                at, values = match, models[one].beside(whole, match, [HEIGHT, SHIFT])
            elif own is not None:
                at, values = own, own.values
            else:
                continue
            sigma = np.hypot(*models[one].number_sigmas(blocks[:, one], at, [HEIGHT, SHIFT]))
            if not is_long and (sigma >= MIN_VALID_SHARE * np.array([reach_mm, ACROSS])).any():
                continue
            if not (sigma > 0.0).all():  # no layer is seen from here
                continue
            found[one] = (*values[:2], *np.maximum(sigma, 1e-4)) * np.array([1.0, units[one, 1]] * 2)
        _even(found, here, places)
    good = np.isfinite(found).all(axis=1)
    middle = np.stack([np.bincount(cell, views.place_mm[:, k]) / places for k in (0, 1)], axis=-1)
    height, aside, height_sigma, aside_sigma = found[good].T
    return Disparities(
        middle[good], np.nonzero(good)[0], kind_of[good], parallax[good], height, height_sigma, common[good],
        aside, aside_sigma, across[good], places[good], spread2, views.pitch_mm,
    )  # fmt: skip


Kinds = dict[int, tuple[Model, NDArray[np.float64], Match]]


def _common(kinds: Kinds, number: int, usual: tuple[float, float]) -> tuple[float, float]:
    """Combine the estimates of a number that all kinds share; return it with its standard deviation.

    Kinds that differ by more than they may are all less sure (Birge).
    """
    values, weights = [], []
    for model, blocks, match in kinds.values():
        sigma = float(np.hypot(*model.number_sigmas(blocks, match, [HEIGHT, SHIFT, number]))[-1])
        values.append(float(match.values[number]))
        weights.append(1.0 / max(sigma, 1e-3 * usual[1]) ** 2)
    value, weight = np.array(values), np.array(weights)
    if len(value) > 1:
        middle = float(weight @ value / weight.sum())
        weight /= max(1.0, float(weight @ (value - middle) ** 2) / (len(value) - 1.0))
    value, weight = np.append(value, usual[0]), np.append(weight, usual[1] ** -2.0)
    return float(weight @ value / weight.sum()), float(weight.sum() ** -0.5)


def _with(kinds: Kinds, number: int, value: float, free: list[int]) -> Kinds:
    """Fit kinds again with a number that is known."""
    out: Kinds = {}
    for kind, (model, blocks, match) in kinds.items():
        start = match.values.copy()
        start[number] = value
        again = model.fit(blocks.sum(axis=0), start, free)
        if again is not None:
            out[kind] = model, blocks, again
    return out


def _models(
    scene: Scene,
    views: DoubleViews,
    cell: NDArray[np.int64],
    weight: NDArray[np.float64],
    reach: int,
    reach_mm: float,
) -> list[Model]:
    """Predicted correlation planes of cells by layers; some places of each are enough."""
    chosen = some_of_each(cell, max(MODELLED // (int(cell.max()) + 1), LEAST_MODELLED))
    some, cells = views.at(chosen), cell[chosen]
    planes = []
    for size in SIZES:
        bells = layers(scene, some, reach_mm, size)
        bells = replace(bells, light=bells.light * weight[chosen][:, None])
        planes.append(bells.planes(some, views.units()[chosen], cells, reach))
    return [Model(bells.height_mm, *both) for both in zip(*planes, strict=True)]


def _even(found: NDArray[np.float64], here: NDArray[np.int64], places: NDArray[np.int64]) -> None:
    """Let sigmas of the cells of a kind learn from each other: ten parts of the frames tell one to a quarter only.

    Half of each variance is its own, half what a place of this kind usually costs.
    """
    known = here[np.isfinite(found[here]).all(axis=1)]
    if len(known):
        usual = np.median(found[known, 2:] ** 2 * places[known, None], axis=0) / places[known, None]
        found[known, 2:] = np.sqrt(0.5 * (found[known, 2:] ** 2 + usual))
