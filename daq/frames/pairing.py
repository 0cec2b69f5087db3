"""Pairs of the frames of a sequence.

Frames are counted from 1 as they were taken.  A pairing is said by its first pair and, where the next one does not
just follow it, by the second one too; all others follow at the same distance:

    1-2              1 and 2, 3 and 4, ...             two pulses a pair
    1-2,2-3          1 and 2, 2 and 3, ...             time-resolved: every frame with the next
    1-3,2-4          1 and 3, 2 and 4, ...             the same, for slow flows
    1-2,11-12        1 and 2, 11 and 12, ...           every tenth

It stands behind the name of the frames, ``day1@1-2,2-3``.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from piv.errors import PairError

FramePlaces = tuple[int, Path, Path]  # number of the pair, first and second frame
_SAID = re.compile(r"(.+)@(\d{1,9})-(\d{1,9})(?:,(\d{1,9})-(\d{1,9}))?", re.DOTALL)


@dataclass(frozen=True)
class Pairing:
    """Pairs at equal distances.

    Parameters
    ----------
    first : int
        Where the first pair begins, 1 for the first frame.
    apart : int
        From the first frame of a pair to its second.
    step : int
        From one pair to the next.
    """

    first: int = 1
    apart: int = 1
    step: int = 2

    def pairs(self, frames: Mapping[int, Path]) -> tuple[list[FramePlaces], int]:
        """Return the pairs of numbered frames, and how many frames are in none; a missing one costs its pairs."""
        found = [
            ((number - self.first) // self.step, frames[number], frames[number + self.apart])
            for number in sorted(frames)
            if number >= self.first and (number - self.first) % self.step == 0 and number + self.apart in frames
        ]
        used = {place for _, *both in found for place in both}
        return found, len(frames) - len(used)


NEIGHBOURS = Pairing()


class PairedFrames:
    """Pairs of frames that were found in `_path`, and how many frames are in none; base of the sources."""

    _path: Path
    _pairs: Sequence[FramePlaces]
    _unpaired: int

    def _keep_numbered(self, numbers: Iterable[int], pairing: Pairing) -> None:
        """Pair frames of one file, which are named by their numbers."""
        path = self._path
        self._pairs, self._unpaired = pairing.pairs({n: path.with_name(f"{path.name}@{n}") for n in numbers})

    def pairs(self) -> Sequence[FramePlaces]:
        """Return the pairs in their order, with the numbers of the files or of pairs."""
        return self._pairs

    def count_unpaired(self) -> int:
        """Return the number of frames that are in no pair."""
        return self._unpaired

    def file_of(self, place: Path) -> Path:
        """Return the file that a frame lies in."""
        return self._path


def pairing_of(path: Path) -> tuple[Path, Pairing]:
    """Take a name apart into that of the frames and their pairing.

    Raises
    ------
    PairError
        The two pairs that are said begin no series of pairs.
    """
    said = _SAID.fullmatch(str(path))
    if said is None:
        return path, NEIGHBOURS
    name, (a, b) = Path(said[1]), (int(said[2]), int(said[3]))
    c, d = (a + (b - a) + 1, b + (b - a) + 1) if said[4] is None else (int(said[4]), int(said[5]))
    if not (1 <= a < b and a < c and d - c == b - a):
        raise PairError(f"{path}: pairs are given by the first two, at equal spacing: 1-2,3-4 or 1-2,2-3")
    return name, Pairing(a, b - a, c - a)
