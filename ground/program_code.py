"""Hash of the code that computes: a stored result is read by the code that made it alone.

A version does not say it.  In a checkout that is brought up to date, and between two releases, it stays what it is
while numbers change.  The text of the sources does not, comments included: a computation may be made anew for
nothing, and none is believed for too long.
"""

import hashlib
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


@cache
def code_digest(*parts: str) -> str:
    """Return a digest (16 hex digits) of all sources in folders of the program, as they were when first asked for.

    Parameters
    ----------
    *parts : str
        Folders beside each other or below, such as "tracer" or "rtpiv/analysis/series".
    """
    digest = hashlib.sha256()
    for part in parts:
        for path in sorted((ROOT / part).rglob("*.py")):
            text = path.read_bytes().replace(b"\r\n", b"\n")  # as git writes it on other systems
            digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + text + b"\0")
    return digest.hexdigest()[:16]
