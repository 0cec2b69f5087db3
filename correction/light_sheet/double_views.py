"""Places of the light sheet that the camera sees twice: directly and through glass, or through it in two ways.

If the sheet lies dz before the plane that a map was made for, a particle at X is found at X - p dz, with p = dX/dz
of the pixel that shows it.  Two views a and b of one place have different p: what is found at X in view a is found
at X + D dz in view b,

    D = p_a - p_b.

This *disparity* is zero if the map is made for the plane in which the particles are.  It is measured along D;
across D no height moves anything, so what is found there belongs to glass that is not where the scene has it.

A view counts where it can be followed: HALF_PICTURE_PX raw pixels to either side along D it must still be the same
branch on the same side of a fold, and nearly straight.  So no rim cuts the picture of a particle.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import MAX_MAGNIFICATION, CorrectionMap, build_correction_map
from tracer.scene.scene import Scene
from tracer.strategies.blur import pupil_views
from tracer.strategies.branches import Branch
from tracer.strategies.ray_map import RayMap, build_ray_map
from tracer.strategies.sensitivity import TARGET, landings
from tracer.strategies.trace import trace

Kind = tuple[int, int, bool, bool]  # branches of two views, and whether each shows the plane unmirrored

MAX_BRANCHES = 4
MIN_VIEW_MAGNIFICATION = 0.2
HALF_PICTURE_PX = 1.5  # half the picture of a particle
MIN_ALONG_STEP = 0.5  # of that step on the plane
MIN_SEPARATION_PX = 8.0  # of two pictures of one place on the sensor: closer ones are one picture
LEAST_PARALLAX = 0.02  # |D|: 0.02 mm for a millimetre of height
PARTICLE_PX2 = 0.7  # variance of a picture of 2.4 px, and of the bell that it is looked up with
ACROSS, AROUND = 3, 4  # lags to either side: across D; along it, about a peak
UNIT = 0.8  # of the standard deviation that two such pictures make of a peak
MAX_APERTURE_BLUR_PX = 3.0  # blur by the aperture, standard deviation
MOST_LOST = 0.05


@dataclass(frozen=True)
class DoubleViews:
    """Places seen twice.

    Parameters
    ----------
    place_mm : (N, 2) float64
        On the plane.
    first_px, second_px : (N, 2) float64
        Raw pixels u, v of the two views; where the scene has an aperture, of their centroids.
    along_px, across_px : (N, 2) float64
        What the second pixel moves by for a step of one corrected pixel along D, and across it.
    towards : (N, 2) float64
        Direction of D on the plane, x and y.
    parallax : (N,) float64
        |D| [mm on the plane per mm of height].
    blob : (N, 2) float64
        What the two views make of a variance of 1 px^2 on the sensor, along and across D [corrected px^2], summed.
    smear : (N, 2) float64
        Variances by the aperture, along and across D [corrected px^2], summed over the two views.
    chief_px : (N, 2, 2) float64
        Pixels u, v of the chief rays of the two views.
    spread_px2 : (N, 2, 2, 2) float64
        Covariance of a point's picture by the aperture in the two views.
    alone_px : (N,) float64
        Distance on the sensor from the second picture to the nearest other one of the same place.
    kind : (N,) int64
        Index into `kinds`.
    kinds : tuple of (Branch, Branch)
        Branches of the first and of the second view; one side of a fold is another kind than the other.
    pitch_mm : float
        A corrected pixel.
    step : int
        Every how many corrected pixels there is a place.
    area_mm2 : float
        Area that is seen twice; a place seen in three ways counts three times.
    """

    place_mm: NDArray[np.float64]
    first_px: NDArray[np.float64]
    second_px: NDArray[np.float64]
    along_px: NDArray[np.float64]
    across_px: NDArray[np.float64]
    towards: NDArray[np.float64]
    parallax: NDArray[np.float64]
    blob: NDArray[np.float64]
    smear: NDArray[np.float64]
    chief_px: NDArray[np.float64]
    spread_px2: NDArray[np.float64]
    alone_px: NDArray[np.float64]
    kind: NDArray[np.int64]
    kinds: tuple[tuple[Branch, Branch], ...]
    pitch_mm: float
    step: int = 1
    area_mm2: float = 0.0

    def units(self) -> NDArray[np.float64]:
        """Lags (N, 2), along and across [corrected px], worth a share of a particle's picture, one for a kind."""
        out = np.ones((len(self.kind), 2))
        for kind in np.unique(self.kind):
            here = self.kind == kind
            out[here] = UNIT * np.sqrt(np.median(PARTICLE_PX2 * self.blob[here] + self.smear[here], axis=0))
        return out

    def room_px(self, reach: int) -> NDArray[np.float64]:
        """Reach (N, 2) along u and v, from the second pixel, of lags of `reach` along and ACROSS."""
        units = self.units()
        return np.asarray(
            np.abs(self.along_px) * units[:, :1] * reach + np.abs(self.across_px) * units[:, 1:] * ACROSS
        )

    def free(self, reach: int) -> NDArray[np.bool_]:
        """Places (N,) of which no lag reaches another picture of the same particle."""
        return np.asarray(self.alone_px > np.hypot(*self.room_px(reach).T) + 2.0 * HALF_PICTURE_PX)

    def at(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> "DoubleViews":
        """Return some of them."""
        parts: dict[str, Any] = {
            name: value[chosen] for name, value in vars(self).items() if isinstance(value, np.ndarray)
        }
        return replace(self, **parts)


def double_views(
    scene: Scene, ray_map: RayMap | None = None, step: int = 1, most: int | None = None
) -> DoubleViews:
    """Find what is seen twice of the plane z = 0 of a scene (`Scene.in_light_sheet` comes first).

    Parameters
    ----------
    scene : Scene
        The scene.
    ray_map : RayMap, optional
        Its ray map, if it is at hand.
    step : int
        Every how many corrected pixels to look.
    most : int, optional
        Draw so many of the places, if there are more.
    """
    ray_map = ray_map or build_ray_map(scene)
    whole = grid_of(scene.camera)
    rows, columns = (-(-size // step) for size in whole.shape)
    grid = PlaneGrid(whole.origin_mm, whole.pitch_mm * step, (rows, columns))
    limits = MIN_VIEW_MAGNIFICATION * step, MAX_MAGNIFICATION * step
    found = build_correction_map(
        scene,
        ray_map,
        grid,
        layers=MAX_BRANCHES,
        skip=False,
        min_magnification=limits[0],
        max_magnification=limits[1],
    )
    seen = (found.weight > 0.0) & found.recovered
    kinds: dict[Kind, int] = {}
    pairs = [
        _of_layers(scene, found, step, (one, two), np.nonzero(seen[one] & seen[two]), kinds)
        for one in range(MAX_BRANCHES)
        for two in range(one + 1, MAX_BRANCHES)
    ]
    pair = _Pair(*(np.concatenate(column) for column in zip(*pairs, strict=True)))
    count, area_mm2 = len(pair.kind), len(pair.kind) * (step * whole.pitch_mm) ** 2
    if most is not None and count > most:
        drawn = np.sort(np.random.default_rng(0).choice(count, most, replace=False))
        pair = pair.at(drawn)
    ways = tuple((found.branches[one], found.branches[two]) for one, two, *_ in kinds)
    return _with_pictures(scene, pair, ways, area_mm2, whole.pitch_mm, step)


class _Pair(NamedTuple):
    """Two views (axis 1, where there is one) of N places."""

    place_mm: NDArray[np.float64]
    pixel: NDArray[np.float64]  # (N, 2, 2)
    rate: NDArray[np.float64]  # (N, 2, 2, 2) pixels by a corrected pixel
    along: NDArray[np.float64]
    parallax: NDArray[np.float64]
    alone: NDArray[np.float64]
    kind: NDArray[np.int64]

    def at(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> "_Pair":
        parts: list[Any] = [column[chosen] for column in self]
        return _Pair(*parts)


def _of_layers(
    scene: Scene,
    found: CorrectionMap,
    step: int,
    layers: tuple[int, int],
    at: tuple[NDArray[np.int64], ...],
    kinds: dict[Kind, int],
) -> _Pair:
    """Places seen in two layers of a map that can be followed in both."""
    pixels = [found.pixel[layer][at] for layer in layers]
    rates = [found.jacobian[layer][at].reshape(-1, 2, 2).astype(np.float64) / step for layer in layers]
    pitch_mm = found.grid.pitch_mm / step
    slopes = [landings(scene, pixel).rate[:, :, TARGET.index("z") - len(TARGET)] for pixel in pixels]
    gap = slopes[0] - slopes[1]
    parallax = np.hypot(*gap.T)
    good = np.isfinite(parallax) & (parallax > LEAST_PARALLAX)
    others = [found.pixel[layer][at] for layer in range(MAX_BRANCHES) if layer != layers[1]]
    gaps = [np.hypot(*(pixels[1] - other).T) for other in others]
    alone = np.min([np.where(np.isfinite(away), away, np.inf) for away in gaps], axis=0)
    good &= alone > MIN_SEPARATION_PX
    with np.errstate(invalid="ignore", divide="ignore"):
        along = gap / parallax[:, None] * (1.0, -1.0)  # nodes run down, y runs up
    for pixel, rate in zip(pixels, rates, strict=True):
        good &= _goes_on(scene, pitch_mm, pixel, np.einsum("nij,nj->ni", rate, along), along)
    ways = [found.branch[layer][at].tolist() for layer in layers]
    sides = [(np.linalg.det(rate) > 0.0).tolist() for rate in rates]
    keys = zip(*ways, *sides, strict=True)
    kind = np.array([kinds.setdefault(key, len(kinds)) for key in keys], np.int64)
    both = np.stack(pixels, axis=1), np.stack(rates, axis=1)
    return _Pair(found.grid.nodes_mm()[at], *both, along, parallax, alone, kind).at(good)


def _with_pictures(
    scene: Scene,
    pair: _Pair,
    kinds: tuple[tuple[Branch, Branch], ...],
    area_mm2: float,
    pitch_mm: float,
    step: int,
) -> DoubleViews:
    """Return predicted pictures of particles in two views; places where a picture is too blurred are left out."""
    across = np.stack((-pair.along[:, 1], pair.along[:, 0]), axis=-1)
    shift, spread = np.zeros(pair.pixel.shape), np.zeros(pair.rate.shape)
    good = np.ones(len(pair.kind), bool)
    blob, smear = np.zeros((2, len(pair.kind), 2))
    for view in (0, 1):
        shift[:, view], spread[:, view], usable = _pictures(scene, pair.pixel[:, view])
        good &= usable
        back = np.linalg.pinv(pair.rate[:, view])
        for number, way in enumerate((pair.along, across)):
            seen = np.einsum("nji,nj->ni", back, way)
            blob[:, number] += np.sum(seen**2, axis=1)
            smear[:, number] += np.einsum("ni,nij,nj->n", seen, spread[:, view], seen)
    steps = [np.einsum("nij,nj->ni", pair.rate[:, 1], way) for way in (pair.along, across)]
    middle = pair.pixel + shift
    kept = area_mm2 * float(good.mean()) if len(good) else 0.0
    views = DoubleViews(
        pair.place_mm, middle[:, 0], middle[:, 1], steps[0], steps[1], pair.along * (1.0, -1.0), pair.parallax,
        blob, smear, pair.pixel, spread, pair.alone, pair.kind, kinds, pitch_mm, step, kept,
    )  # fmt: skip
    return views.at(good)


def some_of_each(cell: NDArray[np.int64], most: int) -> NDArray[np.bool_]:
    """Choose (N,) some `most` places of each cell, evenly from all of them."""
    order = np.argsort(cell, kind="stable")
    rank = np.empty(len(cell), np.int64)
    rank[order] = np.arange(len(cell)) - np.searchsorted(cell[order], cell[order])
    return np.asarray(rank % np.ceil(np.bincount(cell) / most).astype(np.int64)[cell] == 0)


def _goes_on(
    scene: Scene,
    pitch_mm: float,
    pixel: NDArray[np.float64],
    step: NDArray[np.float64],
    along: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return whether a view goes on HALF_PICTURE_PX to either side; `step` (N, 2) is d pixel for one `along`."""
    length = np.hypot(*step.T)
    here = trace(scene, pixel)
    good = here.recovered & (length > 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        aside = HALF_PICTURE_PX * step / length[:, None]
        wanted = HALF_PICTURE_PX / length[:, None] * along * (1.0, -1.0) * pitch_mm
    for way in (-1.0, 1.0):
        there = trace(scene, np.nan_to_num(pixel + way * aside))
        miss = there.plane_mm - here.plane_mm - way * wanted
        with np.errstate(invalid="ignore"):
            good &= there.recovered & (there.rays["key"] == here.rays["key"])
            good &= np.hypot(*miss.T) < MIN_ALONG_STEP * np.hypot(*wanted.T)
    return np.asarray(good)


def _pictures(
    scene: Scene, pixel: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Shift (N, 2) and spread (N, 2, 2) of pictures by the aperture, and where they are sharp enough."""
    pupil = scene.camera.pupil
    if pupil is None or not len(pixel):
        return np.zeros_like(pixel), np.zeros((len(pixel), 2, 2)), np.ones(len(pixel), bool)
    blur = pupil_views(scene, pupil, pixel).of_particles()
    with np.errstate(invalid="ignore"):
        usable = (blur.width_px <= MAX_APERTURE_BLUR_PX) & (blur.lost <= MOST_LOST)
    return np.nan_to_num(blur.shift_px), np.nan_to_num(blur.spread_px2), np.asarray(usable)
