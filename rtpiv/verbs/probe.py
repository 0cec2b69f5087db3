"""`rtpiv doctor --probe`: identify the device on a port; nothing moves, nothing fires."""

import re
from pathlib import Path

from daq.bench.probe import RATES, Found, no_reply_reason
from daq.bench.probe import probe as ask_port
from ground.terminal import console
from ground.whole_file import whole_file
from rtpiv.analysis.report.table import ALL_COLUMNS, Table
from rtpiv.verbs.paths import Named, path_of
from stages.errors import NoReply


def probe(port: str, /, out: Named | None = None) -> Found:
    """Identify the device on a port, at common rates and by every protocol; nothing moves, nothing fires.

    Parameters
    ----------
    port : str
        Serial port, such as /dev/serial/by-id/usb-...
    out : path, optional
        File of the dialogue, for reports; default probe-PORT.txt.

    Returns
    -------
    Found
        What answers, and the lines of a bench file.

    Raises
    ------
    PortUnavailable, DeviceLost
        The port cannot be opened, or goes away meanwhile.
    NoReply
        Nothing answers as it should; the sentence says what came.
    """
    path = path_of(out) or Path(f"probe-{re.sub(r'[^A-Za-z0-9]+', '-', port).strip('-')}.txt")
    console().print(f"asking {port} at {', '.join(map(str, RATES))} baud; questions only")
    found, asked = ask_port(port)
    head = f"# rtpiv doctor --probe {port}: {'no reply' if found is None else found.identity}\n"
    with whole_file(path) as file:
        file.write((head + "".join(f"{line}\n" for line in asked.dialogue)).encode())
    if found is None:
        raise NoReply(f"{no_reply_reason(asked)}; the dialogue is in {path}")
    rows = [("identity", found.identity), ("rate", f"{found.baud} baud")]
    rows += [("", fact) for fact in found.facts] + [("cannot be asked", unknown) for unknown in found.unknown]
    console().print(Table(f"{found.box} on {port}", ("", "reply"), rows, left=ALL_COLUMNS))
    console().print("Lines for a bench file:\n")
    console().print(found.lines, soft_wrap=True, markup=False, highlight=False)
    console().print(f"\ndialogue: {path}")
    return found
