"""The marker of a chunk: beside its file, what that was made from and the hash of its bytes.

A file without a marker is none: the marker is written last.  Existence alone proves nothing, so whoever uses a
chunk compares both hashes.
"""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

from daq.whole_text import write_json


@dataclass(frozen=True)
class Marker:
    """What is known of a chunk's file.

    Parameters
    ----------
    key : str
        Of the job that it was made by, see `ChunkJob.key`.
    sha256 : str
        Of its bytes.
    pairs : int
        Pairs in it.
    failed : dict of str to str
        Those of them without vectors, by tag, and why.
    """

    key: str
    sha256: str
    pairs: int
    failed: dict[str, str]


def marker_path(path: Path) -> Path:
    """Marker of a chunk's file."""
    return path.with_suffix(".json")


def write_marker(path: Path, key: str, pairs: int, failed: dict[str, str]) -> Marker:
    """Mark the chunk's file at `path` as whole; DiskError if that cannot be written."""
    marker = Marker(key, hashlib.sha256(path.read_bytes()).hexdigest(), pairs, failed)
    write_json(marker_path(path), asdict(marker))
    return marker


def sound_content(path: Path, key: str) -> tuple[Marker, bytes] | None:
    """Marker and bytes of a chunk's file; None if it is missing, of another key, or not what was written."""
    try:
        tree = json.loads(marker_path(path).read_bytes())
        content = path.read_bytes()
        marker = Marker(**tree)
    except (OSError, ValueError, TypeError, RecursionError):
        return None
    is_sound = marker.key == key and marker.sha256 == hashlib.sha256(content).hexdigest()
    return (marker, content) if is_sound and isinstance(marker.failed, dict) else None
