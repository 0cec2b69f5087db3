"""A stack of images in an HDF5, NeXus or MATLAB 7.3 file: (n, 2, H, W), pairs as they are, or (n, H, W), in order.

Also (n, H, W, 1), and (H, W, n) where the last axis is much the shortest.  MATLAB writes axes in reverse order, so
an array (H, W, n) is (n, W, H) in its files; there the images are turned back.

Which data set it is says the name, ``data.h5@/entry/data/data``; without it the file's own `default` attributes,
as NeXus has them, and then the only data set that can be one.  Two of one shape whose names are those of first and
second frames (A and B) are pairs, image by image.  Reading needs h5py (extra `hdf5`).
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.errors import RunUsageError
from daq.frames.name_schemes import schemes_of
from daq.frames.pairing import NEIGHBOURS, PairedFrames, Pairing
from piv.errors import FrameError, PairError
from piv.files.numbers import NEEDED, as_grey_levels

ENDINGS = r"\.(?:h5|hdf5|hdf|nxs|nx5|mat)"
_STACK = re.compile(rf"(.+{ENDINGS})(?:@(/.+))?", re.IGNORECASE | re.DOTALL)
_IMAGE = re.compile(rf"(.+{ENDINGS})@(/.+)@(\d{{1,12}})", re.IGNORECASE | re.DOTALL)
SHORTEST = 4  # times as long as the last axis are the others at least, where that counts the images
MATLAB = "MATLAB_class"  # attribute of all that MATLAB writes
ONE_NUMBER = "_000.h5"  # behind a name, so that another number in it may tell first from second frames


class Hdf5Stack(PairedFrames):
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
        self._path = Path(found[1])
        with _open(self._path) as file:
            names = _dataset_names(file, found[2], path)
            counts = [_Images(file[name]).count for name in names]
            is_paired = _Images(file[names[0]]).is_paired
        if len(names) == 1 and not is_paired:
            self._pairs, self._unpaired = pairing.pairs(
                {n + 1: self._image(names[0], n) for n in range(counts[0])}
            )
            return
        if pairing != NEIGHBOURS:
            raise PairError(f"{path}: its images are pairs already; remove the numbers after @")
        if is_paired:
            (name,) = names
            self._pairs = [(n, self._image(name, 2 * n), self._image(name, 2 * n + 1)) for n in range(counts[0])]
            self._unpaired = 0
        else:
            first, second = names
            self._pairs = [(n, self._image(first, n), self._image(second, n)) for n in range(min(counts))]
            self._unpaired = max(counts) - min(counts)

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether the name is that of such a file, and of no single image in it."""
        return _STACK.fullmatch(str(path)) is not None and not is_image(path)

    def _image(self, name: str, number: int) -> Path:
        return Path(f"{self._path}@{name}@{number}")


class _Images:
    """Images of a data set, in whatever order its axes are.

    Parameters
    ----------
    data : h5py.Dataset
        The data set.

    Raises
    ------
    FrameError
        Why it holds no images, as the rest of a sentence.
    """

    def __init__(self, data: Any) -> None:  # noqa: ANN401 - h5py's
        self._data, shape = data, tuple(getattr(data, "shape", None) or ())
        if data.dtype.kind not in "iuf" or data.dtype.itemsize > 8 or data.dtype == np.float16:
            raise FrameError(f"holds {data.dtype}; {NEEDED}")
        self.is_paired = len(shape) == 4 and shape[1] == 2
        is_single = len(shape) == 4 and shape[3] == 1
        if len(shape) != 3 and not self.is_paired and not is_single:
            raise FrameError(f"is {' x '.join(map(str, shape)) or 'a single number'}; images are n x H x W")
        self._is_last = len(shape) == 3 and SHORTEST * shape[2] <= min(shape[:2])
        self._is_turned = MATLAB in data.attrs
        self.count = int(shape[2] if self._is_last else shape[0])

    def image(self, number: int) -> NDArray[Any]:
        """Return one image (H, W); of pairs those of all, one behind the other."""
        if self._is_last:
            pixels = self._data[:, :, number]
        elif self.is_paired:
            pixels = self._data[number // 2, number % 2]
        else:
            pixels = self._data[number]
        pixels = pixels.reshape(pixels.shape[:2])
        return np.ascontiguousarray(as_grey_levels(pixels.T if self._is_turned else pixels))


def is_image(place: Path) -> bool:
    """Return whether a name is that of one image of a stack."""
    return _IMAGE.fullmatch(str(place)) is not None


def read_image(place: Path) -> NDArray[Any]:
    """Read one image of a stack; raises FrameError as `daq.frames.named_frame.read_named`."""
    found = _IMAGE.fullmatch(str(place))
    assert found is not None
    number = int(found[3])
    with _open(Path(found[1])) as file:
        try:
            return _Images(file[found[2]]).image(number)
        except (KeyError, ValueError, IndexError, OSError, FrameError) as error:
            raise FrameError(f"{place}: cannot be read: {str(error)[:200]}") from None


def _open(file: Path) -> Any:  # noqa: ANN401 - h5py's file
    try:
        import h5py
    except ImportError:
        raise RunUsageError(f"{file}: reading HDF5 needs h5py; install rtpiv[hdf5]") from None
    try:
        return h5py.File(file, "r")
    except OSError as error:
        raise FrameError(f"{file}: is not readable as HDF5 ({str(error)[:100]})") from None


def _dataset_names(file: Any, given: str | None, path: Path) -> list[str]:  # noqa: ANN401
    """Names of the data set that is meant, or of those of first and of second frames."""
    stacks: dict[str, tuple[int, ...]] = {}
    others: dict[str, str] = {}

    def look(name: str, each: Any) -> None:  # noqa: ANN401
        if not hasattr(each, "dtype"):
            return
        try:
            stacks[f"/{name}"] = _Images(each).count, *each.shape
        except FrameError as error:
            others[f"/{name}"] = str(error)

    file.visititems(look)
    if given is not None and given not in stacks:
        raise FrameError(f"{path}: {given} {others.get(given, 'is not a data set of this file')}")
    chosen = given or _default(file)
    pairs = [pair for scheme in schemes_of([f"{name}{ONE_NUMBER}" for name in stacks]) for pair in scheme.pairs]
    for first, second in ([name.removesuffix(ONE_NUMBER) for name in pair] for pair in pairs):
        if chosen == second and given is not None:
            raise FrameError(f"{path}: these are second frames; give {file.filename}@{first}")
        if (chosen == first or (chosen is None and len(pairs) == 1)) and stacks[first][1:] == stacks[second][1:]:
            return [first, second]
    if chosen is None and len(stacks) == 1:
        (chosen,) = stacks
    if chosen is not None:
        return [chosen]
    if stacks:
        some = ", ".join(f"{path}@{name}" for name in list(stacks)[:5])
        raise FrameError(f"{path}: holds several stacks of images; name one: {some}")
    why = "; ".join(f"{name} {reason}" for name, reason in list(others.items())[:3])
    raise FrameError(f"{path}: holds no stack of images{f': {why}' if why else ''}")


def _default(file: Any) -> str | None:  # noqa: ANN401
    """Name of the default plot of a NeXus file: `default` from group to group, then `signal`."""
    place = file
    for _ in range(10):
        name = place.attrs.get("default", place.attrs.get("signal"))
        if not isinstance(name, str) or name not in place:
            return None
        place = place[name]
        if hasattr(place, "dtype"):
            try:
                _Images(place)
            except FrameError:
                return None
            return str(place.name)
        if not hasattr(place, "keys"):
            return None
    return None
