"""How often a run is shown: as often as eyes like while it keeps up, less when the computer has too much to do.

A frame that is not corrected while the run goes on is the first thing that a full computer leaves out, and a page,
whose browser may draw on the same cores, is the first thing that can do with less.  So once a second the rate goes
down by a third if more than `BEHIND` of the frames were left out, to `LEAST_HZ`, and up by one if not.  While
nobody looks, one frame a second is shown, so that whoever comes has a picture at once.

Frames come when they come: one that comes late is made up for by the next, so that of 20 frames a second 12 are
shown, and not every other one.
"""

import math

MOST_HZ, LEAST_HZ, IDLE_HZ = 12.0, 2.0, 1.0
BEHIND = 0.25
CHECK_S = 1.0
SLOWER, FASTER_HZ = 0.7, 1.0


class Pace:
    """Says when the next moment is due."""

    def __init__(self) -> None:
        self.most_hz = MOST_HZ
        self._from_s = -math.inf
        self._checked_s, self._done, self._left_out = -math.inf, 0, 0

    def is_due(self, now_s: float, is_watched: bool) -> bool:
        """Whether a frame is to be shown now.

        Parameters
        ----------
        now_s : float
            On any clock that only goes forward.
        is_watched : bool
            Whether somebody looks.
        """
        return now_s - self._from_s >= self._period_s(is_watched)

    def shown(self, now_s: float, is_watched: bool) -> None:
        """Say that one was shown."""
        period_s = self._period_s(is_watched)
        self._from_s = max(self._from_s + period_s, now_s - period_s)

    def see(self, now_s: float, done: int, left_out: int) -> None:
        """Look at how many frames have been corrected so far, and how many left out."""
        if now_s - self._checked_s < CHECK_S:
            return
        new, lost = done - self._done, left_out - self._left_out
        self._checked_s, self._done, self._left_out = now_s, done, left_out
        if lost > BEHIND * (new + lost):
            self.most_hz = max(LEAST_HZ, SLOWER * self.most_hz)
        else:
            self.most_hz = min(MOST_HZ, self.most_hz + FASTER_HZ)

    @property
    def sentence(self) -> str:
        """What a viewer should know; "" if there is nothing to be known."""
        if self.most_hz == MOST_HZ:
            return ""
        return f"at most {self.most_hz:.0f} a second: this computer has too much to do"

    def _period_s(self, is_watched: bool) -> float:
        return 1.0 / (self.most_hz if is_watched else IDLE_HZ)
