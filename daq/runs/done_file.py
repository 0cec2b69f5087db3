"""done.json: the last thing a run writes, and the only sign that it is finished.

Its key `sha256` is the hash of the whole run: one number that stands for everything that was acquired.  It is the
SHA-256 of a text in UTF-8 that has one line for each file, sorted by name and ended by a line feed:

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
from typing import Annotated, NotRequired

from pydantic import Field, TypeAdapter

from daq.errors import RunDamaged
from daq.runs.journal_lines import AccountRecord, FlowFigures, Gap
from daq.runs.records import CURE, Count, Record, Sha, Tag, Text, read_record
from daq.runs.run_file import SEALED_FROM
from daq.runs.run_folder import RunFolder
from ground.plain_file import open_plain

FILE = "done.json"
Signed = Annotated[int, Field(ge=-1_000_000_000, le=1_000_000_000)]


class SessionEnd(Record):
    """End of a session, and its account: below 0 where it discarded what an earlier one had written."""

    utc: Text
    ended: Text
    error: str
    conservation: dict[Text, Signed]


class StepGaps(Record):
    """Frames that a step never got."""

    step: Count
    tag: Tag
    gaps: list[Gap]


class DoneFile(Record):
    """A whole done.json."""

    utc: Text
    steps: Count
    frames: Count
    conservation: AccountRecord
    sessions: list[SessionEnd]
    corrected_after_the_run: Count
    gaps: NotRequired[list[StepGaps]]
    flow: list[FlowFigures]
    sha256: NotRequired[Sha]  # of the whole run, see `run_hash`; since layout 2


DONE_FILE: TypeAdapter[DoneFile] = TypeAdapter(DoneFile)


def read_done(folder: RunFolder) -> DoneFile | None:
    """Read done.json; None while the run is not finished.

    Raises
    ------
    RunDamaged
        It is not what was written.
    """
    if not folder.is_done:
        return None
    return read_record(DONE_FILE, folder.path / FILE, folder.about["layout"] >= SEALED_FROM)


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
