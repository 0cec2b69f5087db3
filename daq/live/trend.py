"""Which way to turn a ring: a number that says how sharp the view is, followed while somebody turns.

One frame does not say on which side of the focus it was taken: the same spot is as wide before it as behind it.
What says it is a turn. Widths v(t) of the last looks are kept; the last two are compared with the two before, by
their scatter, which is taken from second differences, because those do not see a steady turn:

    sigma^2 = median((v(t-1) - 2 v(t) + v(t+1))^2) / (6 * 0.455)

(0.455: median of chi squared with one degree of freedom.) Further than `SURE` sigmas apart the view becomes
sharper or softer. The sharpest of `MEMORY_S` is the wider one of two looks after each other, so that a bad look is
none.
"""

import math
from collections import deque

import numpy as np

MEMORY_S = 60.0
LOOKS = 8  # before anything is said: of fewer the scatter is not known
SURE = 4.0
LEAST = 0.004  # of a width: scatter that no frame is better than
SIXTH, CHI = 6.0, 0.455
SPAN = 24  # looks whose scatter is taken


class Trend:
    """Follows a width; smaller is sharper."""

    def __init__(self) -> None:
        self._looks: deque[tuple[float, float]] = deque()

    def forget(self) -> None:
        """Begin anew: what is seen is something else."""
        self._looks.clear()

    def see(self, now_s: float, width_px: float) -> None:
        """Add a look; times only go forward."""
        if math.isfinite(width_px):
            self._looks.append((now_s, width_px))
        while self._looks and now_s - self._looks[0][0] > MEMORY_S:
            self._looks.popleft()

    @property
    def sentence(self) -> str:
        """What to do, for whoever has a hand at the ring; "" while there is nothing to be said."""
        if len(self._looks) < LOOKS:
            return ""
        times, widths = (np.array(column) for column in zip(*self._looks, strict=True))
        sigma = self._sigma(widths)
        now, before = float(widths[-2:].mean()), float(widths[-4:-2].mean())
        wider = np.maximum(widths[1:], widths[:-1])
        sharpest = int(wider.argmin())
        best, ago_s = float(wider[sharpest]), float(times[-1] - times[sharpest + 1])
        at_best = now - best <= SURE * sigma
        was = f"it was {best:.2f} px {ago_s:.0f} s ago"
        if abs(now - before) > SURE * sigma:
            if now < before:
                return f"{now:.2f} px, becoming sharper: go on"
            return f"{now:.2f} px, becoming softer: turn back" + ("" if at_best else f"; {was}")
        if not at_best:
            return f"{now:.2f} px: turn back the way you came; {was}"
        if float(widths.max()) - best > 2.0 * SURE * sigma:
            return f"{now:.2f} px, as sharp as it was in the last minute"
        return f"{now:.2f} px: turn the ring a little, to see which way is sharper"

    @staticmethod
    def _sigma(widths: np.ndarray) -> float:
        """Scatter of one look."""
        some = widths[-SPAN:]
        bends = np.diff(some, 2) ** 2
        return max(math.sqrt(float(np.median(bends)) / (SIXTH * CHI)), LEAST * float(np.median(some)))
