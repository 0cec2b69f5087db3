"""Numbered files: `B%05d_a.tif` with `B%05d_b.tif` beside it, or `im%05d.tif`, whose neighbours are pairs.

Numbers may have gaps.  Where both frames have a number of their own, it alone says which pairs a frame is in
(`daq.frames.pairing`), counted from the lowest: one that is missing does not swap the rest.  A folder of
numbered frames is the one pattern that all of them follow.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from daq.frames.pairing import NEIGHBOURS, FramePlaces, Pairing
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
        No file has such a name; or letters say which frames are pairs, and a pairing says it too.
    """

    def __init__(self, path: Path, pairing: Pairing = NEIGHBOURS) -> None:
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
            self._pairs, self._alone = pairing.pairs({n - low + 1: file for n, file in files.items()})
            return
        if pairing != NEIGHBOURS:
            raise PairError(f"{path}: the letters say which frames are pairs; leave the numbers behind @ out")
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


_DIGITS = re.compile(r"\d+")
Parts = tuple[str, str]  # of a name, before and behind its number


class FrameFolder(NumberedFiles):
    """Frames of a folder, by the pattern of their names.

    Parameters
    ----------
    path : Path
        The folder.

    Raises
    ------
    PairError
        Its frames follow several patterns, or none.
    """

    def __init__(self, path: Path, pairing: Pairing = NEIGHBOURS) -> None:
        super().__init__(path / pattern_in(path), pairing)

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Whether it is a folder with numbered frames."""
        return path.is_dir() and bool(_numbered(path))


def pattern_in(folder: Path) -> str:
    """Return the pattern of the numbered frames of a folder, such as ``B%05d_a.tif``.

    Of several numbers in the names the one is taken that leaves the fewest patterns: ``im%05d_cam1.tif``.  Files
    without a number, such as a picture of the target, are left aside.

    Raises
    ------
    PairError
        There are several patterns, or no numbered frame.
    """
    names = _numbered(folder)
    if not names:
        raise PairError(f"{folder}: holds no numbered frames")
    most = max(len(_DIGITS.findall(Path(name).stem)) for name in names)
    found = min((_patterns(names, place) for place in range(-1, -most - 1, -1)), key=len)
    if len(found) > 1:
        raise PairError(
            f"{folder}: its frames have several names; name one of them, in quotes: {', '.join(found)}"
        )
    return found[0]


def _numbered(folder: Path) -> list[str]:
    """Names of frames with a number."""
    try:
        names = [file.name for file in folder.iterdir() if file.suffix.lower() in FRAME_ENDINGS]
    except OSError as error:
        raise PairError(f"{folder}: cannot be looked into ({error.strerror})") from None
    return sorted(name for name in names if _DIGITS.search(Path(name).stem))


def _patterns(names: list[str], place: int) -> list[str]:
    """Patterns of names whose number at `place` differs; a second frame's goes with that of its first."""
    widths: dict[Parts, set[int]] = defaultdict(set)
    for name in names:
        runs = list(_DIGITS.finditer(Path(name).stem))
        number = runs[place] if -place <= len(runs) else runs[0]
        widths[name[: number.start()], name[number.end() :]].add(len(number[0]))
    texts = {
        f"{before}%0{min(each)}d{behind}" if len(each) == 1 else f"{before}%d{behind}"
        for (before, behind), each in widths.items()
    }
    return sorted(texts - {second for text in texts if (second := second_of(text)) is not None})
