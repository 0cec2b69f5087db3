"""Switches of door, shutter and key switch that this program can read, besides the laser's own interlock chain.

    switches: {door: {port: /dev/serial/by-id/usb-switch, line: cts}, key: {by: "mylab.io:KeySwitch"}}

A closed circuit allows light.  An open one, one that cannot be read, and one whose reading hangs do not: a wire
that breaks is an open door.  Each switch is read every `SWITCH_POLL_S` by a thread of its own for as long as the
laser is open, so that neither a stage nor another switch that takes its time can postpone it; what does not allow
light switches off at once.  Nothing here takes the place of the chain that works without a computer, and the
operator of a bench without any switch is reported as having no watch on its door (`Switches.sentence`).
"""

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from typing import Annotated, Any, Literal, Protocol

from pydantic import Field, model_validator

from ground.config import Table
from ground.named_program import import_program
from stages.errors import StageUsageError
from stages.port import ModemLine

SWITCH_POLL_S = 0.01  # between two readings of a switch
SILENCE_S = 1.0  # of one reading, after which its state is unknown
OFF = "rtpiv laser off"  # name of the switch that another process opens (`in_use.OffRequest`)
NO_SWITCH = "no switch of door, shutter or key is read by this program: you alone watch them"


class Switch(Protocol):
    """Something that can be read."""

    def is_closed(self) -> bool:
        """Return whether the circuit is closed, so that light is allowed; any error counts as open."""

    def close(self) -> None:
        """Give it back."""


class SwitchTable(Table):
    """One switch: a modem line of a serial port, or a third-party class."""

    port: Annotated[str, Field(min_length=1)] | None = None
    line: Literal["cts", "dsr", "cd", "ri"] | None = None
    by: str | None = None
    options: dict[str, Any] = {}  # noqa: RUF012 - pydantic copies it

    @model_validator(mode="after")
    def _is_one(self) -> "SwitchTable":
        if self.by is None:
            if self.port is None or self.line is None or self.options:
                raise ValueError('set port and line of a modem line, or by: "package.module:Class" with options')
        elif self.port is not None or self.line is not None or ":" not in self.by:
            raise ValueError('by: set "package.module:Class", and neither port nor line')
        return self

    @property
    def place(self) -> str:
        """Location, in words."""
        return f"{self.line} of {self.port}" if self.by is None else self.by

    def open(self) -> Switch:
        """Open it.

        Raises
        ------
        PortUnavailable, StageUsageError
            It is not there, or cannot be read.
        """
        if self.port is not None and self.line is not None:
            return ModemLine(self.port, self.line)
        try:
            switch: Switch = import_program(str(self.by))(**self.options)
        except (ImportError, AttributeError, TypeError) as error:
            raise StageUsageError(f"the switch {self.by} cannot be opened: {error}") from error
        return switch


class Switches:
    """Every switch of one laser, read all the time; safe for several threads.

    Parameters
    ----------
    switches : mapping of str to Switch
        Open, by what they belong to.
    """

    def __init__(self, switches: Mapping[str, Switch]) -> None:
        self._switches = dict(switches)
        self._closed: dict[str, bool | None] = dict.fromkeys(self._switches)  # as read last
        self._asking_s: dict[str, float] = {}  # since when a reading goes on
        self._ended = threading.Event()
        self._threads: list[threading.Thread] = []

    @classmethod
    def open(cls, tables: Mapping[str, SwitchTable]) -> "Switches":
        """Open all of them; what was opened before an error is given back."""
        with ExitStack() as opened:
            found = {}
            for name, table in tables.items():
                found[name] = table.open()
                opened.callback(found[name].close)
            opened.pop_all()
            return cls(found)

    def add(self, name: str, switch: Switch) -> None:
        """Read one more; before `watch`."""
        self._switches[name], self._closed[name] = switch, None

    def watch(self, opened: Callable[[str], object]) -> None:
        """Begin to read; `opened` is called with a reason after every reading that does not allow light."""
        for name in self._switches:
            self.look(name)
        self._threads = [
            threading.Thread(target=self._go_on, args=(name, opened), name=f"switch {name}", daemon=True)
            for name in self._switches
        ]
        for thread in self._threads:
            thread.start()

    def look(self, name: str) -> str | None:
        """Read one switch now, if there is one; why it does not allow light, as part of a sentence, or None."""
        if name not in self._switches:
            return None
        self._asking_s[name] = time.monotonic()
        try:
            closed: bool | None = bool(self._switches[name].is_closed())
        except Exception:  # whatever it is, its state is unknown
            closed = None
        self._closed[name] = closed
        self._asking_s.pop(name, None)
        return _objection(name, closed)

    def objection(self) -> str | None:
        """Say why light is not allowed now, as part of a sentence; None if every switch is closed."""
        now_s = time.monotonic()
        for name, closed in list(self._closed.items()):
            if now_s - self._asking_s.get(name, now_s) > SILENCE_S:
                closed = None
            if words := _objection(name, closed):
                return words
        return None

    def sentence(self) -> str:
        """Description of what the switches watch, for the person who is asked for the code."""
        names = ", ".join(name for name in self._switches if name != OFF)
        if not names:
            return NO_SWITCH
        return f"read by this program while light is on: {names}; nothing else is"

    def close(self) -> None:
        """Read no more and give them back; one that hangs is left behind."""
        self._ended.set()
        for thread in self._threads:
            thread.join(SILENCE_S)
        for switch in self._switches.values():
            with suppress(Exception):
                switch.close()

    def _go_on(self, name: str, opened: Callable[[str], object]) -> None:
        while not self._ended.wait(SWITCH_POLL_S):
            if words := self.look(name):
                opened(words)


def _objection(name: str, closed: bool | None) -> str | None:
    if name == OFF:
        return None if closed else f"{OFF} was called; look at the laser, then safe()"
    if closed is None:
        return f"the switch of the {name} cannot be read"
    return None if closed else f"the switch of the {name} is open"
