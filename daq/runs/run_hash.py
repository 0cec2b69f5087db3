"""The hash of a whole run: one number that stands for everything that was acquired.

done.json keeps it under `sha256`.  It is the SHA-256 of a text in UTF-8 that has one line for each file, sorted by
name and ended by a line feed:

    sha256 <64 hex digits>  camera_1.json
    crc32 <8 hex digits>  frames/000000.tif
    crc32 <8 hex digits>  frames/000001.tif
    sha256 <64 hex digits>  run.json
    sha256 <64 hex digits>  steps.jsonl

A frame stands there with the CRC-32 of its pixels (rows from the top, 16 bit little-endian) as the journal has it,
because the pixels are what was measured and any container may hold them; every frame of the journal that was not
discarded is listed.  The other files are hashed byte by byte: run.json, steps.jsonl, every camera_*.json, and
displacements.json where a run has one.  What can be made again (corrected frames, reports) is not part of a run.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path

from daq.errors import RunDamaged
from daq.runs.records import CURE
from ground.plain_file import open_plain

ALWAYS = ("run.json", "steps.jsonl")
PATTERNS = ("camera_*.json", "displacements.json")


def run_hash(folder: Path, frames: Mapping[str, str]) -> str:
    """Return the hash of a run, 64 hex digits.

    Parameters
    ----------
    folder : Path
        The run.
    frames : mapping of str to str
        CRC-32 of the pixels of every acknowledged frame, by its name within the run.

    Raises
    ------
    RunDamaged
        A file is missing or cannot be read.
    """
    lines = {name: f"crc32 {crc32}" for name, crc32 in frames.items()}
    for name in (*ALWAYS, *(path.name for pattern in PATTERNS for path in folder.glob(pattern))):
        try:
            with open_plain(folder / name) as file:
                lines[name] = f"sha256 {hashlib.file_digest(file, 'sha256').hexdigest()}"
        except OSError as error:
            raise RunDamaged(f"{folder / name}: cannot be read ({error.strerror}); {CURE}") from None
    text = "".join(f"{digits}  {name}\n" for name, digits in sorted(lines.items()))
    return hashlib.sha256(text.encode()).hexdigest()
