"""Off without a bench: said to a box past whoever holds its port, and read back if nobody does.

The bytes that switch off go out first, several times, as the watchdog writes them; only then is the box opened and
asked.  It takes no laser, no scene and no head: in an emergency nothing that is not needed may be in the way.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from daq.timing.box import UNREADABLE
from daq.timing.drivers_by_name import driver_class
from daq.timing.timing_table import TimingTable
from stages.errors import PortUnavailable
from stages.watchdog import stop, word_of


@dataclass(frozen=True)
class SwitchedOff:
    """What became of it.

    Parameters
    ----------
    confirmed : bool
        Every output reads back as off.
    words : str
        The same as a part of a sentence.
    """

    confirmed: bool
    words: str


def switch_off(table: TimingTable) -> SwitchedOff:
    """Say off to a timing unit, and read it back.

    Parameters
    ----------
    table : TimingTable
        Box, port, channels and identity are looked at, and nothing else.
    """
    if os.name == "posix" and "://" not in table.port and not Path(table.port).is_char_device():
        why = "is no serial port" if Path(table.port).exists() else "does not exist"
        return SwitchedOff(False, f"NOT reached, {table.port} {why}: use the laser's own key")
    box = driver_class(table.box)("laser", table.wiring)
    box.address = table.identity or ""
    baud = table.baud or box.default_baud
    if not stop(word_of("laser", table.port, baud, False, box.off_bytes())):
        return SwitchedOff(False, f"NOT reached, {table.port} takes no bytes: use the laser's own key")
    try:
        box.connect(table.port, baud)
        try:
            box.silence()
        finally:
            box.close()
    except PortUnavailable:
        words = "off was sent past the program that holds its port, and could not be read back: look at its panel"
        return SwitchedOff(False, words)
    except UNREADABLE as error:
        return SwitchedOff(False, f"off was sent and does NOT read back ({error}): use its key and its STOP")
    if table.identity is not None and table.identity not in box.identity:
        return SwitchedOff(False, f"NOT reached, {box.identity!r} answers instead: use the laser's own key")
    return SwitchedOff(True, f"off, and reads back as off ({box.identity})")
