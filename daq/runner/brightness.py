"""What the mean brightness of frames tells: whether A and B have changed places.

A and B differ a little, by the other cavity or a longer exposure.  The sign of that difference is decided over
`BLOCK` pairs and must never change: a marker that changes its mind half way would be seen here.
"""

import math

import numpy as np
from numpy.typing import NDArray

BLOCK = 20  # pairs
SURE = 8.0  # standard errors from which on a difference has a sign
EVERY = 8  # row and column of a frame that its mean is taken of
QUIET_COUNTS = 0.03  # by which means of dark frames differ


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
