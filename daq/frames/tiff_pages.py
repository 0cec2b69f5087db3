"""A TIFF of many pages, which follow each other."""

from pathlib import Path

import tifffile

from daq.frames.pairing import NEIGHBOURS, PairedFrames, Pairing
from ground.plain_file import open_plain
from piv.errors import FrameError
from piv.files.frame_file import MOST_PAGES, TIFF_ENDINGS, page_of


def page_count(path: Path) -> int:
    """Return how many images a TIFF holds, without small previews; 1 for another file, or a damaged one."""
    if path.suffix.lower() not in TIFF_ENDINGS:
        return 1
    try:
        with open_plain(path) as stream, tifffile.TiffFile(stream) as tiff:
            return sum(not page.aspage().is_reduced for page in tiff.pages)
    except Exception:  # of a decoder in a damaged file; reported where it is read
        return 1


class TiffPages(PairedFrames):
    """Pages of a stack.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    FrameError
        It cannot be read, or has too many pages.
    """

    def __init__(self, path: Path, pairing: Pairing = NEIGHBOURS) -> None:
        self._path = path
        try:
            with open_plain(path) as stream, tifffile.TiffFile(stream) as tiff:
                self._pages = len(tiff.pages)
        except OSError as error:
            raise FrameError(f"{path}: cannot be read: {error.strerror or error}") from None
        except Exception as error:  # whatever a decoder meets in a damaged file
            raise FrameError(f"{path}: is not readable as TIFF ({str(error)[:100]})") from None
        if self._pages > MOST_PAGES:
            raise FrameError(f"{path}: has {self._pages} pages, and {MOST_PAGES} are read; cut it")
        self._keep_numbered(range(1, self._pages + 1), pairing)

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether it is a TIFF as a whole, and not one frame."""
        if path.suffix.lower() not in TIFF_ENDINGS or page_of(path)[1] is not None:
            return False
        try:
            return cls(path)._pages != 1
        except FrameError:
            return True
