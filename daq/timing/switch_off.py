"""Off without a bench: asked of the program that holds the port, and sent to the box past it.

The program is asked first (`in_use.request_off`), so that it switches nothing on any more; the bytes that switch
off go out at once afterwards, several times, as the watchdog writes them.  Only then is the box opened and asked,
or the program that holds its port has done that.  It takes no laser, no scene and no head: in an emergency nothing
that is not needed may be in the way.
"""

import os
import time
from dataclasses import dataclass
from pathlib import Path

from daq.timing.box import UNREADABLE, TimingBox
from daq.timing.drivers_by_name import driver_class
from daq.timing.in_use import request_off
from daq.timing.timing_table import TimingTable
from stages.errors import PortUnavailable
from stages.watchdog import stop, word_of

CONFIRM_TIMEOUT_S = 3.0  # for the program that holds the port to read back that everything is off
OFF_POLL_S = 0.05


@dataclass(frozen=True)
class SwitchedOff:
    """Result of an attempt to switch off.

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
    requests = request_off(table.port)
    if not stop(word_of("laser", table.port, baud, False, box.off_bytes())):
        return SwitchedOff(False, f"NOT reached, {table.port} takes no bytes: use the laser's own key")
    end_s = time.monotonic() + CONFIRM_TIMEOUT_S
    try:
        while not _is_read_back(box, table.port, baud):
            if done := next((request for request in requests if request.is_confirmed()), None):
                return SwitchedOff(
                    True, f"off, and reads back as off to process {done.process}, which has it open"
                )
            if not requests or time.monotonic() > end_s:
                words = "off was sent past the program that holds its port, and could not be read back"
                return SwitchedOff(False, f"{words}: look at its panel")
            time.sleep(OFF_POLL_S)
    except UNREADABLE as error:
        return SwitchedOff(False, f"off was sent and does NOT read back ({error}): use its key and its STOP")
    if table.identity is not None and table.identity not in box.identity:
        return SwitchedOff(False, f"NOT reached, {box.identity!r} answers instead: use the laser's own key")
    return SwitchedOff(True, f"off, and reads back as off ({box.identity})")


def _is_read_back(box: TimingBox, port: str, baud: int) -> bool:
    """Open a box, switch it off and read it back; False if another program holds its port."""
    try:
        box.connect(port, baud)
    except PortUnavailable:
        return False
    try:
        box.silence()
    finally:
        box.close()
    return True
