"""Pulse generators of Quantum Composers and Berkeley Nucleonics as firmware.

T0 ticks on the world's clock from the moment at which its state was set to 1, whoever listens and whether or not
the host still lives. An output that is on gives a pulse `DEL` after every tick, `WIDT` long, as its mode has it:

    NORM  at every tick       SING  once, then STAT is 0       BURS  BCO times, then STAT is 0
    DCYC  PCO ticks on, OCO ticks off, for ever               WCO   ticks to wait first, in any mode

An output that is switched off gives no pulse that has not begun, and it begins at the tick after it was switched
on. MUX is a sum of outputs whose pulses come out here: that of an output itself has its own bit. With a trigger
mode other than DIS, T0 only waits for an edge that never comes. With autorun, power brings T0 and the outputs
back as they were; else everything is off. The pulses go out at `outputs`.
"""

from collections.abc import Mapping
from typing import Any

from daq.timing.protocols.quantum_composers import Command, CommandStream, shortened
from sim.emulators.device import Clock, serial_number
from sim.mechanics.motion import Motor
from sim.timing_boxes.outputs import Pulse
from sim.timing_boxes.pulsing import PulsingEmulator
from stages.errors import ProtocolViolation

LETTERS = "ABCDEFGH"
LARGEST_COUNT = 9_999_999
T0_WORDS = {
    "PER": "0.1", "MOD": "NORM", "BCO": "1", "PCO": "1", "OCO": "1", "CYCL": "1", "TRIG:MOD": "DIS",
    "TRIG:EDGE": "RIS", "TRIG:LEV": "2.50", "GATE:MOD": "DIS", "GATE:LOG": "HIGH", "GATE:LEV": "2.50",
    "ICL:MOD": "INT", "ICL:RAT": "10", "ICL:LEV": "0.50",
}  # fmt: skip
OUTPUT_WORDS = {
    "WIDT": "0.00001", "DEL": "0", "SYNC": "T0", "POL": "NORM", "CMOD": "NORM", "BCO": "1", "PCO": "1", "OCO": "1",
    "WCO": "0", "CGAT": "DIS", "CLOG": "HIGH", "OUTP:MOD": "TTL", "OUTP:AMPL": "5.00",
}  # fmt: skip
CHOICES = {
    "MOD": ("NORM", "SING", "BURS", "DCYC"), "CMOD": ("NORM", "SING", "BURS", "DCYC"),
    "TRIG:MOD": ("DIS", "TRIG", "DUAL"), "TRIG:EDGE": ("RIS", "FALL"),
    "GATE:MOD": ("DIS", "PULS", "OUTP", "CHAN"), "GATE:LOG": ("LOW", "HIGH"), "ICL:MOD": ("INT", "EXT", "XPL"),
    "POL": ("NORM", "COMP", "INV"), "CGAT": ("DIS", "PULS", "OUTP"), "CLOG": ("LOW", "HIGH"),
    "OUTP:MOD": ("TTL", "ADJ"),
}  # fmt: skip
COUNTS = ("BCO", "PCO", "OCO", "WCO", "CYCL", "MUX", "ICL:RAT")
SECONDS = {"PER": (1e-7, 5000.0, 9), "WIDT": (1e-8, 1000.0, 11), "DEL": (-1000.0, 1000.0, 11)}
LONG_WORDS = {
    "NORMAL": "NORM", "SINGLE": "SING", "BURST": "BURS", "DCYCLE": "DCYC", "DISABLED": "DIS", "ON": "1",
    "OFF": "0", "INVERTED": "INV", "COMPLEMENT": "COMP",
}  # fmt: skip


class _Channel:
    """T0 or an output: its settings, and where it is in its mode."""

    def __init__(self, words: Mapping[str, str]) -> None:
        self.words = dict(words)
        self.on = False
        self.waits = self.done = 0

    def start(self) -> None:
        """Begin the mode anew."""
        self.on, self.done = True, 0
        self.waits = int(self.words.get("WCO", "0"))

    def tick(self, mode: str) -> bool:
        """Whether there is a pulse at this tick."""
        if not self.on:
            return False
        if self.waits > 0:
            self.waits -= 1
            return False
        kind = self.words[mode]
        self.done += 1
        if kind == "DCYC":
            on, off = int(self.words["PCO"]), int(self.words["OCO"])
            return (self.done - 1) % (on + off) < on
        most = {"SING": 1, "BURS": int(self.words["BCO"])}.get(kind)
        if most is not None and self.done >= most:
            self.on = False
        return True


class QuantumComposersEmulator(PulsingEmulator):
    """A box with a number of outputs.

    Parameters
    ----------
    motors : mapping
        None; there for the likeness with other emulators.
    clock : Clock
        Time of the world.
    model : str
        What it says of itself before its serial number.
    outputs : int
        4 or 8.
    serial : int
        Serial number.
    step_s : float
        Widths and delays are rounded to multiples of it.
    echo : bool
        Gives every line back before it answers.
    autorun : bool
        Goes on by itself after a power failure.
    locked : bool
        Whether an external clock is there for XPL.
    """

    def __init__(
        self,
        motors: Mapping[str, Motor],
        clock: Clock,
        model: str = "QC,9528",
        outputs: int = 8,
        serial: int = 2311,
        step_s: float = 5e-9,
        echo: bool = False,
        autorun: bool = False,
        locked: bool = True,
    ) -> None:
        super().__init__(motors, clock)
        self.refuse = 0  # commands to come that are answered by ?8
        self._name = f"{model},{serial:05d},1.2.2-1.2.0"
        self._step_s, self._echo, self._autorun, self.locked = step_s, echo, autorun, locked
        self._stream = CommandStream()
        self._t0 = _Channel(T0_WORDS)
        self._channels = [_Channel({**OUTPUT_WORDS, "MUX": str(1 << number)}) for number in range(outputs)]
        self._last = 1  # number of the pulse that was spoken of last
        if autorun:
            self._t0.start()
            self._period_begins_s = self.event_s

    @classmethod
    def individual(cls, name: str) -> dict[str, Any]:
        """What tells this box from another of its kind."""
        return {"serial": serial_number(name)}

    def is_on_at(self, number: int) -> bool:
        """Whether T0 (0) or an output is on, for tests that look inside."""
        return self._all[number].on

    def set_inside(self, number: int, keyword: str, value: str) -> None:
        """Somebody sets something at the keys of the box."""
        if keyword == "STAT":
            self._switch(number, value == "1")
        else:
            self._all[number].words[keyword] = value

    @property
    def _all(self) -> list[_Channel]:
        return [self._t0, *self._channels]

    def person_stops(self) -> None:
        """The key STOP is pressed."""
        self.advance()
        self._switch(0, False)

    def _begin_period(self, time_s: float) -> None:
        if not self._t0.tick("MOD"):
            active = [False] * len(self._channels)
        else:
            active = [channel.tick("CMOD") for channel in self._channels]
        self._period_begins_s = time_s + float(self._t0.words["PER"]) if self._t0.on else None
        for number, channel in enumerate(self._channels):
            for source, is_active in enumerate(active):
                if is_active and int(channel.words["MUX"]) >> source & 1:
                    words = self._channels[source].words
                    rises_s = time_s + float(words["DEL"])
                    pulse = Pulse(LETTERS[number], rises_s, rises_s + float(words["WIDT"]))
                    self._send(max(rises_s, time_s), number, pulse)

    def _switch(self, number: int, on: bool) -> None:
        channel = self._all[number]
        if on:
            channel.start()
            if number == 0:
                waits_for_edge = self._t0.words["TRIG:MOD"] != "DIS"
                self._period_begins_s = None if waits_for_edge else self.event_s
            return
        channel.on = False
        if number == 0:
            self._end_periods()
        else:
            self._withdraw(number - 1)

    def switch_off(self) -> None:
        """Power fails: no tick, no pulse."""
        super().switch_off()
        self._end_periods()

    def _power_up(self) -> None:
        self._stream = CommandStream()
        self._last = 1
        self._end_periods()
        for channel in self._all:
            channel.on = channel.on and self._autorun
            if channel.on:
                channel.start()
        if self._t0.on:
            self._period_begins_s = self.event_s

    def _take(self, data: bytes) -> None:
        for command in self._stream.feed(data):
            if self._echo and isinstance(command, Command):
                self.say(command.to_bytes())
            self.say(f"{self._answer(command)}\r\n".encode("ascii"))

    def _answer(self, command: Command | ProtocolViolation) -> str:
        if isinstance(command, ProtocolViolation):
            return "?5" if command.raw[:1] in b":*" else "?1"
        if self.refuse > 0:
            self.refuse -= 1
            return "?8"
        if command.keyword.startswith("*"):
            return self._common(command)
        try:
            words = list(shortened(command.keyword))
        except KeyError:
            return "?3"
        return self._obey(words, command)

    def _common(self, command: Command) -> str:
        match command.keyword.upper(), command.asks:
            case "*IDN", True:
                return self._name
            case "*RST", False:
                for number in range(len(self._all)):
                    self._switch(number, False)
                return "ok"
            case "*TRG", False:
                return "?8"
            case "*RST", True:
                return "?7"
        return "?3"

    def _obey(self, words: list[str], command: Command) -> str:
        if words == ["INST", "CAT"]:
            names = ", ".join(["T0", *(f"CH{LETTERS[number]}" for number in range(len(self._channels)))])
            return names if command.asks else "?6"
        if words == ["SYST", "AUT"]:
            return str(int(self._autorun)) if command.asks else self._set_autorun(command.value)
        if words == ["SYST", "COMM", "SER", "ECH"] and not command.asks:
            self._echo = (command.value or "").upper() in ("1", "ON")
            return "ok"
        if words[:1] == ["SPUL"]:
            words = ["PULSE", "0", *words[1:]]
        if words[:1] != ["PULSE"]:
            return "?3"
        rest = words[1:]
        if rest and rest[0].isdecimal():
            self._last = int(rest.pop(0))
        if not rest:
            return "?2"
        if not 0 <= self._last < len(self._all):
            return "?5"
        return self._setting(self._last, ":".join(rest), command)

    def _set_autorun(self, value: str | None) -> str:
        if value not in ("0", "1"):
            return "?5" if value else "?4"
        self._autorun = value == "1"
        return "ok"

    def _setting(self, number: int, keyword: str, command: Command) -> str:
        channel = self._all[number]
        if keyword != "STAT" and keyword not in channel.words:
            return "?3"
        if command.asks:
            return str(int(channel.on)) if keyword == "STAT" else self._shown(channel, keyword)
        if command.value is None:
            return "?4"
        value = LONG_WORDS.get(command.value.upper(), command.value.upper())
        if keyword == "STAT":
            if value not in ("0", "1"):
                return "?5"
            self._switch(number, value == "1")
            return "ok"
        if keyword in SECONDS:
            return self._set_seconds(channel, keyword, value)
        if keyword in COUNTS:
            least = 0 if keyword in ("WCO", "MUX") else 1
            if not value.isdecimal() or not least <= int(value) <= LARGEST_COUNT:
                return "?5"
        elif keyword == "SYNC":
            if value not in ("T0", *(f"CH{LETTERS[other]}" for other in range(len(self._channels)))):
                return "?5"
        elif keyword in CHOICES and value not in CHOICES[keyword]:
            return "?5"
        channel.words[keyword] = value
        return "ok"

    def _set_seconds(self, channel: _Channel, keyword: str, value: str) -> str:
        low_s, high_s, _ = SECONDS[keyword]
        try:
            seconds = float(value)
        except ValueError:
            return "?5"
        if not low_s <= seconds <= high_s:
            return "?5"
        channel.words[keyword] = repr(round(seconds / self._step_s) * self._step_s)
        return "ok"

    def _shown(self, channel: _Channel, keyword: str) -> str:
        value = channel.words[keyword]
        if keyword in SECONDS:
            return f"{float(value):.{SECONDS[keyword][2]}f}"
        if keyword == "ICL:MOD" and value == "XPL" and not self.locked:
            return "XPL?"
        return value


EMULATOR = QuantumComposersEmulator
