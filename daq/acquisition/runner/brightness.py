"""What the mean brightness of frames tells: which pairs had light, and whether A and B have changed places.

A timing unit whose lamps run all the time lets the camera begin some pairs before the first light and end some
after the last, because it cannot switch all outputs on at once.  How many is known, where they lie is not: pairs
without light are darker.

A and B differ a little, by the other cavity or a longer exposure.  The sign of that difference is decided over
`BLOCK` pairs and must never change: a marker that changes its mind half way would be seen here.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BLOCK = 20  # pairs
SURE = 8.0  # standard errors from which on a difference has a sign
EVERY = 8  # row and column of a frame that its mean is taken of
QUIET_COUNTS = 0.03  # by which means of dark frames differ
DARKER = 6.0  # standard deviations of lit pairs


def mean_counts(pixels: NDArray[np.uint16]) -> float:
    """Mean of a frame (H, W), of some of its pixels."""
    return float(pixels[::EVERY, ::EVERY].mean())


class BrightnessSign:
    """Watches which of A and B is brighter."""

    def __init__(self) -> None:
        self._differences: list[float] = []
        self.sign = 0  # 1: A is brighter; 0: not decided yet

    def is_flipped(self, first_counts: float, second_counts: float) -> bool:
        """Take a pair; True if A and B have changed places since the sign was decided."""
        self._differences.append(first_counts - second_counts)
        if len(self._differences) < BLOCK:
            return False
        differences, self._differences = np.array(self._differences), []
        mean, error = float(differences.mean()), float(differences.std(ddof=1)) / math.sqrt(BLOCK)
        if abs(mean) <= SURE * max(error, QUIET_COUNTS / math.sqrt(BLOCK)):
            return False
        sign, before = (1 if mean > 0 else -1), self.sign
        self.sign = sign
        return before not in (0, sign)


def dark_before(counts: Sequence[float]) -> int:
    """How many pairs came before the first light.

    Parameters
    ----------
    counts : sequence of float
        Brightness of the first pairs of a chunk, one of which at least had light, and all behind it.

    Returns
    -------
    int
        0 if nothing is clearly darker than what follows.
    """
    best, least = 0, math.inf
    for split in range(1, len(counts)):
        dark, lit = np.array(counts[:split]), np.array(counts[split:])
        contrast = float(lit.mean() - dark.mean())
        spread = float(np.sum((dark - dark.mean()) ** 2) + np.sum((lit - lit.mean()) ** 2))
        clear = contrast > 10.0 * max(float(dark.std()), QUIET_COUNTS) and contrast > 3.0 * float(lit.std())
        if clear and spread < least:
            best, least = split, spread
    return best


class LightWatch:
    """Finds lit pairs that are too dark to have had light, among those behind the first."""

    def __init__(self) -> None:
        self._counts: list[float] = []

    def had_light(self, counts: float) -> bool:
        """Take the brightness of a pair; False if it is far darker than those before it."""
        if len(self._counts) >= 5:
            known = np.array(self._counts[-100:])
            if counts < known.mean() - max(DARKER * float(known.std()), 10.0 * QUIET_COUNTS):
                return False
        self._counts.append(counts)
        return True
