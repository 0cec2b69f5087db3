"""Texts and copies that are whole or not there, on the disk before they are reported, name included."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

from daq.errors import DiskError
from ground.printable import utf8
from ground.whole_file import whole_file


def write_text(path: Path, text: str, among_many: bool = False) -> None:
    """Write a text: temporary name, fsync, rename, fsync of the folder; `among_many` as for `whole_file`.

    Raises
    ------
    DiskError
        It cannot be written.
    """
    try:
        with whole_file(path, among_many=among_many) as stream:
            stream.write(utf8(text))
        sync_folder(path.parent)
    except OSError as error:
        raise DiskError(f"{path}: {why(error)}; make room, then try again") from error


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
    try:
        with source.open("rb") as stream, whole_file(copy) as written:
            shutil.copyfileobj(stream, written)
    except OSError as error:
        raise DiskError(f"{copy}: {why(error)}; make room, then give the same command again") from error


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
