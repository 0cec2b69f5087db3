"""A run goes on with the controllers that it began with: positions mean something else on any other box.

Each session writes into the journal who its controllers say they are.  Two boxes whose cables were swapped, or a
spare one in the place of another, answer every command; only their identity tells.
"""

from collections.abc import Mapping, Sequence

from daq.runs.journal import Entry
from stages.errors import WrongDevice


def require_same_boxes(entries: Sequence[Entry], now: Mapping[str, str]) -> None:
    """Compare the controllers that are open with those of the sessions before.

    Parameters
    ----------
    entries : sequence of dict
        The journal.
    now : mapping of str to str
        Name in the bench file -> identity of the box that answers; "" where it does not tell.

    Raises
    ------
    WrongDevice
        Another box than before answers under a name.
    """
    for entry in entries:
        if entry["kind"] != "session":
            continue
        then = entry.get("controllers", {})
        for name, identity in now.items():
            before = then.get(name, "")
            if not before or not identity or before == identity:
                continue
            others = [other for other, box in then.items() if other != name and box == identity]
            if others:
                cure = f"that is the box that was {others[0]}; swap their cables back"
            else:
                cure = "put the box back that the run began with, or begin a new run"
            raise WrongDevice(f"{name}: {identity!r} answers, and the run began with {before!r}; {cure}")
