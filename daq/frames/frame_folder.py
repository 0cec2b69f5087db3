"""A folder of numbered frames: what it holds is the one pattern that all of them follow."""

import re
from collections import defaultdict
from pathlib import Path

from daq.frames.numbered_files import NumberedFiles, second_of
from piv.errors import PairError
from piv.files.frame_file import FRAME_ENDINGS

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

    def __init__(self, path: Path) -> None:
        super().__init__(path / pattern_in(path))

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
