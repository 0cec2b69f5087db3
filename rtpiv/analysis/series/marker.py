"""The marker of a chunk: beside its file, what that was made from and the hash of its bytes.

A file without a marker is none: the marker is written last.  Existence alone proves nothing, so whoever uses a
chunk compares both hashes.
"""

import hashlib
from dataclasses import asdict
from pathlib import Path

from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from daq.atomic_write import write_json
from daq.runs.records import Count, Sha
from ground.plain_file import read_plain

MARKER_BYTES = 10_000_000
CHUNK_BYTES = 2_000_000_000


@dataclass(frozen=True, config=ConfigDict(strict=True, extra="forbid"))
class Marker:
    """What is known of a chunk's file.

    Parameters
    ----------
    key : str
        Of the job that it was made by, see `ChunkJob.key`.
    sha256 : str
        Of its bytes.
    size : int
        How many these are: what is cut short is seen without reading it.
    pairs : int
        Pairs in it.
    failed : dict of str to str
        Those of them without vectors, by tag, and why.
    """

    key: Sha
    sha256: Sha
    size: Count
    pairs: Count
    failed: dict[str, str]


_MARKER: TypeAdapter[Marker] = TypeAdapter(Marker)


def marker_path(path: Path) -> Path:
    """Marker of a chunk's file."""
    return path.with_suffix(".json")


def write_marker(path: Path, key: str, content: bytes, pairs: int, failed: dict[str, str]) -> Marker:
    """Mark the chunk's file at `path`, which holds `content`, as whole; DiskError if that cannot be written."""
    marker = Marker(key, hashlib.sha256(content).hexdigest(), len(content), pairs, failed)
    write_json(marker_path(path), asdict(marker), among_many=True)
    return marker


def marker_of(path: Path, key: str | None = None) -> Marker | None:
    """Marker of a chunk's file that is of this key (or any) and as long as the file; its bytes are not read."""
    try:
        marker = _MARKER.validate_json(read_plain(marker_path(path), MARKER_BYTES))
        size = path.stat().st_size
    except (OSError, ValidationError):
        return None
    return marker if key in (None, marker.key) and marker.size == size else None


def sound_content(path: Path, key: str) -> tuple[Marker, bytes] | None:
    """Marker and bytes of a chunk's file; None if it is missing, of another key, or not what was written."""
    marker = marker_of(path, key)
    try:
        content = read_plain(path, CHUNK_BYTES)
    except OSError:
        return None
    is_sound = marker is not None and marker.sha256 == hashlib.sha256(content).hexdigest()
    return (marker, content) if marker is not None and is_sound else None
