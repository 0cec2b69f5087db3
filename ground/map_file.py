"""Store maps: plain arrays and a JSON header in one zip, no pickle, nothing trusted.

A file is an uncompressed .npz with one extra member ``header`` (UTF-8 JSON as bytes): what kind of map it
is, the layout version, the hash of the scene, and what the map itself wants to keep.  Before an array is
read, its declared shape is compared with the bytes really there, so a damaged or hostile file cannot make
the reader allocate memory.  Writing goes to a temporary name, is flushed to disk, then renamed.
"""

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.errors import MapFileError
from ground.whole_file import whole_file

LAYOUT = 1
HEADER_BYTES = 1_000_000


def save_arrays(path: Path | str, kind: str, header: dict[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write `arrays` with a JSON `header` to `path`, atomically.

    Parameters
    ----------
    path : path
        Final name.
    kind : str
        What the file holds; `load_arrays` asks for it.
    header : dict
        JSON-able.
    arrays : dict of name -> array
        No object arrays.
    """
    path = Path(path)
    text = json.dumps({"kind": kind, "layout": LAYOUT, **header}, sort_keys=True)
    with whole_file(path) as stream:
        np.savez(stream, allow_pickle=False, header=np.frombuffer(text.encode(), np.uint8), **arrays)


def load_arrays(path: Path | str, kind: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read what `save_arrays` wrote.

    Returns
    -------
    header, arrays

    Raises
    ------
    MapFileError
        Missing, damaged, of another kind or layout.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = {info.filename.removesuffix(".npy"): _member(archive, info) for info in archive.infolist()}
        text = arrays.pop("header").tobytes()
        if len(text) > HEADER_BYTES:
            raise ValueError(f"a header of {len(text)} bytes")
        header = json.loads(text.decode())
        found, layout = header.pop("kind"), header.pop("layout")
    except OSError as error:
        raise MapFileError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (zipfile.BadZipFile, KeyError, ValueError, EOFError, TypeError, AttributeError, RuntimeError) as error:
        raise MapFileError(f"{path}: is damaged or no map file ({error}); trace the scene again") from None
    if found != kind:
        raise MapFileError(f"{path}: holds a {found}, not a {kind}")
    if layout != LAYOUT:
        raise MapFileError(f"{path}: has layout {layout}, this version reads {LAYOUT}; trace the scene again")
    return header, arrays


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    """Read one array after checking its declared size against the bytes present."""
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > Path(str(archive.filename)).stat().st_size:
        raise ValueError(f"member {info.filename!r} is not stored plainly")
    with archive.open(info) as stream:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise ValueError(f"member {info.filename!r} has an unknown header")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream, max_header_size=10_000)
        size = int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
        if dtype.hasobject or fortran or size != info.file_size - stream.tell():
            raise ValueError(f"member {info.filename!r} does not have the size it declares")
        return np.frombuffer(bytearray(stream.read(size)), dtype).reshape(shape)
