"""Light of many colours: what a lamp sends, a filter passes and a camera counts, as one weight a wavelength.

A picture in such light is the sum of pictures in each colour, so a glass shows the mean index

    n_light = sum_k w_k n(lambda_k),        sum_k w_k = 1,

and a point behind glass is smeared along the way on which it moves with the index.  What counts is the product of
three: the lamp's spectrum, every filter's transmittance, and the camera's response.

A white LED is specified by its colour temperature: the blue light of its pump and the broad light of its phosphor.
Both are Gaussians.  Their places, widths and heights (TYPICAL) were fitted to the typical lamps LED-B1 to LED-B5
of CIE 15:2018, from 2733 to 6598 K, whose mean wavelengths they give to 4 nm; between them they follow the
reciprocal of the temperature.  Lamps of one colour temperature differ, by UNSURE_NM in mean wavelength: a spectrum
that was measured, given point by point, says ten times more.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.errors import SceneError
from tracer.media import VISIBLE_NM, Medium

TYPICAL = np.array(  # temperature [K]; pump: height against the phosphor, nm, full width; phosphor: nm, full width
    [
        [6598.0, 1.77, 451.7, 24.4, 563.9, 147.0],
        [5109.0, 1.40, 450.9, 24.2, 573.8, 142.3],
        [4103.0, 0.96, 448.2, 21.9, 580.7, 157.9],
        [2998.0, 0.47, 452.8, 26.3, 598.9, 144.5],
        [2733.0, 0.33, 453.1, 31.5, 603.2, 138.1],
    ]
)
WARMEST_K, COLDEST_K = 2500.0, 7000.0
UNSURE_NM = 8.0
ENDS_NM = (390.0, 780.0)
SAMPLES = 1201  # of a continuous spectrum
WIDEST = 4.0  # standard deviations of a Gaussian that are counted each way
FULL_WIDTH = float(np.sqrt(8.0 * np.log(2.0)))  # full width at half height of a Gaussian, in standard deviations
PART = 1e-4  # of the light: parts of the spectrum weaker than this together are no light
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Light:
    """Light as a camera counts it.

    Parameters
    ----------
    wavelength_nm : tuple of float
        Vacuum wavelengths, ascending.
    weight : tuple of float
        Share of each, 1 in sum.
    unsure_nm : float
        Standard deviation of the mean wavelength: how far one lamp of this kind differs from another.

    Raises
    ------
    SceneError
        No light, or some where no index is known.
    """

    wavelength_nm: tuple[float, ...]
    weight: tuple[float, ...]
    unsure_nm: float = 0.0

    def __post_init__(self) -> None:
        low, high = VISIBLE_NM
        if not self.weight or min(self.weight) < 0.0 or abs(sum(self.weight) - 1.0) > 1e-9:
            raise SceneError("a light needs some power, and none below zero")
        if self.wavelength_nm[0] < low or self.wavelength_nm[-1] > high:
            raise SceneError(f"the light goes beyond {low:g}-{high:g} nm, where no index is known; cut it off")

    @property
    def mean_nm(self) -> float:
        """Mean wavelength."""
        return float(np.dot(self.wavelength_nm, self.weight))

    @property
    def spread_nm(self) -> float:
        """Standard deviation of the wavelength."""
        return float(np.sqrt(np.dot((np.array(self.wavelength_nm) - self.mean_nm) ** 2, self.weight)))

    def index(self, medium: Medium) -> float:
        """Mean refractive index of a medium in this light."""
        return float(np.dot([medium.n(length) for length in self.wavelength_nm], self.weight))

    def index_sigma(self, medium: Medium) -> float:
        """Standard deviation of `index`, from how unsure the mean wavelength is; signed like dn/dlambda."""
        low, high = VISIBLE_NM
        sides = [min(max(self.mean_nm + step, low), high) for step in (-1.0, 1.0)]
        return (medium.n(sides[1]) - medium.n(sides[0])) / (sides[1] - sides[0]) * self.unsure_nm

    def through(self, passed: Callable[[Numbers], Numbers]) -> "Light":
        """Return the light behind a filter or as counted by a camera: weights times `passed` of wavelengths [nm].

        Raises
        ------
        SceneError
            Nothing is left.
        """
        left = np.array(self.weight) * passed(np.array(self.wavelength_nm))
        return replace(light_of(self.wavelength_nm, left), unsure_nm=self.unsure_nm)

    def colours(self, count: int) -> tuple[Numbers, Numbers]:
        """Cut the light into at most `count` parts of equal weight: their mean wavelengths (K,), weights (K,)."""
        lengths, weights = np.array(self.wavelength_nm), np.array(self.weight)
        if np.count_nonzero(weights) <= count:
            return lengths[weights > 0.0], weights[weights > 0.0]
        ends = np.concatenate(([0.0], np.cumsum(weights)))
        cuts = np.linspace(0.0, 1.0, count + 1)
        moment = np.concatenate(([0.0], np.cumsum(weights * lengths)))
        return np.diff(np.interp(cuts, ends, moment)) * count, np.full(count, 1.0 / count)


def light_of(wavelength_nm: ArrayLike, power: ArrayLike) -> Light:
    """Light of wavelengths [nm] (N,), ascending, and what they carry (N,), in any unit; weak ends are cut off.

    Raises
    ------
    SceneError
        There is no power, or some below zero.
    """
    lengths: Numbers = np.asarray(wavelength_nm, np.float64)
    weights: Numbers = np.asarray(power, np.float64)
    if not np.isfinite(weights).all() or weights.min(initial=0.0) < 0.0 or not weights.sum() > 0.0:
        raise SceneError("a light needs some power, and none below zero; look at spectrum, filters and response")
    share = np.cumsum(weights) / weights.sum()
    kept = (share >= PART) & (np.concatenate(([0.0], share[:-1])) <= 1.0 - PART)
    lengths, weights = lengths[kept], weights[kept] / weights[kept].sum()
    return Light(tuple(lengths.tolist()), tuple(weights.tolist()))


def line(wavelength_nm: float) -> Light:
    """Light of one wavelength, such as a laser's."""
    return Light((wavelength_nm,), (1.0,))


def continuous(low_nm: float, high_nm: float, density: Callable[[Numbers], Numbers]) -> Light:
    """Light between two wavelengths with a density per nm."""
    step = (high_nm - low_nm) / SAMPLES
    lengths: Numbers = np.asarray(low_nm + step * (np.arange(SAMPLES) + 0.5), np.float64)
    return light_of(lengths, density(lengths))


def band(low_nm: float, high_nm: float) -> Light:
    """Light that is equally strong between two wavelengths."""
    return continuous(low_nm, high_nm, np.ones_like)


def gaussian(mean_nm: float, sigma_nm: float) -> Light:
    """Light with a Gaussian spectrum; sigma 0 is a line.  Below 300 nm there is none: no glass lets it pass."""
    if sigma_nm == 0.0:
        return line(mean_nm)
    low, high = max(mean_nm - WIDEST * sigma_nm, VISIBLE_NM[0]), min(mean_nm + WIDEST * sigma_nm, VISIBLE_NM[1])
    return continuous(low, high, lambda nm: np.asarray(np.exp(-0.5 * ((nm - mean_nm) / sigma_nm) ** 2)))


def white_led(temperature_k: float) -> Light:
    """Light of a white LED of a colour temperature [K], before any filter or camera.

    Raises
    ------
    SceneError
        Not within 2500-7000 K.
    """
    if not WARMEST_K <= temperature_k <= COLDEST_K:
        raise SceneError(
            f"a white LED has {WARMEST_K:g}-{COLDEST_K:g} K, not {temperature_k:g}; give its spectrum by points"
        )
    at = 1e6 / temperature_k
    pump, pump_nm, pump_width, peak_nm, peak_width = (
        float(np.interp(at, 1e6 / TYPICAL[:, 0], column)) for column in TYPICAL.T[1:]
    )

    def density(nm: Numbers) -> Numbers:
        return pump * _bell(nm, pump_nm, pump_width) + _bell(nm, peak_nm, peak_width)

    return replace(continuous(*ENDS_NM, density), unsure_nm=UNSURE_NM)


def _bell(nm: Numbers, mean_nm: float, width_nm: float) -> Numbers:
    """Gaussian of height 1 by its full width at half height."""
    return np.asarray(np.exp(-0.5 * ((nm - mean_nm) * FULL_WIDTH / width_nm) ** 2))
