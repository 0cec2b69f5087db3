"""A record that shows damage: its last key is the checksum of everything before it.

    {"kind":"step","step":3,"tag":"target_clear","seal":"0f3a9c12"}

The seal is the CRC-32 of the bytes from the opening brace up to the last value, without the comma before "seal".
Types alone cannot tell that 0.5001 mm once was 0.5002 mm; the seal can, in any line of a journal, in run.json, in
done.json and in every displacement.  It finds every damage of up to 32 neighbouring bits and lets one in four
thousand million of all others pass.  It guards against disks and copies, not against people: those who edit a
record can seal it again.

Runs of layout 1 were written without seals; a seal that is there is checked in them too.
"""

import json
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from daq.atomic_write import write_text

_SEAL = re.compile(rb',\s*"seal":\s*"([0-9a-f]{8})"\s*\}\s*\Z')
_LONGEST = 64  # bytes that a seal and the end of its record take, with room for line ends


class SealBroken(ValueError):  # noqa: N818 - says what it is
    """A record is not what was sealed; the text says in what way, as the rest of a sentence."""


def add_seal(record: bytes) -> bytes:
    """Return a JSON object with its seal as the last key.

    Parameters
    ----------
    record : bytes
        A JSON object with one key at least, ending in ``}``; one that is laid out in lines keeps that look.
    """
    body = record.rstrip()[:-1].rstrip()
    before, after = (b"\n ", b"\n") if b"\n" in body else (b"", b"")
    colon = b'": "' if before else b'":"'
    return b"".join((body, b",", before, b'"seal', colon, b"%08x" % zlib.crc32(body), b'"', after, b"}"))


def check_seal(record: bytes, required: bool) -> bytes:
    """Check the seal of a record; return the record without it.

    Parameters
    ----------
    record : bytes
        A JSON object; white space may follow.
    required : bool
        Whether a record without a seal is refused.

    Raises
    ------
    SealBroken
        The bytes are not those that were sealed, or there is no seal.
    """
    found = _SEAL.search(record, max(0, len(record) - _LONGEST))
    if found is None:
        if required:
            raise SealBroken("has no seal")
        return record
    body = record[: found.start()]
    if b"%08x" % zlib.crc32(body) != found[1]:
        raise SealBroken("does not agree with its seal")
    return body + b"}"


def write_record(path: Path, tree: Mapping[str, Any]) -> None:
    """Write a record of a run, with its seal, as `write_text` does."""
    write_text(path, add_seal(json.dumps(tree, indent=1, allow_nan=False).encode()).decode() + "\n")
