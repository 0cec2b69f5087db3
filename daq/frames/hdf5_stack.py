"""A stack of images in an HDF5 or NeXus file: (n, 2, H, W), pairs as they are, or (n, H, W), in a sequence.

Which data set it is says the name, ``data.h5@/entry/data/data``; without it the file's own `default` attributes,
as NeXus has them, and then the only data set that can be one.  Reading needs h5py (extra `hdf5`).
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.errors import RunUsageError
from daq.frames.frame_in_file import require_size
from daq.frames.pairing import NEIGHBOURS, FramePlaces, Pairing
from piv.errors import FrameError, PairError

ENDINGS = r"\.(?:h5|hdf5|hdf|nxs|nx5)"
_STACK = re.compile(rf"(.+{ENDINGS})(?:@(/.+))?", re.IGNORECASE | re.DOTALL)
_IMAGE = re.compile(rf"(.+{ENDINGS})@(/.+)@(\d{{1,12}})", re.IGNORECASE | re.DOTALL)
KINDS = ("u1", "u2", "f4")


class Hdf5Stack:
    """Images of a data set.

    Parameters
    ----------
    path : Path
        The file, with ``@`` and the data set behind it if that is not the only one.

    Raises
    ------
    FrameError
        It cannot be read, or it is not clear which data set is meant.
    RunUsageError
        h5py is not installed.
    PairError
        The stack is one of pairs, and a pairing is said.
    """

    def __init__(self, path: Path, pairing: Pairing = NEIGHBOURS) -> None:
        found = _STACK.fullmatch(str(path))
        assert found is not None
        self._file = Path(found[1])
        with _opened(self._file) as file:
            self._name = _named(file, found[2], path)
            self._shape = tuple(int(length) for length in file[self._name].shape)
        count, *_ = self._shape
        if len(self._shape) == 3:
            self._pairs, self._alone = pairing.pairs({n + 1: self._image(n) for n in range(count)})
            return
        if pairing != NEIGHBOURS:
            raise PairError(f"{path}: its images are pairs already; leave the numbers behind @ out")
        self._pairs, self._alone = [(n, self._image(2 * n), self._image(2 * n + 1)) for n in range(count)], 0

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Whether the name is that of such a file, and of no single image in it."""
        return _STACK.fullmatch(str(path)) is not None and not is_image(path)

    def pairs(self) -> Sequence[FramePlaces]:
        """Pairs in their order; images are numbered as if those of pairs stood one behind the other."""
        return self._pairs

    def alone(self) -> int:
        """Images that are in no pair."""
        return self._alone

    def file_of(self, place: Path) -> Path:
        """The file."""
        return self._file

    def _image(self, number: int) -> Path:
        return Path(f"{self._file}@{self._name}@{number}")


def is_image(place: Path) -> bool:
    """Whether a name is that of one image of a stack."""
    return _IMAGE.fullmatch(str(place)) is not None


def read_image(place: Path, shape: tuple[int, int] | None) -> NDArray[Any]:
    """Read one image of a stack; raises FrameError as `daq.frames.named_frame.read_named`."""
    found = _IMAGE.fullmatch(str(place))
    assert found is not None
    number = int(found[3])
    with _opened(Path(found[1])) as file:
        try:
            data = file[found[2]]
            require_size(place, tuple(data.shape[-2:]), shape)
            image = data[number] if data.ndim == 3 else data[number // 2, number % 2]
        except (KeyError, ValueError, IndexError, OSError) as error:
            raise FrameError(f"{place}: cannot be read: {str(error)[:200]}") from None
    pixels = np.ascontiguousarray(image)
    return pixels.astype(pixels.dtype.newbyteorder("="), copy=False)


def _opened(file: Path) -> Any:  # noqa: ANN401 - h5py's file
    try:
        import h5py
    except ImportError:
        raise RunUsageError(f"{file}: reading HDF5 needs h5py; install rtpiv[hdf5]") from None
    try:
        return h5py.File(file, "r")
    except OSError as error:
        raise FrameError(f"{file}: is no HDF5 file that can be read ({str(error)[:100]})") from None


def _named(file: Any, given: str | None, path: Path) -> str:  # noqa: ANN401
    """The data set that is meant."""
    if given is not None:
        if given not in file or not _is_stack(file[given]):
            raise FrameError(f"{path}: has no stack of images at {given}")
        return given
    by_default = _default(file)
    if by_default is not None:
        return by_default
    found: list[str] = []
    file.visititems(lambda name, each: found.append(f"/{name}") if _is_stack(each) else None)
    if len(found) != 1:
        there = ", ".join(found[:5]) or "none"
        raise FrameError(f"{path}: say which stack of images is meant, FILE@/NAME; there is {there}")
    return found[0]


def _default(file: Any) -> str | None:  # noqa: ANN401
    """What NeXus calls the default plot of a file: `default` from group to group, then `signal`."""
    place = file
    for _ in range(10):
        name = place.attrs.get("default", place.attrs.get("signal"))
        if not isinstance(name, str) or name not in place:
            return None
        place = place[name]
        if _is_stack(place):
            return str(place.name)
        if not hasattr(place, "keys"):
            return None
    return None


def _is_stack(each: Any) -> bool:  # noqa: ANN401
    """Whether it is a data set of grey images, or of pairs of them."""
    shape = getattr(each, "shape", None)
    kind = getattr(getattr(each, "dtype", None), "str", "")[1:]
    return shape is not None and kind in KINDS and (len(shape) == 3 or (len(shape) == 4 and shape[1] == 2))
