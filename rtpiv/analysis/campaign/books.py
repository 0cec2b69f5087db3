"""What was done in a campaign, a line for each try: provenance, and from what it is known how long the rest takes.

The client writes it, one line after the other.  A line that a crash has torn is passed over: nothing is computed
from these lines, and a chunk is believed by its marker alone.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from daq.errors import DiskError
from daq.runs.records import STRICT, Count, Sha
from daq.whole_text import why
from ground.plain_file import open_plain

LONGEST_LINE = 100_000


@with_config(STRICT)
class BookLine(TypedDict):
    """One try of one chunk."""

    utc: str
    run: str
    chunk: Count
    key: Sha
    what: Literal["made", "failed"]
    pairs: Annotated[int, Field(ge=1)]
    seconds: Annotated[float, Field(ge=0.0)]
    host: str
    pid: Count
    reason: str


_LINE: TypeAdapter[BookLine] = TypeAdapter(BookLine)


def read_books(path: Path) -> Iterator[BookLine]:
    """Lines that can be read, in the order in which they were written."""
    try:
        with open_plain(path) as stream:
            while line := stream.readline(LONGEST_LINE):
                try:
                    yield _LINE.validate_json(line)
                except ValidationError:
                    continue
    except OSError:
        return


def write_book(path: Path, line: BookLine) -> None:
    """Append a line; DiskError if it cannot be written."""
    try:
        with path.open("ab+") as stream:
            if stream.tell() > 0:
                stream.seek(-1, 2)
                if stream.read(1) != b"\n":  # torn by a crash
                    stream.write(b"\n")
            stream.write(json.dumps(line).encode() + b"\n")
    except OSError as error:
        raise DiskError(f"{path}: {why(error)}; make room, then give the same command again") from error
