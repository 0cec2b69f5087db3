"""Texts and copies that are whole or not there, on the disk before they are reported, name included."""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from daq.errors import DiskError
from ground.printable import utf8
from ground.whole_file import whole_file

TRY_AGAIN, GIVE_AGAIN = "make room, then try again", "make room, then give the same command again"
OTHER_FOLDER = "choose another folder with -o"


@contextmanager
def disk_errors(place: Path, cure: str = TRY_AGAIN) -> Iterator[None]:
    """Raise what the disk refuses within the block as DiskError, with the place and the cure."""
    try:
        yield
    except OSError as error:
        raise DiskError(f"{place}: {why(error)}; {cure}") from error


def write_text(path: Path, text: str, among_many: bool = False) -> None:
    """Write a text as `write_bytes` does; `among_many` as for `whole_file`."""
    write_bytes(path, utf8(text), among_many)


def write_bytes(path: Path, content: bytes, among_many: bool = False, cure: str = TRY_AGAIN) -> None:
    """Write a file: temporary name, fsync, rename, fsync of the folder; DiskError if that fails."""
    with disk_errors(path, cure):
        with whole_file(path, among_many=among_many) as stream:
            stream.write(content)
        sync_folder(path.parent)


def write_json(path: Path, tree: Any, among_many: bool = False) -> None:  # noqa: ANN401 - anything JSON can hold
    """Write plain data as `write_text` does."""
    write_text(path, json.dumps(tree, indent=1, ensure_ascii=False), among_many)


def copy_whole(source: Path, copy: Path) -> None:
    """Copy a file as `write_text` writes one; onto itself is nothing to do.

    Raises
    ------
    DiskError
        It cannot be written.
    """
    if source.resolve() == copy.resolve():
        return
    with disk_errors(copy, GIVE_AGAIN), source.open("rb") as stream, whole_file(copy) as written:
        shutil.copyfileobj(stream, written)


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def why(error: OSError) -> str:
    """Reason of a failed write; arrays that the disk took only a part of come without one."""
    return error.strerror or f"the disk is full, it took only a part ({error})"
