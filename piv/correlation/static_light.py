"""Light that stands still behind a slow flow, measured by what of two frames is free of it.

A static texture S that is as coarse as particle images draws vectors towards zero without any of them looking
wrong. Of the transforms A = S + P exp(iq/2) and B = S + P exp(-iq/2) of a window, where particles P move by d and
q = k d is their phase,

    |A - B|^2/2 = (1 - cos q) |P|^2 + C,        Im(A B*) = sin q |P|^2 + chance

hold no S: their ratio tells q, hence d, whatever stands still. C, of noise and of particles without a partner,
is the same for all waves of one length, so that only its rise along the flow counts: |P|^2 and C are fitted to
rings of wave numbers, over windows of all the frame. The factor of all vectors at which both equations agree best
is their *stretch*: 1 without static light (0.97 to 1.02 in flows before nothing; less if images are long in the
direction of the flow), 1.3 where they are 23 % too short. Waves along rows and columns do not count, since sensors
make those of their own. What is common to all frames of a series is better taken off beforehand.

If vectors are too short, waves in which S is strong are damped (Wiener): |P|^2/(|P|^2 + |S|^2), where |S|^2 is
what is left of Re(A B*). That removes lines, and textures of another grain than that of the particles. What is
left of the stretch then goes onto the vectors, and into their uncertainty: windows hold more of S, or less.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.common_light import Known
from piv.correlation.planes import fill_gaps
from piv.correlation.prepare import Pair, prepare_pair
from piv.correlation.taken_out import without_vectors
from piv.correlation.vector_field import RESOLUTION_LENGTHS, VectorField, VectorFlag
from piv.correlation.windows import WindowGrid
from piv.errors import PairError

Floats = NDArray[np.float64]
# Of the windows that are transformed
SIDE_PX = 32
STEP_PX = 16
MOST_WINDOWS = 400
MOST_ASKED = 1600  # whether they are whole, and move as one
FEWEST_WINDOWS = 24
LEAST_MOVED_PX, MOVING_SHARE = 0.15, 0.4  # vectors that are shorter are noise; of the windows, that are not
# Wave numbers [1/px] that particle images hold, and width of their rings
LOWEST = 0.3
HIGHEST = 1.9
RING = 0.16
LARGEST_PHASE = 2.5  # of a wave: a longer way repeats itself
UNEVEN_PX, UNEVEN_SHARE = (0.1, 1.0), 0.5  # change of vectors within a window, beyond which it has not one
PLACES = 30  # waves that a ring needs
INDEPENDENT = 0.35  # share of the waves of overlapping windows that are independent
STRETCHES = np.exp(np.linspace(np.log(0.7), np.log(6.0), 44))
STRAIGHT, INCLINED, LINE_WAVES = (
    np.arange(2),
    np.arange(3, 5),
    np.arange(3, 10),
)  # numbers of waves across and along
LINES_OVER = 30.0  # times the power of inclined waves that stands still
LEAST_LINES = 0.3  # of that which moves
# Evidence: twice the logarithm of the likelihood over that of 1
LEAST_STRETCH = 1.05
LEAST_EVIDENCE = 12.0
LEAST_STILL = 0.2  # of the power of waves; flows before nothing have 0.01 to 0.08, of long images up to 0.16
# With more, some windows show the texture and others the flow
MOST_STRETCH = 1.25
MOST_ADDED_PX = 0.3
NEAR_VECTORS = 5  # vectors along each side whose longest is what static light takes a share of
# Side of a block, and how many along each side of a frame
BLOCK_PX = 96
BLOCKS = 4
BLOCK_SPREAD_PX = 0.3  # of the vectors in it, from their lowest to their highest tenth
_LENGTHS, _ANGLES = np.geomspace(0.3, 5.0, 12)[:, None], np.arange(16) * (np.pi / 8)
TRIALS_PX = np.stack((_LENGTHS * np.cos(_ANGLES), _LENGTHS * np.sin(_ANGLES)), axis=-1).reshape(-1, 2)
# By which a displacement exceeds the vector; evidence for it; and share of the blocks
LONGER = 1.8
LONGER_PX = 0.15
HIDDEN_EVIDENCE = 30.0
HIDDEN_SHARE, HIDDEN_BLOCKS = 0.2, 2  # of the blocks; a single one among several may be chance
ONE_WAY_MEAN = (
    15.0  # more evidence for a displacement than for its opposite; fluids at rest have 13, with JPEG too
)
LEAST_KEPT = 0.9  # of the valid vectors
STRETCH_LEFT = 0.2  # of a stretch before waves were damped: how well vectors are known afterwards


class Waves(NamedTuple):
    """Transforms (n, modes) of windows of frames A and B, over their power; vectors (n, 2) [px]; wave numbers."""

    a: NDArray[np.complex64]
    b: NDArray[np.complex64]
    vectors_px: NDArray[np.float32]
    ky: NDArray[np.float32]
    kx: NDArray[np.float32]


class Stretch(NamedTuple):
    """Factor by which vectors are too short, share of the power that stands still, and the windows that show them.

    `is_static` says whether light stands still before the flow.
    """

    factor: float
    share: float
    waves: Waves | None
    is_static: bool


def stretch_of(pair: Pair, known: Known) -> Stretch | None:
    """Measure by how much vectors are too short for what moves; None if that is not known.

    The factor is infinite where displacements far longer than vectors explain the frames far better.

    Parameters
    ----------
    pair : Pair
        Frames as they were levelled.
    known : Known
        What the pair shows as it is: vectors that are believed, and NaN.
    """
    waves = _waves(pair, known)
    found = None if waves is None else _fit_stretch(waves)
    is_short = found is not None and found.factor > MOST_STRETCH
    if not is_short and _hides_flow(pair, known):
        return Stretch(float("inf"), 1.0, None, True)
    return found


def _fit_stretch(waves: Waves) -> Stretch:
    """Find the stretch of most likelihood."""
    asked, factor, is_short = _particle_waves(waves), 1.0, False
    rings = _Rings(waves, asked)
    as_it_is = rings.power(1.0)[1]
    # Most pairs have no more: a small stretch already makes them less likely.
    if rings.power(LEAST_STRETCH)[1] < as_it_is:
        misfit = np.array([rings.power(stretch)[1] for stretch in STRETCHES])
        place = int(np.clip(np.argmin(misfit), 1, len(misfit) - 2))
        before, least, after = misfit[place - 1 : place + 2]
        offset = 0.5 * (before - after) / max(before - 2.0 * least + after, 1e-12)
        factor = float(STRETCHES[place] * (STRETCHES[1] / STRETCHES[0]) ** np.clip(offset, -1.0, 1.0))
        is_short = bool(factor > LEAST_STRETCH and as_it_is - least > LEAST_EVIDENCE)
    moving, still = _powers(waves, factor)
    share = float(still[asked].sum() / max((moving + still)[asked].sum(), 1e-30))
    return Stretch(factor, share, waves, is_short or share > LEAST_STILL or _has_lines(moving, still))


def _hides_flow(pair: Pair, known: Known) -> bool:
    """Return whether displacements far longer than its vectors explain blocks of a pair far better."""
    found = []
    first = [
        np.linspace(0, side - BLOCK_PX, min(side // BLOCK_PX, BLOCKS)).astype(np.int64) for side in pair.a.shape
    ]
    inside = np.arange(0, BLOCK_PX - SIDE_PX + 1, STEP_PX)
    windows = np.stack(np.meshgrid(inside, inside, indexing="ij"), axis=-1).reshape(-1, 2)
    for row, column in np.stack(np.meshgrid(*first, indexing="ij"), axis=-1).reshape(-1, 2):
        if pair.valid[row : row + BLOCK_PX, column : column + BLOCK_PX].min() == 0.0:
            continue
        within = (
            (nodes > start) & (nodes < start + BLOCK_PX)
            for nodes, start in ((known.grid.y_px, row), (known.grid.x_px, column))
        )
        vectors = known.vectors_px[np.ix_(*within)].reshape(-1, 2)
        vectors = vectors[np.isfinite(vectors).all(axis=-1)]
        vector = np.median(vectors, axis=0) if len(vectors) else np.full(2, np.nan)
        length_px = float(np.linalg.norm(vector))
        spread_px = np.ptp(np.quantile(vectors, (0.1, 0.9), axis=0), axis=0).max() if len(vectors) else np.inf
        # Beside a jet the fluid at rest has a far longer vector within the block as well.
        if not spread_px <= BLOCK_SPREAD_PX + UNEVEN_SHARE * length_px:
            found.append((0.0, 0.0))
            continue
        waves = _transform(pair, windows + np.array((row, column)), np.zeros((len(windows), 2)))
        misfit = _Rings(waves, _particle_waves(waves), np.array((vector, *TRIALS_PX))).power(1.0)[1]
        gain = (misfit[0] - misfit[1:]).reshape(len(_LENGTHS), len(_ANGLES))
        is_long = LONGER * length_px + LONGER_PX < _LENGTHS
        # Coloured noise, as JPEG leaves it, speaks for a displacement as much as for its opposite.
        one_way = gain - np.maximum(np.roll(gain, len(_ANGLES) // 2, axis=1), 0.0)
        best = gain.max() if is_long[np.argmax(gain.max(axis=1))] else 0.0
        found.append((best, np.max(one_way, where=is_long, initial=0.0)))
    evidence = np.array(found).reshape(-1, 2)
    sure = np.count_nonzero(evidence[:, 0] > HIDDEN_EVIDENCE)
    is_sure = sure >= max(min(HIDDEN_BLOCKS, len(found)), HIDDEN_SHARE * len(found), 1)
    return bool(is_sure or (len(found) >= HIDDEN_BLOCKS and evidence[:, 1].mean() > ONE_WAY_MEAN))


def without_static_waves(pair: Pair, stretch: Stretch) -> Pair | None:
    """Damp the waves in which a texture stands still; None if nothing is left."""
    import cv2

    if stretch.waves is None:
        return None
    moving, still = _powers(stretch.waves, stretch.factor)
    gain = np.divide(moving, moving + still, out=np.ones_like(moving), where=moving + still > 0.0)
    gain = scipy.ndimage.gaussian_filter(gain, 0.5, mode="nearest")
    kernel = np.fft.fftshift(np.fft.irfft2(gain, (SIDE_PX, SIDE_PX)))[1:, 1:]  # odd, so that it moves nothing
    a, b = (
        np.asarray(cv2.filter2D(part, -1, kernel.astype(np.float32), borderType=cv2.BORDER_REFLECT))
        for part in (pair.a, pair.b)
    )
    try:
        return replace(prepare_pair(a, b, pair.valid > 0.0, SIDE_PX), given=pair.given)
    except PairError:
        return None


def stretch_vectors(field: VectorField, damped: VectorField | None) -> VectorField:
    """Return vectors of a pair as it is or of its damped waves, stretched; none if they are too short.

    Parameters
    ----------
    field, damped : VectorField
        Vectors as they were measured, whose `stretch` is known; None if waves could not be damped.
    """
    hidden = abs(field.stretch - 1.0)
    if damped is not None and damped.valid_share > LEAST_KEPT * field.valid_share:
        short, left = (abs(np.log(each.stretch)) for each in (field, damped))
        field = (
            replace(damped, static_share=field.static_share, nan_pixels=field.nan_pixels)
            if left <= short
            else field
        )
    if field.stretch > MOST_STRETCH:
        return without_vectors(field, field.valid, VectorFlag.REJECTED)
    # Where windows hold more of the texture than elsewhere, vectors are shorter still: those around them tell.
    length_px = np.where(field.valid, np.hypot(field.u_px, field.v_px), 0.0)
    share = max(abs(field.stretch - 1.0), STRETCH_LEFT * hidden)
    added_px = share * scipy.ndimage.maximum_filter(length_px, NEAR_VECTORS)
    lengths = field.lengths
    more: dict[str, Any] = {
        name: np.hypot(lengths[name], added_px) for name in RESOLUTION_LENGTHS if name in lengths
    }
    if "unfiltered_px" in lengths:
        more["unfiltered_px"] = lengths["unfiltered_px"] * field.stretch
    field = replace(field, u_px=field.u_px * field.stretch, v_px=field.v_px * field.stretch, **more)
    return without_vectors(field, field.valid & (added_px > MOST_ADDED_PX), VectorFlag.REJECTED)


def _waves(pair: Pair, known: Known) -> Waves | None:
    """Transform windows that hold light only, and one displacement; None if they are too few."""
    good = np.asarray(np.isfinite(known.vectors_px).all(axis=-1))
    if min(pair.a.shape) < 2 * SIDE_PX or not good.any():
        return None
    first = [np.arange(0, side - SIDE_PX + 1, STEP_PX) for side in pair.a.shape]
    places = np.stack(np.meshgrid(*first, indexing="ij"), axis=-1).reshape(-1, 2)
    places = places[:: -(-len(places) // MOST_ASKED)]
    middle = places + (SIDE_PX - 1) / 2
    filled = fill_gaps(known.vectors_px, good)[0]
    values = np.concatenate((filled, good[..., None].astype(np.float64)), axis=-1)
    corners = np.stack([_between(known.grid, values, middle + SIDE_PX / 3 * np.array(way)) for way in _CORNERS])
    vectors, measured = _between(known.grid, values, middle)[:, :2], corners[..., 2].min(axis=0)
    change_px = np.ptp(corners[..., :2], axis=0).max(axis=-1)
    even = change_px < np.minimum(UNEVEN_PX[0] + UNEVEN_SHARE * np.linalg.norm(vectors, axis=-1), UNEVEN_PX[1])
    whole = np.array(
        [pair.valid[row : row + SIDE_PX, column : column + SIDE_PX].min() > 0.0 for row, column in places]
    )
    moves = np.linalg.norm(vectors, axis=-1) > LEAST_MOVED_PX
    usable = np.flatnonzero(even & whole & (measured > 0.5))
    moving = usable[moves[usable]]
    if len(moving) < max(FEWEST_WINDOWS, MOVING_SHARE * len(usable)):
        return None
    moving = moving[:: -(-len(moving) // MOST_WINDOWS)]
    return _transform(pair, places[moving], vectors[moving])


def _transform(pair: Pair, places: NDArray[np.int64], vectors_px: Floats) -> Waves:
    """Transform windows at places (n, 2) of their first pixel, whose vectors are known."""
    taper = np.hanning(SIDE_PX + 2)[1:-1]
    weight = (taper[:, None] * taper).astype(np.float32)
    parts = [
        scipy.fft.rfft2(
            np.stack([frame[row : row + SIDE_PX, column : column + SIDE_PX] for row, column in places]) * weight
        )
        for frame in (pair.a, pair.b)
    ]
    a, b = (part / np.sqrt(np.square(np.abs(part)).mean()) for part in parts)  # pulses of unequal light
    power = np.sqrt((np.square(np.abs(a)) + np.square(np.abs(b))).mean(axis=(1, 2), keepdims=True))
    power = np.maximum(power, 1e-6 * power.max())
    k = 2.0 * np.pi * np.fft.fftfreq(SIDE_PX)
    ky, kx = (part.astype(np.float32) for part in np.meshgrid(k, np.abs(k[: SIDE_PX // 2 + 1]), indexing="ij"))
    return Waves(a / power, b / power, vectors_px.astype(np.float32), ky, kx)


_CORNERS = (-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)


def _between(grid: WindowGrid, values: Floats, places: NDArray[Any]) -> Floats:
    """Values (ny, nx, c) at the nodes of a grid, between them at places (n, 2), rows first [px]."""
    nodes = grid.y_px, grid.x_px
    at = [np.interp(places[:, axis], each, np.arange(len(each))) for axis, each in enumerate(nodes)]
    return np.stack(
        [
            scipy.ndimage.map_coordinates(values[..., part], at, order=1, mode="nearest")
            for part in range(values.shape[-1])
        ],
        axis=-1,
    )


class _Rings:
    """Waves (ky, kx) of windows by rings of their length, to which the power that moves is fitted.

    Windows (n,) move by their own vectors; or their means by each of the vectors `all_px` (trials, 2).
    """

    def __init__(self, waves: Waves, asked: NDArray[np.bool_], all_px: Floats | None = None) -> None:
        a, b, k = waves.a[:, asked], waves.b[:, asked], np.stack((waves.kx[asked], waves.ky[asked]))
        self.cross, even = a * np.conj(b), np.float32(0.5) * np.square(np.abs(a - b))
        odd, self.number = self.cross.imag, 1
        self.phase = waves.vectors_px @ k
        if all_px is not None:
            even, odd, self.number = even.mean(axis=0), odd.mean(axis=0), len(even)
            self.phase = (all_px.astype(np.float32) @ k)[:, None]
        length = np.linalg.norm(k, axis=0)
        self.ring = np.rint((length - length.min()) / RING).astype(np.int64)
        self.members = (self.ring[:, None] == np.arange(self.ring.max() + 1)).astype(np.float64)
        self.kept = np.abs(self.phase) < LARGEST_PHASE
        self.even, self.odd = self.kept * even, self.kept * odd
        self.count = np.maximum(self._total(self.kept), 1.0)
        self.mean = self._total(self.even) / self.count
        # An even part is the square of noise, distributed as its own mean.
        self.even_variance = np.square(self.mean) / self.number + 1e-30
        self.odd_variance = self._total(np.square(self.odd)) / self.count + 1e-30

    def _total(self, values: NDArray[Any]) -> Floats:
        """Sums over windows and rings."""
        return np.asarray(values.sum(axis=-2) @ self.members, np.float64)

    def power(self, stretch: float) -> tuple[Floats, Floats]:
        """Fit the power of each ring that moves; also return minus twice the logarithm of the likelihood."""
        phase = np.float32(stretch) * self.phase
        sine, rise = self.kept * np.sin(phase), self.kept * (1.0 - np.cos(phase))
        rises = self._total(rise)
        fits = (self._total(rise * self.even) - rises * self.mean) / self.even_variance
        fits += self._total(sine * self.odd) / self.odd_variance
        weights = (self._total(np.square(rise)) - np.square(rises) / self.count) / self.even_variance
        weights = np.maximum(weights + self._total(np.square(sine)) / self.odd_variance, 1e-30)
        power = np.where(self.count * self.number > PLACES, np.maximum(fits, 0.0) / weights, 0.0)
        return power, INDEPENDENT * (power * power * weights - 2.0 * power * fits).sum(axis=-1)


def _particle_waves(waves: Waves) -> NDArray[np.bool_]:
    """Return which waves (ky, kx) show the stretch: those that particle images hold, and no sensor alone."""
    length, least = np.hypot(waves.ky, waves.kx), 1.5 * 2.0 * np.pi / SIDE_PX
    asked = (length > LOWEST) & (length < HIGHEST) & (np.abs(waves.ky) > least) & (waves.kx > least)
    return np.asarray(asked)


def _powers(waves: Waves, stretch: float) -> tuple[Floats, Floats]:
    """Power (ky, kx) of each wave that moves, and that stands still."""
    rings = _Rings(waves, np.ones(waves.ky.shape, bool))
    moving = rings.power(stretch)[0][rings.ring]
    left = np.where(rings.kept, rings.cross.real - moving * np.cos(stretch * rings.phase), 0.0)
    still = np.maximum(left.sum(axis=0) / np.maximum(rings.kept.sum(axis=0), 1), 0.0)
    return moving.reshape(waves.ky.shape), still.reshape(waves.ky.shape)


def _has_lines(moving: Floats, still: Floats) -> bool:
    """Return whether waves along rows or columns stand still far more than those that are a little inclined."""
    for moves, stands in ((moving, still), (moving.T, still.T)):
        along, inclined, flow = (
            part[np.ix_(which, LINE_WAVES)].mean()
            for part, which in ((stands, STRAIGHT), (stands, INCLINED), (moves, STRAIGHT))
        )
        if along > LINES_OVER * inclined and along > LEAST_LINES * flow:
            return True
    return False
