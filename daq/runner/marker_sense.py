"""Whether the marker of evenly spaced frames is wired to exposure A, as the ends of the chunks tell.

Frames that come evenly spaced look the same whichever way they are paired.  A marker that is high during exposure
B, because it hangs on the second trigger or its input is inverted, makes pairs of B and the NEXT A: light 2 of one
pulse and light 1 of the next, a period less dt apart, and brightness and spacing say nothing against it.

What gives it away is that a chunk ends: the timing unit triggers A, B, A, B ... A, B and no more, so the last
frame of all is a B.  A marker that calls it an A is wired wrongly, or the very last frame was lost.  Frames are
lost one by one and chunks are many, so a majority decides; where there is none in the end, nobody knows, and the
run is in doubt.  First frames tell less: cameras skip them.
"""

from daq.bench.pairs_section import PairsSection
from daq.runner.pair_finder import Exposure

ENOUGH = 3  # chunks that end with an A, more than those that end with a B, before a run is ended because of it


class MarkerSense:
    """Counts how the chunks of a step ended.

    Parameters
    ----------
    section : PairsSection
        How pairs come and are marked.
    """

    def __init__(self, section: PairsSection) -> None:
        self.matters = section.shape == "straddling" and section.told_by in ("line_status", "counter")
        self._first = self._second = 0  # chunks that ended with an A, with a B

    def chunk_ended(self, last: Exposure | None) -> None:
        """Take what the marker says of the last frame of a chunk that has come to its end; None if nothing."""
        self._first += last == "A"
        self._second += last == "B"

    def doubt(self, is_final: bool) -> str | None:
        """Say why the marker cannot be trusted, as a sentence; None if it can, or can still.

        Parameters
        ----------
        is_final : bool
            Whether no chunk comes any more.
        """
        if not self.matters or self._first == 0:
            return None
        wrong = self._first >= self._second if is_final else self._first >= self._second + ENOUGH
        if not wrong:
            return None
        return (
            f"{self._first} of {self._first + self._second} chunks ended with a frame that the marker calls A, "
            "and a chunk ends with exposure B: the marker is wired to B, its input is inverted, or the camera "
            "keeps the last frame back"
        )
