"""What the mean brightness of frames tells: which pairs had light, and whether A and B have changed places.

A timing unit whose lamps run all the time cannot switch all outputs on at one tick: the camera begins some pairs
before the first light and ends some after the last, and the two Q-switches may begin and end a tick apart.  How
many such pairs there are at most is known, where they lie is not: a frame without light is darker.

A and B differ a little, by the other cavity or a longer exposure.  The sign of that difference is decided over
`BLOCK` pairs and must never change: a marker that changes its mind half way would be seen here.
"""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BLOCK = 20  # pairs
SURE = 8.0  # standard errors from which on a difference has a sign
EVERY = 8  # row and column of a frame that its mean is taken of
QUIET_COUNTS = 0.03  # by which means of dark frames differ
DARKER = 6.0  # standard deviations of lit frames
ENOUGH, KEPT = 5, 100  # lit frames that say what is normal


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


def had_light(counts: Sequence[float]) -> list[bool]:
    """Which of some frames had light.

    Parameters
    ----------
    counts : sequence of float
        Brightness of exposures A, or of exposures B, some of which may be dark.

    Returns
    -------
    list of bool
        All True if they do not fall into two groups: quiet dark ones, and lit ones clearly above.
    """
    levels = np.sort(np.array(counts))
    least, threshold = math.inf, -math.inf
    for split in range(1, len(levels)):
        dark, lit = levels[:split], levels[split:]
        contrast = float(lit.mean() - dark.mean())
        spread = float(np.sum((dark - dark.mean()) ** 2) + np.sum((lit - lit.mean()) ** 2))
        quiet = contrast > 10.0 * max(float(dark.std()), QUIET_COUNTS)
        alone = 1.5 if split == 1 else 1.0  # one frame may be a weak flash
        if quiet and contrast > alone * DARKER * float(lit.std()) and spread < least:
            least, threshold = spread, float(lit[0])
    return [level >= threshold for level in counts]


class LightWatch:
    """Tells lit exposures from dark ones, better the more of either it has seen; one for A and one for B."""

    def __init__(self) -> None:
        self._lit: deque[float] = deque(maxlen=KEPT)
        self._dark: deque[float] = deque(maxlen=KEPT)

    def are_lit(self, counts: Sequence[float]) -> list[bool]:
        """Take the brightness of exposures at the begin of a chunk; return which had light."""
        if self._lit and self._dark:
            return [self.is_lit(one) for one in counts]
        found = had_light(counts)
        for one, is_lit in zip(counts, found, strict=True):
            (self._lit if is_lit else self._dark).append(one)
        return found

    def is_lit(self, counts: float) -> bool:
        """Take the brightness of the next exposure; return whether it had light."""
        if self._lit and self._dark:
            found = counts > 0.5 * (float(np.mean(self._lit)) + float(np.mean(self._dark)))
        elif len(self._lit) >= ENOUGH:
            spread = max(DARKER * float(np.std(self._lit)), 10.0 * QUIET_COUNTS)
            found = counts > float(np.mean(self._lit)) - spread
        else:
            found = True
        (self._lit if found else self._dark).append(counts)
        return found
