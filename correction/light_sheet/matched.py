"""Planes of products against what layers of particles make of them: height, shift, spread and picture size.

The model of a plane is

    background + light * sum over layers z of exp(-(z - height)^2 / (2 spread^2)) bells(z),

shifted by some lags across D, which no height does.  Bells of pictures of other sizes than the two that were drawn
are geometric means of these, as those of Gaussians are Gaussians.  Background and light are linear, the rest is
found by least squares from the best of all heights; no peak has to stand out from what is beside it.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.light_sheet.layers import ROOM

LEAST_MM, MOST_MM = 0.03, 0.8  # spread of the sheet's light
SIZES = (0.6, 1.2)  # variances of a picture [px^2] for which layers are drawn
SMALLEST, LARGEST = -0.3, 1.8  # share of the way between their inverses
LEAST_LIGHT = 1e-30
STEPS = np.array([0.02, 0.05, 0.01, 0.05])  # mm, lags, mm^2, share: differences for derivatives
TRIED_LAGS = (0, -1, 1, -2, 2)


@dataclass(frozen=True)
class Match:
    """What a plane of lags tells.

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

        def solved(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
            values = start.copy()
            values[free] = x
            bell = self.plane(values)
            spread = bell - bell.mean()
            light = float(spread @ plane) / max(float(spread @ spread), 1e-300)
            return plane - plane.mean() - light * spread, light

        first = np.clip(start[free], low + 1e-9, high - 1e-9)
        answer = scipy.optimize.least_squares(
            lambda x: solved(x)[0] / size, first, bounds=(low, high), x_scale=STEPS[free], max_nfev=30
        ).x
        values = start.copy()
        values[free] = answer
        light = solved(answer)[1]
        inside = self.height_mm[2] < values[0] < self.height_mm[-3]
        return Match(values, light) if light > 0.0 and inside else None

    def left_out(self, blocks: NDArray[np.float64], match: Match, free: list[int]) -> NDArray[np.float64]:
        """Standard deviations (2, len(free)) of the numbers: by chance, and by what the model does not explain.

        Chance is told by leaving blocks (B, R * K) out one by one.  Where the model leaves more of the plane than
        blocks differ by, the rest is taken to lie as chance does, and moves numbers by so many times more.
        """
        count = len(blocks)
        bell = self.plane(match.values)
        design = np.column_stack((np.ones_like(bell), bell, *(match.light * self.rates(match.values, free))))
        norm = np.sqrt(np.sum(design**2, axis=0))
        norm[norm == 0.0] = 1.0
        whole = blocks.sum(axis=0)
        left = (whole - blocks) * count / (count - 1.0)
        answers = np.linalg.lstsq(design / norm, left.T, rcond=1e-9)[0] / norm[:, None]
        steps = answers[2:]
        variance = (count - 1.0) / count * np.sum((steps - steps.mean(axis=1)[:, None]) ** 2, axis=1)
        chance = count * blocks.var(axis=0, ddof=1).sum()
        off = whole - whole.mean() - match.light * (bell - bell.mean())
        more = max(0.0, float(off @ off) / max(float(chance), 1e-300) - 1.0)
        return np.asarray(np.sqrt(np.stack((variance, more * variance))), np.float64)

    def offset(self, spread2: float, size: float) -> float:
        """Lags along D by which bend and fading alone move the peak of a sheet at height 0."""
        bell = self.plane(np.array([0.0, 0.0, spread2, size])).reshape(self.small.shape[1], -1)
        weight = np.square(bell).sum(axis=1)
        lags = np.arange(len(weight)) - len(weight) // 2
        return float(weight @ lags / max(float(weight.sum()), 1e-300))

    def clearness(self, blocks: NDArray[np.float64], match: Match) -> float:
        """By how many standard deviations, told by the blocks (B, R * K), the light stands out."""
        bell = self.plane(match.values)
        spread = bell - bell.mean()
        lights = blocks @ spread
        return float(lights.mean() / max(float(lights.std(ddof=1)), 1e-300) * np.sqrt(len(lights)))
