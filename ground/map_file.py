"""Store maps: plain arrays and a JSON header in one zip, no pickle, nothing trusted.

A file is an uncompressed .npz with one extra member ``header`` (UTF-8 JSON as bytes): what kind of map it
is, the layout version, the hash of the scene, and what the map itself wants to keep.  Before an array is
read, its declared shape is compared with the bytes really there, so a damaged or hostile file cannot make
the reader allocate memory; what an array holds is said in the one form that numpy writes, and nothing of it is
evaluated.  Each kind of map has a model of its header (`check_header`).  Writing goes to a temporary name, is
flushed to disk, then renamed.
"""

import json
import os
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from ground.config import Table
from ground.errors import MapFileError
from ground.plain_file import open_plain
from ground.whole_file import whole_file

LAYOUT = 1
HEADER_BYTES = 1_000_000
MOST_SAID = 120  # characters of what a library says
_MAGIC = b"\x93NUMPY\x01\x00"
_ARRAY = re.compile(  # as numpy writes it, of plain numbers
    rb"\{'descr': '(?P<kind>[<>|][biufc][0-9]{1,2})', 'fortran_order': False, "
    rb"'shape': \((?P<shape>(?:[0-9]{1,18}(?:, [0-9]{1,18}){0,7},?)?)\), \} *\n"  # one way to match: soon done
)
Header = TypeVar("Header", bound=Table)
Hash = Annotated[str, Field(min_length=1, max_length=64)]


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
        with open_plain(path) as stream, zipfile.ZipFile(stream) as archive:
            length = os.fstat(stream.fileno()).st_size
            arrays = {
                info.filename.removesuffix(".npy"): _member(archive, info, length) for info in archive.infolist()
            }
        text = arrays.pop("header").tobytes()
        if len(text) > HEADER_BYTES:
            raise ValueError(f"a header of {len(text)} bytes")
        header = json.loads(text.decode(), parse_constant=_refuse)
        found, layout = header.pop("kind"), header.pop("layout")
    except OSError as error:
        raise MapFileError(f"{path}: cannot be read: {error.strerror or error}") from None
    except MemoryError:
        raise
    except Exception as error:  # whatever zip and JSON make of damage
        said = "".join(c if c.isprintable() else "?" for c in str(error))[:MOST_SAID]
        raise MapFileError(f"{path}: is damaged or no map file ({said}); trace the scene again") from None
    if found != kind:
        raise MapFileError(f"{path}: holds a {str(found)[:MOST_SAID]}, not a {kind}")
    if layout != LAYOUT:
        said = str(layout)[:MOST_SAID]
        raise MapFileError(f"{path}: has layout {said}, this version reads {LAYOUT}; trace the scene again")
    return header, arrays


def check_header(path: Path | str, header: dict[str, Any], model: type[Header]) -> Header:
    """Check the header of a map against its model.

    Raises
    ------
    MapFileError
        Something is missing, or is not what it should be.
    """
    try:
        return model.model_validate(header)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = ".".join(str(part) for part in first["loc"])[:MOST_SAID]
        if first["type"] == "missing":
            raise MapFileError(f"{path}: lacks '{name}'; make it again") from None
        raise MapFileError(f"{path}: the header is damaged at '{name}' ({first['msg']}); make it again") from None


def _refuse(word: str) -> NoReturn:
    raise ValueError(f"{word} in the header")


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, length: int) -> NDArray[Any]:
    """Read one array after checking its declared size against the bytes present."""
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > length:
        raise ValueError(f"member {info.filename!r} is not stored plainly")
    with archive.open(info) as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise ValueError(f"member {info.filename!r} has an unknown header")
        said = _ARRAY.fullmatch(stream.read(int.from_bytes(stream.read(2), "little")))
        if said is None:
            raise ValueError(f"member {info.filename!r} is not described as numpy does it")
        dtype = np.dtype(said["kind"].decode())
        shape = [int(number) for number in re.findall(rb"[0-9]+", said["shape"])]
        size = int(np.prod(shape, dtype=object)) * dtype.itemsize
        if size != info.file_size - stream.tell():
            raise ValueError(f"member {info.filename!r} does not have the size it declares")
        return np.frombuffer(bytearray(stream.read(size)), dtype).reshape(shape)
