"""Uncertainty by waves shorter than two windows, which no window shows.

Passes restore a wave of two windows whole, and of one of half a window nothing is left. A flow whose spectrum goes
on there has an error that its vectors do not show, that its frames hardly show (blocks of the frames that share no
particle are as far apart as such a wave is long, `piv.correlation.agreement`), and that does not go with more
particles. So a spectrum that has fallen as k^-p until there is taken to go on like that. With that energy per
logarithm of the wave number, the same in all directions, and the gain G of the evaluation
(`piv.correlation.response`), mean squares are tables over p:

    sixth differences over h:     D6^2 = sum (2 sin(k_x h/2))^12 G^2 k^-p,
    fourth differences over 2 h:  D4^2 = sum (2 sin(k_x h))^8 G^2 k^-p,
    what is missed:               M^2 = sum (1 - G)^2 k^-p over waves shorter than two windows,

h half a window. Of high orders, since lower ones do not tell spectra apart that fall steeply. So D6/D4 around a
place tells p, and with it D6 there tells M.

**Where.** What is missed lies where a field is steep, as on a step between two streams: there even differences
vanish, and are large at the nodes beside it. So the mean of D6^2 around a place, or D6^2 there if that is less, is
shared out in proportion to the square of the first difference over a window.

**Noise** is in differences as well, N^2, as correlation statistics expect it. It is taken off both; and of what is
left, S = D^2 - N^2, the share S^2/(S^2 + N^2) counts, at the place and around it. Beside a step windows hold two
motions, which looks like noise: so N is that of the calmest third of the nodes that D6 is made of (`CALM`).

Nothing in it is fitted to a flow. A spectrum that ends between one window and one and a half, as none of a fluid
does, is said to miss what it does not have (ADR 41).
"""

from collections.abc import Sequence
from math import comb
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.refine import window_weights
from piv.correlation.response import Transfer, gain, noise_growth, smoothings_of
from piv.correlation.settings import PivSettings

EXPONENTS = np.linspace(0.5, 8.0, 31)
LONGEST, SHORTEST = 20.0, 0.25  # waves that are added up, in windows
WAVES, DIRECTIONS = 64, 6  # of the sums; 160 and 12 change tables by 1 %
CALM = 30.0  # percentile of noise; a step takes three rows of seven
AROUND = 1.0  # of a window: standard deviation of what tells an exponent
Floats = NDArray[np.float64]


class Evaluated(NamedTuple):
    """Evaluation by windows of one size.

    `side_px`, `step_px` and `window_sigma` of the windows, `between` the smoothings between their passes.
    """

    side_px: int
    step_px: int
    window_sigma: float
    between: Sequence[Transfer]

    @classmethod
    def usual(cls, settings: PivSettings, step_px: int) -> "Evaluated":
        """Evaluation by the usual windows of these settings, `step_px` apart."""
        side = settings.windows_px[-1]
        return cls(side, step_px, settings.window_sigma, smoothings_of(settings, side, step_px))

    @property
    def half_window_steps(self) -> int:
        """Nodes that are half a window apart."""
        return max(1, round(0.5 * self.side_px / self.step_px))


class Tail(NamedTuple):
    """Effect on vectors of a spectrum that goes on, over its exponents (`EXPONENTS`).

    `steepness` is D6(h)/D4(2 h), or the ratio of other differences, `missed` M/D6(h); `noise` is D6(h) and D4(2 h)
    of the noise of vectors, as factors of that of one correlation.
    """

    steepness: Floats
    missed: Floats
    noise: tuple[float, float]


def finer_px(vectors: Floats, one_px: Floats, how: Evaluated) -> Floats:
    """Standard deviation (ny, nx) of a component by waves that no window of one size shows.

    Parameters
    ----------
    vectors : ndarray of float64, shape (ny, nx, 2)
        Displacements [px] before the last filter, finite everywhere.
    one_px : ndarray of float64, shape (ny, nx, 2)
        Standard deviation of the noise of one correlation, finite everywhere.
    how : Evaluated
        By which windows.
    """
    orders = (6, how.half_window_steps), (4, 2 * how.half_window_steps)
    tail, stencil = tail_of(how, orders), 6 * how.half_window_steps + 1
    noise = scipy.ndimage.percentile_filter(np.square(one_px).mean(axis=-1), CALM, stencil, mode="nearest")
    sixth, fourth = (differences(vectors, order, apart) for order, apart in orders)
    by_chance = [np.square(growth) * noise for growth in tail.noise]
    reach = AROUND * how.side_px / how.step_px
    flow, wider = (
        np.maximum(scipy.ndimage.gaussian_filter(part - chance, reach, mode="nearest"), 1e-30)
        for part, chance in zip((sixth, fourth), by_chance, strict=True)
    )
    exponent = np.interp(-0.5 * np.log(flow / wider), -np.log(tail.steepness), EXPONENTS)
    here, chance = (
        scipy.ndimage.uniform_filter(part, 2 * how.half_window_steps + 1, mode="nearest")
        for part in (sixth, by_chance[0])
    )
    left = np.maximum(here - chance, 0.0)
    steep = differences(vectors, 1, 2 * how.half_window_steps)
    spread, usual = (scipy.ndimage.gaussian_filter(part, reach, mode="nearest") for part in (left, steep))
    there = np.minimum(left, spread) * steep / np.maximum(usual, 1e-30)
    around = scipy.ndimage.gaussian_filter(by_chance[0], reach, mode="nearest")
    share = clear_share(left, chance) * clear_share(flow, around)
    found: Floats = np.exp(np.interp(exponent, EXPONENTS, np.log(tail.missed))) * np.sqrt(share * there)
    return found


def clear_share(flow: Floats, noise: Floats) -> Floats:
    """Share (ny, nx) of the square of a flow that counts beside noise of that square."""
    share: Floats = np.square(flow) / np.maximum(np.square(flow) + np.square(noise), 1e-30)
    return share


def differences(vectors: Floats, order: int, apart: int) -> Floats:
    """Mean square (ny, nx) of a component's differences over `apart` nodes, along both axes.

    `order` times `apart` is even, so that differences stand at nodes. Near an edge stands what is found farther
    inside; an axis that is too short has none.
    """
    factors = [(-1) ** k * comb(order, k) for k in range(order + 1)]
    square, axes, reach = np.zeros(vectors.shape[:2]), 0, order * apart // 2
    for axis in range(2):
        field = np.moveaxis(vectors, axis, 0)
        inner = len(field) - 2 * reach
        if inner < 1:
            continue
        apart_px = np.zeros((inner, *field.shape[1:]))
        for k, factor in enumerate(factors):
            apart_px += factor * field[k * apart : k * apart + inner]
        whole = np.pad(np.square(apart_px).mean(axis=-1), ((reach, reach), (0, 0)), mode="edge")
        square += np.moveaxis(whole, 0, axis)
        axes += 1
    return square / max(axes, 1)


def tail_of(how: Evaluated, orders: Sequence[tuple[int, int]]) -> Tail:
    """Tabulate the effect of a spectrum without an end on two differences of vectors: order, and nodes apart."""
    longest, shortest = (np.log(2.0 * np.pi / (share * how.side_px)) for share in (LONGEST, SHORTEST))
    number = np.exp(np.linspace(longest, shortest, WAVES))
    angle = (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS * np.pi
    wave = number[:, None, None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    weights = window_weights(how.side_px, how.window_sigma)
    shown = gain(weights, how.step_px, how.between, wave)
    energy = number ** -EXPONENTS[:, None]
    sixth, fourth = (
        energy @ np.square(shown * _transfer(order, apart)(how.step_px * wave)).mean(axis=-1)
        for order, apart in orders
    )
    finer = number > np.pi / how.side_px
    missed = energy[:, finer] @ np.square(1.0 - shown[finer]).mean(axis=-1)
    noise = [noise_growth(weights, how.step_px, how.between, _transfer(order, apart)) for order, apart in orders]
    return Tail(np.sqrt(sixth / fourth), np.sqrt(missed / sixth), (noise[0], noise[1]))


def _transfer(order: int, apart: int) -> Transfer:
    """Transfer of differences along one axis."""
    return lambda wave: (2.0 * np.sin(0.5 * apart * wave[..., 0])) ** order
