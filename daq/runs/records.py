"""Records that are read back: JSON becomes typed data here, or one sentence with file, line of a journal and key.

What a run wrote may come back with a flipped bit, cut short, or edited.  Every record is checked once, where it is
read, against its seal (runs.seal) and against types: whole numbers within bounds, finite positions, names that
cannot lead out of a folder.  What comes out of here can be computed with; nothing behind has to check it again.
Keys that this version does not know are kept: a newer one may have written them.
"""

import re
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from daq.errors import RunDamaged
from daq.runs.seal import SealBroken, check_seal
from ground.plain_file import read_plain

T = TypeVar("T")
CURE = "restore the file from a copy, or begin a new run"
STRICT = ConfigDict(extra="allow", strict=True, allow_inf_nan=False)
_PLACE = re.compile(r" at line (\d+) column \d+")
MAX_RECORD_BYTES = 500_000_000  # of a record; a plan of a million steps has 300 MB
LONGEST_SHOWN = 40  # characters of a wrong value

Count = Annotated[int, Field(ge=0, le=1_000_000_000)]
Wide = Annotated[int, Field(ge=0, lt=2**64)]  # ids and clocks of cameras
Mm = Annotated[float, Field(ge=-1e7, le=1e7)]
Way = tuple[Mm, Mm, Mm]
Positions = dict[Annotated[str, Field(min_length=1)], Mm]
Crc = Annotated[str, Field(pattern=r"^[0-9a-f]{8}$")]
Sha = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Text = Annotated[str, Field(min_length=1)]
Tag = Annotated[str, Field(pattern=r"^\w[\w.+-]*$", max_length=200)]  # names folders of results


@with_config(STRICT)
class Record(TypedDict):
    """Base of all records: strict types, and keys that are not known are kept."""


def parse_record(adapter: TypeAdapter[T], record: bytes, path: Path, line: int, sealed: bool) -> T:
    """Check one record and return it.

    Parameters
    ----------
    adapter : TypeAdapter
        Its types.
    record : bytes
        A JSON object.
    path, line
        Where it stands, for the message.
    sealed : bool
        Whether it must carry a seal; one that is there is always checked.

    Raises
    ------
    RunDamaged
        In one sentence.
    """
    return _check(adapter, record, f"{path}:{line}", sealed)


def read_record(adapter: TypeAdapter[T], path: Path, sealed: bool) -> T:
    """Read a file that is one record.

    Raises
    ------
    RunDamaged
        It cannot be read, or is not what was written.
    """
    try:
        data = read_plain(path, MAX_RECORD_BYTES)
    except OSError as error:
        raise RunDamaged(f"{path}: cannot be read ({error.strerror}); {CURE}") from None
    return _check(adapter, data, str(path), sealed)


def _check(adapter: TypeAdapter[T], record: bytes, place: str, sealed: bool) -> T:
    """Check the seal, then the types; RunDamaged names the place."""
    try:
        return adapter.validate_json(check_seal(record, sealed))
    except SealBroken as error:
        raise RunDamaged(f"{place}: {error}, so it is not what was written; {CURE}") from None
    except ValidationError as error:
        raise RunDamaged(f"{place}: {sentence_of(error)}; {CURE}") from None


def sentence_of(error: ValidationError) -> str:
    """First of what is wrong, without the end of a sentence."""
    first = error.errors(include_url=False)[0]
    kind, message = first["type"], first["msg"]
    name = ".".join(str(part) for part in first["loc"]) or "it"
    if kind == "json_invalid":
        return "is damaged" + _PLACE.sub("", message.removeprefix("Invalid JSON"))
    if kind == "missing":
        return f"the key {name} is missing"
    if kind == "union_tag_invalid":
        return f"is of a kind that is not known here, {_format_value(first['ctx']['tag'])}"
    if kind == "union_tag_not_found":
        return "does not say of which kind it is"
    if kind == "value_error":
        return message.removeprefix("Value error, ")
    return f"{name} should be {message.removeprefix('Input should be ')}, not {_format_value(first['input'])}"


def _format_value(value: object) -> str:
    text = repr(value)
    return text if len(text) <= LONGEST_SHOWN else text[: LONGEST_SHOWN - 3] + "..."
