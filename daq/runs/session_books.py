"""The books of a whole run from its journal: those of its sessions, added up."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from daq.runs.conservation import Ledger
from daq.runs.journal import Entry


def total_ledger(entries: Sequence[Entry]) -> tuple[Ledger, list[dict[str, Any]]]:
    """Add the books of all sessions up.

    A session that was killed has none; its frame lines stand for it, and what was under way is not known.  Frames
    that a session discards at its beginning were written by an earlier one.
    """
    starts = [index for index, entry in enumerate(entries) if entry["kind"] == "session"]
    total, sessions = Ledger(), []
    for first, last in pairwise([*starts, len(entries)]):
        lines = entries[first + 1 : last]
        books = next((Ledger.from_dict(line["books"]) for line in lines if line["kind"] == "counts"), None)
        end = next((line for line in lines if line["kind"] == "end"), None)
        was_killed = books is None
        if books is None:
            written = sum(line["kind"] == "frame" for line in lines)
            books = Ledger(triggered=written, written=written)
        for number, line in enumerate(lines):
            if line["kind"] == "discard" and (number == 0 or was_killed):
                books += Ledger(written=-len(line["frames"]), rejected=len(line["frames"]))
        total += books
        why = {"ended": "killed", "error": ""} if end is None else {"ended": end["why"], "error": end["error"]}
        sessions.append({"utc": entries[first]["utc"], **why, "conservation": books.to_dict()})
    return total, sessions
