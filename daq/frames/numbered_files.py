"""Numbered files: `B%05d_a.tif` with `B%05d_b.tif` beside it, or `im%05d.tif`, whose neighbours are pairs.

Numbers may have gaps.  Where both frames have a number of their own, a frame is the first of a pair or the second
by its number alone, counted from the lowest: one that is missing does not swap the rest.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from daq.frames.source import FramePlaces
from piv.errors import PairError
from piv.files.frame_file import FRAME_ENDINGS

_NUMBER = re.compile(r"%0?(\d*)d")
_FIRST = re.compile(r"(?<![A-Za-z0-9])([aA])(?=\.[^.]+$)|(?<=d)([aA])(?=\.[^.]+$)")


def second_of(pattern: str) -> str | None:
    """Pattern of second frames, ``_b``, that belongs to one of first frames, ``_a``; None if it has no letter."""
    letter = _FIRST.search(pattern)
    if letter is None:
        return None
    at = letter.start()
    return f"{pattern[:at]}{chr(ord(pattern[at]) + 1)}{pattern[at + 1 :]}"


class NumberedFiles:
    """Files whose names differ by a number.

    Parameters
    ----------
    path : Path
        Pattern with one ``%05d``, ``%d`` or the like in the name of the file.

    Raises
    ------
    PairError
        No file has such a name.
    """

    def __init__(self, path: Path) -> None:
        self._pattern = path
        number = _NUMBER.search(path.name)
        assert number is not None
        before, after = path.name[: number.start()], path.name[number.end() :]
        digits = f"\\d{{{int(number[1])},}}" if number[1] else r"\d+"
        name = re.compile(f"{re.escape(before)}({digits}){re.escape(after)}")
        try:
            found = [(match, file) for file in path.parent.iterdir() if (match := name.fullmatch(file.name))]
        except OSError as error:
            raise PairError(f"{path.parent}: cannot be looked into ({error.strerror})") from None
        files = {int(match[1]): file for match, file in sorted(found, key=lambda each: each[1].name)}
        if not files:
            raise PairError(f"{path}: no file has such a name")
        letter = _FIRST.search(path.name)
        if letter is None:
            low = min(files)
            starts = [n for n in sorted(files) if (n - low) % 2 == 0 and n + 1 in files]
            self._pairs = [((n - low) // 2, files[n], files[n + 1]) for n in starts]
            self._alone = len(files) - 2 * len(self._pairs)
            return
        second = chr(ord(path.name[letter.start()]) + 1)
        self._pairs, self._alone = [], 0
        for n, file in sorted(files.items()):
            at = len(file.name) - len(path.name) + letter.start()
            partner = file.with_name(file.name[:at] + second + file.name[at + 1 :])
            if partner.is_file():
                self._pairs.append((n, file, partner))
            else:
                self._alone += 1

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Whether the name has one number to be put in, and the ending of a frame."""
        return len(_NUMBER.findall(path.name)) == 1 and path.suffix.lower() in FRAME_ENDINGS

    def pairs(self) -> Sequence[FramePlaces]:
        """Pairs in their order; their numbers are those of the files, or of pairs of files."""
        return self._pairs

    def alone(self) -> int:
        """Frames without a partner; of second frames without a first one nobody asks."""
        return self._alone

    def file_of(self, place: Path) -> Path:
        """The frame's own."""
        return place
