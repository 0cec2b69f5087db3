"""Correlation of two views of particles in thin layers, and the layers that a correlation shows.

The particles that a pixel u of the first view shows lie on its ray: those of the layer at height z at X(u; z).
The second view shows them at the pixel U(X; z), found by Newton's method on traced rays, and as brightly as it is
large there, |det dU/dX|, and as the glass lets through.  Seen from a place of `double_views`, the pictures of a
layer are then a bell about some pixel of the second view.  Its middle, its covariance and its light are means
over four pixels of the first view, which stand for the picture of a particle there (two each way, sqrt(2)
standard deviations off: right to the third order).

So nothing is expanded in powers: views that bend, that fade towards a rim or end at it, and whose parallax changes
over the depth of the sheet are as the tracer has them.  Behind two balls these are worth 0.2 mm of height.

The model of a plane is

    background + light * sum over layers z of exp(-(z - height)^2 / (2 spread^2)) bells(z),

shifted by a free number of pixels perpendicular to D = p_a - p_b (`double_views`), which no height causes.  Bells
of pictures of other sizes than the two that were drawn are geometric means of these, as those of Gaussians are
Gaussians.  Background and light are linear, the rest is
found by least squares from the best of all heights; no peak has to stand out from what is beside it.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.light_sheet.double_views import ACROSS, DoubleViews
from correction.light_sheet.kernels.lagged import add_bells
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose, landings
from tracer.strategies.trace import trace

TRACED = 9  # heights; between them numbers go straight
FINE = 5  # heights to each of these steps
NEWTON = 3
SETTLED_LAG_PX = 0.05
ROOM = 2  # more lags to either side across D than measured: peaks may lie beside the middle
LEAST_MM, MOST_MM = 0.03, 0.8  # spread of the sheet's light
SIZES = (0.6, 1.2)  # variances of a picture [px^2] for which layers are drawn
SMALLEST, LARGEST = -0.3, 1.8  # share of the way between their inverses
LEAST_LIGHT = 1e-30
STEPS = np.array([0.02, 0.05, 0.01, 0.05])  # mm, lags, mm^2, share: differences for derivatives
TRIED_LAGS = (0, -1, 1, -2, 2)


@dataclass(frozen=True)
class Layers:
    """Bells that layers make in the second view of N places, for particles of one picture size.

    Parameters
    ----------
    height_mm : (L,) float64
        Heights over the plane, evenly spaced.
    offset_px : (N, L, 2) float64
        Middle of the bell minus the second pixel.
    spread_px2 : (N, L, 3) float64
        Its variance along u, along v, and their covariance.
    light : (N, L) float64
        Its light; 0 where the second view does not show the layer.
    """

    height_mm: NDArray[np.float64]
    offset_px: NDArray[np.float64]
    spread_px2: NDArray[np.float64]
    light: NDArray[np.float64]

    def planes(
        self, views: DoubleViews, units: NDArray[np.float64], cell: NDArray[np.int64], reach: int
    ) -> NDArray[np.float64]:
        """Planes of lags (C, L, 2 reach + 1, 2 (ACROSS + ROOM) + 1) of layers, means over the places of cells."""
        cells = int(cell.max()) + 1
        out = np.zeros((cells, len(self.height_mm), 2 * reach + 1, 2 * (ACROSS + ROOM) + 1))
        steps = views.along_px * units[:, :1], views.across_px * units[:, 1:]
        add_bells(self.offset_px, self.spread_px2, self.light, *steps, cell, out)
        return np.asarray(out / np.maximum(np.bincount(cell, minlength=cells), 1)[:, None, None, None])


def layers(scene: Scene, views: DoubleViews, reach_mm: float, particle_px2: float) -> Layers:
    """Find the bells of layers up to `reach_mm` over and under the plane z = 0 of a scene.

    Parameters
    ----------
    scene : Scene
        That of the views.
    views : DoubleViews
        Places seen twice.
    reach_mm : float
        Farthest height.
    particle_px2 : float
        Variance of the picture of a particle on the sensor, without what the aperture makes of it.
    """
    heights = np.linspace(-reach_mm, reach_mm, TRACED)
    count = len(views.kind)
    # Four pixels stand for the picture of a particle in the first view.
    own = np.eye(2) * particle_px2 + views.spread_px2  # (N, 2 views, 2, 2)
    values, vectors = np.linalg.eigh(own[:, 0])
    arms = np.sqrt(2.0 * values)[:, None, :] * vectors
    around = np.stack([way * arms[:, :, k] for k in (0, 1) for way in (-1.0, 1.0)])  # (4, N, 2)
    first = (views.chief_px[:, 0] + around).reshape(-1, 2)
    # Their rays take the branch of the chief ray, in both views, or do not count.
    chief = trace(scene, views.chief_px.reshape(-1, 2)).rays["key"].reshape(count, 2)
    keys = np.tile(chief, (4, 1))
    start = np.tile(views.chief_px[:, 1], (4, 1))
    side = np.sign(np.linalg.det(landings(scene, start).pixel_rate))
    through = trace(scene, first).rays
    passed = np.where(through["key"] == keys[:, 0], through["transmittance"], 0.0)
    found, light = np.full((TRACED, 4 * count, 2), np.nan), np.zeros((TRACED, 4 * count))
    middle = TRACED // 2
    # From the plane outwards to either side, as Newton's method starts where the heights before it point.
    for order in (range(middle, TRACED), range(middle, -1, -1)):
        guess, before = start, None
        for number in order:
            pose = TargetPose((0.0, 0.0, float(heights[number])))
            wanted = landings(scene, first, pose)
            at, rate, good = _pixels_of(scene, pose, wanted.point_mm, guess, keys[:, 1])
            shown = trace(scene, np.nan_to_num(at)).rays["transmittance"]
            with np.errstate(invalid="ignore", divide="ignore"):
                large = 1.0 / np.linalg.det(rate)
            good &= (np.sign(large) == side) & np.isfinite(large) & (passed > 0.0)
            found[number] = np.where(good[:, None], at, np.nan)
            light[number] = np.where(good, np.abs(large) * shown * passed, 0.0)
            ahead = at if before is None else 2.0 * at - before
            before, guess = at, np.where(good[:, None], ahead, guess)
    # A bell has the mean and covariance of the four, each weighed by its light.
    offset = np.nan_to_num(found.reshape(TRACED, 4, count, 2) - views.chief_px[:, 1])
    share = light.reshape(TRACED, 4, count)
    total = share.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.nan_to_num(share / total[:, None])
    mean = np.einsum("lkn,lkni->nli", share, offset)
    off = offset - mean.transpose(1, 0, 2)[:, None]
    spread = np.einsum("lkn,lkni,lknj->nlij", share, off, off) + own[:, None, 1]
    packed = np.stack((spread[..., 0, 0], spread[..., 1, 1], spread[..., 0, 1]), axis=-1)
    return _finer(Layers(heights, mean, packed, total.T / 4.0))


def _pixels_of(
    scene: Scene, pose: TargetPose, point: NDArray[np.float64], start: NDArray[np.float64], key: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Pixels (N, 2) of a branch that show points of a plane, d point / d pixel, and where it was found."""
    at = start.copy()
    for _ in range(NEWTON):
        seen = landings(scene, at, pose)
        with np.errstate(invalid="ignore"):
            step = np.einsum("nij,nj->ni", np.linalg.pinv(np.nan_to_num(seen.pixel_rate)), point - seen.point_mm)
        at = at + np.clip(np.nan_to_num(step), -4.0, 4.0)
    with np.errstate(invalid="ignore"):
        good = seen.recovered & (seen.key == key) & (np.abs(step) < SETTLED_LAG_PX).all(axis=1)
    return at, seen.pixel_rate, np.asarray(good)


def _finer(coarse: Layers) -> Layers:
    """More heights between those traced: cubic where four around are seen, straight where two are.

    What is seen at one of two heights only is not half seen.
    """
    lit = coarse.light > 0.0
    heights: list[float] = []
    parts: list[list[NDArray[np.float64]]] = [[], [], []]
    for low, high in pairwise(range(TRACED)):
        below, above = max(low - 1, 0), min(high + 1, TRACED - 1)
        all_four = lit[:, [below, low, high, above]].all(axis=1) & (above - below == 3)
        both = lit[:, low] & lit[:, high]
        for t in np.arange(FINE) / FINE:
            heights.append(float((1.0 - t) * coarse.height_mm[low] + t * coarse.height_mm[high]))
            near = low if t < 0.5 else high
            cubic = (
                -t * (t - 1.0) * (t - 2.0) / 6.0,
                (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
                -(t + 1.0) * t * (t - 2.0) / 2.0,
                (t + 1.0) * t * (t - 1.0) / 6.0,
            )
            for part, values in zip(parts, (coarse.offset_px, coarse.spread_px2, coarse.light), strict=True):
                shape = (-1, *[1] * (values.ndim - 2))
                straight = (1.0 - t) * values[:, low] + t * values[:, high]
                around = zip(cubic, (below, low, high, above), strict=True)
                bent = sum((share * values[:, one] for share, one in around), np.zeros_like(straight))
                between = np.where(all_four.reshape(shape), bent, straight)
                part.append(np.where(both.reshape(shape), between, values[:, near]))
    for part, values in zip(parts, (coarse.offset_px, coarse.spread_px2, coarse.light), strict=True):
        part.append(values[:, -1])
    offset, spread, light = (np.stack(part, axis=1) for part in parts)
    return Layers(np.array([*heights, coarse.height_mm[-1]]), offset, spread, np.maximum(light, 0.0))


@dataclass(frozen=True)
class Match:
    """Fit of layers to a correlation plane.

    Parameters
    ----------
    values : (4,) float64
        Height [mm], shift across D [lags], variance of the sheet's light [mm^2], picture size (share of `SIZES`).
    light : float
        Factor of the bells.
    """

    values: NDArray[np.float64]
    light: float


class Model:
    """Bells of layers for the plane of some cells.

    Parameters
    ----------
    height_mm : (L,) float64
        Of the layers.
    small, large : (L, R, K + 2 ROOM) float64
        Their planes for pictures of the two `SIZES`.
    """

    def __init__(
        self, height_mm: NDArray[np.float64], small: NDArray[np.float64], large: NDArray[np.float64]
    ) -> None:
        self.height_mm = height_mm
        self.small, self.large = small, large

    def plane(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Plane (R * K,) of a sheet."""
        height, shift, spread2, size = values
        weight = np.exp(-0.5 * (self.height_mm - height) ** 2 / max(spread2, LEAST_MM**2))
        weight /= weight.sum()
        small, large = (np.tensordot(weight, part, axes=1) + LEAST_LIGHT for part in (self.small, self.large))
        bells = small * (large / small) ** size
        moved = scipy.ndimage.shift(bells, (0.0, shift), order=3, mode="nearest") if shift else bells
        return np.asarray(moved[:, ROOM:-ROOM].ravel())

    def rates(self, values: NDArray[np.float64], chosen: list[int]) -> NDArray[np.float64]:
        """Derivatives (len(chosen), R * K) of the plane."""
        out = []
        for number in chosen:
            step = np.zeros(4)
            step[number] = STEPS[number]
            out.append((self.plane(values + step) - self.plane(values - step)) / (2.0 * STEPS[number]))
        return np.array(out)

    def start(self, plane: NDArray[np.float64], spread2: float) -> NDArray[np.float64] | None:
        """The best of all heights and of some shifts; None if nothing fits with light."""
        best, least = None, np.inf
        for shift in TRIED_LAGS:
            for height in self.height_mm[2:-2:2]:
                values = np.array([height, float(shift), spread2, 0.45])
                bell = self.plane(values)
                spread = bell - bell.mean()
                power = float(spread @ spread)
                light = float(spread @ plane) / power if power > 0.0 else 0.0
                left = -light * light * power
                if light > 0.0 and left < least:
                    best, least = values, left
        return best

    def fit(self, plane: NDArray[np.float64], start: NDArray[np.float64], free: list[int]) -> Match | None:
        """Fit the free ones of the four numbers; None if the plane holds no light of particles."""
        size = float(plane.std())
        if size == 0.0:
            return None
        low = np.array([self.height_mm[0], -ROOM, LEAST_MM**2, SMALLEST])[free]
        high = np.array([self.height_mm[-1], ROOM, MOST_MM**2, LARGEST])[free]

        def solve(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
            values = start.copy()
            values[free] = x
            bell = self.plane(values)
            spread = bell - bell.mean()
            light = float(spread @ plane) / max(float(spread @ spread), 1e-300)
            return plane - plane.mean() - light * spread, light

        first = np.clip(start[free], low + 1e-9, high - 1e-9)
        answer = scipy.optimize.least_squares(
            lambda x: solve(x)[0] / size, first, bounds=(low, high), x_scale=STEPS[free], max_nfev=30
        ).x
        values = start.copy()
        values[free] = answer
        light = solve(answer)[1]
        inside = self.height_mm[2] < values[0] < self.height_mm[-3]
        return Match(values, light) if light > 0.0 and inside else None

    def number_sigmas(self, blocks: NDArray[np.float64], match: Match, free: list[int]) -> NDArray[np.float64]:
        """Standard deviations (2, len(free)) of the numbers: by chance, and by what the model does not explain.

        Chance is estimated by leaving blocks (B, R * K) out one by one.  Where the model leaves more of the plane
        than blocks differ by, the rest is taken to lie as chance does, and moves numbers by so many times more.
        """
        count = len(blocks)
        design = self._design(match, free)
        whole = blocks.sum(axis=0)
        left = (whole - blocks) * count / (count - 1.0)
        answers = _least_squares(design, left.T)
        steps = answers[2:]
        variance = (count - 1.0) / count * np.sum((steps - steps.mean(axis=1)[:, None]) ** 2, axis=1)
        chance = count * blocks.var(axis=0, ddof=1).sum()
        off = whole - design @ _least_squares(design, whole)
        more = max(0.0, float(off @ off) / max(float(chance), 1e-300) - 1.0)
        return np.asarray(np.sqrt(np.stack((variance, more * variance))), np.float64)

    def beside(self, plane: NDArray[np.float64], match: Match, free: list[int]) -> NDArray[np.float64]:
        """Numbers (4,) of a `Match`, one step from that of many planes, whose light this plane is taken to have.

        The step is linear in the plane, so noise draws its numbers to no side, however faint the plane is.
        """
        values = match.values.copy()
        values[free] += _least_squares(self._design(match, free), plane)[2:]
        return values

    def _design(self, match: Match, free: list[int]) -> NDArray[np.float64]:
        """Derivatives of the plane (R * K, 2 + len(free)) by background, light and the numbers."""
        bell = self.plane(match.values)
        return np.column_stack((np.ones_like(bell), bell, *(match.light * self.rates(match.values, free))))

    def offset(self, spread2: float, size: float) -> float:
        """Lags along D by which bend and fading alone move the peak of a sheet at height 0."""
        bell = self.plane(np.array([0.0, 0.0, spread2, size])).reshape(self.small.shape[1], -1)
        weight = np.square(bell).sum(axis=1)
        lags = np.arange(len(weight)) - len(weight) // 2
        return float(weight @ lags / max(float(weight.sum()), 1e-300))

    def clearness(self, blocks: NDArray[np.float64], match: Match) -> float:
        """By how many standard deviations, from the blocks (B, R * K), the light stands out."""
        bell = self.plane(match.values)
        spread = bell - bell.mean()
        lights = blocks @ spread
        return float(lights.mean() / max(float(lights.std(ddof=1)), 1e-300) * np.sqrt(len(lights)))


def _least_squares(design: NDArray[np.float64], planes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least squares; columns of a design may differ by powers of ten."""
    norm = np.sqrt(np.sum(design**2, axis=0))
    norm[norm == 0.0] = 1.0
    answer = np.linalg.lstsq(design / norm, planes, rcond=1e-9)[0]
    return np.asarray(answer / (norm if planes.ndim == 1 else norm[:, None]), np.float64)
