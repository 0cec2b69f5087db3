"""The books of a whole run from its journal: those of its sessions, added up, and what is in doubt about them.

A doubt is a reason why some frame of the run may not show what its record says: books that do not balance, or a
frame that could not be given to its trigger.  It never goes away by taking more frames, so a run with one is never
done and is not resumed; its frames stay where they are.
"""

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
        lines = [line for line in entries[first + 1 : last] if line["kind"] != "camera"]  # these count nothing
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


def doubts(entries: Sequence[Entry]) -> list[str]:
    """Return what is in doubt about a run, one sentence each, without full stop; [] if nothing is.

    Sessions say so themselves (key `doubt` of their lines, lines of the kind `doubt`); books that do not balance
    are a doubt whether they were called one or not.
    """
    found: list[str] = []
    for entry in entries:
        said = entry.get("doubt")
        if said is not None:
            found.append(str(said))
        elif entry["kind"] == "counts":
            books = Ledger.from_dict(entry["books"])
            if books.imbalance:
                found.append(f"the books of a session do not balance ({books.sentence()})")
    return list(dict.fromkeys(found))
