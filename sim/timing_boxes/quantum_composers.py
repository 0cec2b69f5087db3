"""Pulse generators of Quantum Composers and Berkeley Nucleonics as firmware.

T0 ticks on the world's clock from the moment at which its state was set to 1, with or without a listener
and a living host. An output that is on gives a pulse `DEL` after every tick, `WIDT` long, as its mode has it:

    NORM  at every tick       SING  once, then its output is inhibited       BURS  BCO times, then inhibited
    DCYC  PCO ticks on, OCO ticks off, for ever               WCO   ticks to wait first, in any mode

**What arms a burst** (`arms`). "Channels are armed by the RUN button. In single shot and burst modes channells
may be rearmed by pressing the RUN a second time" (9530 manual p. 14; 525 manual 5.1 says the same), and the state
of T0 is that button (575 manual, 8: system pulse). A burst goes "'n' times, after which output is inhibited" (575
manual p. 5-11, 9520 manual p. 16): STAT stays as it was written. The manuals leave open whether RUN arms an output
that is off, so there is a box of either kind, and one of the kind that was believed in before the manuals
were read:

    "run"        RUN arms what is on; an output that is switched on while T0 runs gives nothing until RUN
    "run all"    RUN arms all; one that is switched on later gives its pulses then
    "state"      its own STAT arms an output and is 0 again at the end of the burst; no manual says so

An output that is switched off gives no pulse that has not begun, and it begins at the tick after it was switched
on. MUX is a sum of outputs whose pulses come out here: that of an output itself has its own bit. With a trigger
mode other than DIS, T0 waits for an edge, which only the word *TRG gives: one tick, or the ticks of a burst. With
autorun, power brings T0 and the outputs
back as they were; else everything is off. The pulses go out at `outputs`.

Gate: in mode OUTP outputs are inhibited while the input is not at the level of GAT:LOG, and what counts goes on
counting; that this is what the two words mean is unproven.

Clock: a 9530 has a mode (ICL:MOD), a 575, 9510 or 9520 one word (ICL SYS|EXT10.., 575 manual v5.6 p. 8-38).
Keywords are obeyed in full or by their capitals (575 manual p. 8-34).
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from daq.timing.protocols.quantum_composers import Command, CommandStream, short_forms
from sim.emulators.device import Clock
from sim.timing_boxes.pulsing import Pulse, PulsingEmulator
from stages.errors import ProtocolViolation

LETTERS = "ABCDEFGH"
LARGEST_COUNT = 9_999_999
MODELS = {  # what a box says of itself, by the name that a bench file gives it
    "qc9510": "QC,9518", "qc9520": "QC,9528", "qc9530": "QC,9538", "bnc575": "BNC,575-8", "bnc577": "BNC,577-8",
}  # fmt: skip
HAS_CLOCK_MODE = ("953", "577")  # models, by their beginning; of the 577 it is not known
RESET = -1  # the number of *RST among what may be refused
T0_WORDS = {
    "PER": "0.1", "MOD": "NORM", "BCO": "1", "PCO": "1", "OCO": "1", "CYCL": "1", "TRIG:MOD": "DIS",
    "TRIG:EDG": "RIS", "TRIG:LEV": "2.50", "GAT:MOD": "DIS", "GAT:LOG": "HIGH", "GAT:LEV": "2.50",
}  # fmt: skip
CLOCK_MODE_WORDS = {"ICL:MOD": "INT", "ICL:RAT": "10", "ICL:LEV": "0.50"}
CLOCK_WORDS = {"ICL": "SYS"}
OUTPUT_WORDS = {
    "WIDT": "0.00001", "DEL": "0", "SYNC": "T0", "POL": "NORM", "CMOD": "NORM", "BCO": "1", "PCO": "1", "OCO": "1",
    "WCO": "0", "CGAT": "DIS", "CLOG": "HIGH", "OUTP:MOD": "TTL", "OUTP:AMPL": "5.00",
}  # fmt: skip
CHOICES = {
    "MOD": ("NORM", "SING", "BURS", "DCYC"), "CMOD": ("NORM", "SING", "BURS", "DCYC"),
    "TRIG:MOD": ("DIS", "TRIG", "DUAL"), "TRIG:EDG": ("RIS", "FALL"),
    "GAT:MOD": ("DIS", "PULS", "OUTP", "CHAN"), "GAT:LOG": ("LOW", "HIGH"), "ICL:MOD": ("INT", "EXT", "XPL"),
    "ICL": ("SYS", "EXT10", "EXT20", "EXT50", "EXT100"),  # EXT10 is what a real one says; more exist
    "POL": ("NORM", "COMP", "INV"), "CGAT": ("DIS", "PULS", "OUTP"), "CLOG": ("LOW", "HIGH"),
    "OUTP:MOD": ("TTL", "ADJ"),
}  # fmt: skip
COUNTS = ("BCO", "PCO", "OCO", "WCO", "CYCL", "MUX", "ICL:RAT")
SECONDS = {"PER": (1e-7, 5000.0, 9), "WIDT": (1e-8, 1000.0, 11), "DEL": (-1000.0, 1000.0, 11)}
LONG_WORDS = {
    "NORMAL": "NORM", "SINGLE": "SING", "BURST": "BURS", "DCYCLE": "DCYC", "DISABLED": "DIS", "ON": "1",
    "OFF": "0", "INVERTED": "INV", "COMPLEMENT": "COMP",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Variant:
    """Model of the family, and its settings.

    Parameters
    ----------
    model : str
        What it says of itself before its serial number.
    outputs : int
        4 or 8.
    step_s : float
        Widths and delays are rounded to multiples of it.
    echo : bool
        Gives every line back before it answers.
    autorun : bool
        Goes on by itself after a power failure.
    arms : {"run", "run all", "state"}
        What arms a burst.
    needs_s : float
        A line that comes sooner than this after the one before is lost.
    """

    model: str = MODELS["qc9530"]
    outputs: int = 8
    step_s: float = 5e-9
    echo: bool = False
    autorun: bool = False
    arms: Literal["run", "run all", "state"] = "run"
    needs_s: float = 0.0

    @property
    def has_clock_mode(self) -> bool:
        """Return whether its clock has a mode; else it is one word."""
        return self.model.partition(",")[2].startswith(HAS_CLOCK_MODE)


QC9530 = Variant()


class _Channel:
    """T0 or an output: its settings, and where it is in its mode."""

    def __init__(self, words: Mapping[str, str]) -> None:
        self.words = dict(words)
        self.on = False
        self.is_spent = True  # a burst gives nothing until it is armed
        self.waits = self.done = 0

    def arm(self) -> None:
        """Begin the mode anew."""
        self.is_spent, self.done = False, 0
        self.waits = int(self.words.get("WCO", "0"))

    def tick(self, mode: str) -> bool:
        """Return whether there is a pulse at this tick."""
        if not self.on:
            return False
        kind = self.words[mode]
        most = {"SING": 1, "BURS": int(self.words["BCO"])}.get(kind)
        if most is not None and self.is_spent:
            return False
        if self.waits > 0:
            self.waits -= 1
            return False
        self.done += 1
        if kind == "DCYC":
            on, off = int(self.words["PCO"]), int(self.words["OCO"])
            return (self.done - 1) % (on + off) < on
        self.is_spent = most is not None and self.done >= most
        return True


def _is_off(command: Command) -> bool:
    """Return whether it switches an output or T0 off."""
    return command.keyword.upper().endswith(":STAT") and command.value == "0"


class QuantumComposersEmulator(PulsingEmulator):
    """A box with a number of outputs.

    Parameters
    ----------
    clock : Clock
        Time of the world.
    variant : Variant
        Which box of the family it is, and how it was set up.
    serial : int
        Serial number.
    """

    decoder = CommandStream
    has_serial = True

    def __init__(self, clock: Clock, variant: Variant = QC9530, serial: int = 2311) -> None:
        super().__init__(clock)
        self._variant = variant
        self._echo, self._autorun = variant.echo, variant.autorun
        self._heard_s = -math.inf
        self.locked = True  # whether an external clock is there for XPL
        self.gate_is_high = True  # level at the gate input; nothing on it is high
        self.refuses_off: Counter[int] = Counter()  # by output, or `RESET`: how often it still is ?8
        self.refuse = 0  # commands to come that are answered by ?8
        self.refused_off_s = -math.inf  # when an "off" was last
        self.lost_off_s = -math.inf  # when it was last too busy to hear one
        self._name = f"{variant.model},{serial:05d},1.2.2-1.2.0"
        self._t0 = _Channel(self._first_words(0))
        self._channels = [_Channel(self._first_words(n)) for n in range(1, variant.outputs + 1)]
        self._last = 1  # number of the pulse that was spoken of last
        if variant.autorun:
            self._switch(0, True)

    def _first_words(self, number: int) -> dict[str, str]:
        """Settings of T0 (0) or an output as the box leaves its factory."""
        if number:
            return {**OUTPUT_WORDS, "MUX": str(1 << (number - 1))}
        return T0_WORDS | (CLOCK_MODE_WORDS if self._variant.has_clock_mode else CLOCK_WORDS)

    @classmethod
    def model_of(cls, box: str) -> dict[str, Any]:
        """Options that make it the box that a bench file names."""
        return {"variant": Variant(MODELS[box])} if box in MODELS else {}

    def is_on_at(self, number: int) -> bool:
        """Return whether T0 (0) or an output is on, for tests that look inside."""
        return self._all[number].on

    def sources_of(self, number: int) -> set[str]:
        """Plugs that give the pulses of an output, its own or another one that is mixed with it."""
        return {
            LETTERS[plug]
            for plug, channel in enumerate(self._channels)
            if plug + 1 == number or int(channel.words["MUX"]) >> (number - 1) & 1
        }

    def set_inside(self, number: int, keyword: str, value: str) -> None:
        """Set something at the keys of the box."""
        if keyword == "STAT":
            self._switch(number, value == "1")
        else:
            self._all[number].words[keyword] = value

    def set_gate(self, is_high: bool) -> None:
        """A door or a shutter moves whose switch is connected to the gate input."""
        self.advance()
        self.gate_is_high = is_high

    def _lets_out(self) -> bool:
        """With a gate that inhibits outputs: while its input is at the active level."""
        words = self._t0.words
        return words["GAT:MOD"] != "OUTP" or self.gate_is_high is (words["GAT:LOG"] == "HIGH")

    @property
    def _all(self) -> list[_Channel]:
        return [self._t0, *self._channels]

    def person_stops(self) -> None:
        """The key STOP is pressed."""
        self.advance()
        self._switch(0, False)

    def person_runs(self) -> None:
        """The key RUN is pressed; without power it does nothing."""
        self.advance()
        if self.is_on:
            self._switch(0, True)

    def _begin_period(self, time_s: float) -> None:
        if not self._t0.tick("MOD"):
            active = [False] * len(self._channels)
        else:
            active = [channel.tick("CMOD") for channel in self._channels]
        if self._variant.arms == "state":
            for channel in self._channels:
                channel.on = channel.on and not (channel.is_spent and channel.words["CMOD"] in ("SING", "BURS"))
        bursts = self._t0.words["MOD"] == "BURS" and not self._t0.is_spent
        goes_on = self._t0.on and (bursts or not self._waits_for_edge)
        self._period_begins_s = time_s + float(self._t0.words["PER"]) if goes_on else None
        for number, channel in enumerate(self._channels):
            for source, is_active in enumerate(active):
                if is_active and int(channel.words["MUX"]) >> source & 1:
                    words = self._channels[source].words
                    rises_s = time_s + float(words["DEL"])
                    pulse = Pulse(LETTERS[number], rises_s, rises_s + float(words["WIDT"]))
                    self._send(max(rises_s, time_s), number, pulse)

    def _switch(self, number: int, on: bool) -> None:
        channel = self._all[number]
        channel.on = on
        if not on and number == 0:
            self._end_periods()
        elif not on:
            channel.is_spent = channel.is_spent or self._variant.arms != "run all"
            self._withdraw(number - 1)
        elif number == 0:
            self._run()
        elif self._variant.arms == "state":
            channel.arm()

    @property
    def _waits_for_edge(self) -> bool:
        return self._t0.words["TRIG:MOD"] != "DIS"

    def _run(self) -> None:
        """RUN is pressed, perhaps a second time: T0 starts unless it runs, and channels are armed."""
        if self._period_begins_s is None and not self._waits_for_edge:
            self._period_begins_s = self.event_s
        self._t0.arm()
        for channel in self._channels:
            if self._variant.arms == "run all" or (self._variant.arms == "run" and channel.on):
                channel.arm()

    def _power_up(self) -> None:
        self._last = 1
        self._end_periods()
        for channel in self._all:
            channel.on, channel.is_spent = channel.on and self._autorun, True
        if self._t0.on:
            self._run()

    def _hear(self, command: Command | ProtocolViolation) -> None:
        if self.event_s < self._heard_s + self._variant.needs_s:
            if isinstance(command, Command) and _is_off(command):
                self.lost_off_s = self.event_s
            return  # busy with the line before
        self._heard_s = self.event_s
        if self._echo and isinstance(command, Command):
            self.say(command.to_bytes())
        self.say(f"{self._answer(command)}\r\n".encode("ascii"))

    def _answer(self, command: Command | ProtocolViolation) -> str:
        if isinstance(command, ProtocolViolation):
            return "?5" if command.raw[:1] in b":*" else "?1"
        if self.refuse > 0:
            self.refuse -= 1
            if _is_off(command):
                self.refused_off_s = self._clock.now_s()
            return "?8"
        if command.keyword.startswith("*"):
            return self._common(command)
        try:
            words = list(short_forms(command.keyword))
        except KeyError:
            return "?3"
        return self._obey(words, command)

    def _common(self, command: Command) -> str:
        match command.keyword.upper(), command.asks:
            case "*IDN", True:
                return self._name
            case "*RST", False if self.refuses_off[RESET] > 0:
                self.refuses_off[RESET] -= 1
                return "?8"
            case "*RST", False:
                for number, channel in enumerate(self._all):
                    self._switch(number, False)
                    channel.words.update(self._first_words(number))
                return "ok"
            case "*TRG", False:
                if not (self._t0.on and self._waits_for_edge and self._period_begins_s is None):
                    return "?8"
                self._t0.arm()
                self._period_begins_s = self.event_s
                return "ok"
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
        if words == ["DISP", "ENAB"] and not command.asks:
            return "ok"
        if words[:1] == ["SPUL"]:
            words = ["PULS", "0", *words[1:]]
        if words[:1] != ["PULS"]:
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
            return "?2" if any(word.startswith(f"{keyword}:") for word in channel.words) else "?3"
        if command.asks:
            return str(int(channel.on)) if keyword == "STAT" else self._format_value(channel, keyword)
        if command.value is None:
            return "?4"
        value = LONG_WORDS.get(command.value.upper(), command.value.upper())
        if keyword == "STAT":
            if value not in ("0", "1"):
                return "?5"
            if value == "0" and self.refuses_off[number] > 0:
                self.refuses_off[number] -= 1
                self.refused_off_s = self._clock.now_s()
                return "?8"
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
            return "?9"  # 577 manual, 8.5.8
        channel.words[keyword] = repr(round(seconds / self._variant.step_s) * self._variant.step_s)
        return "ok"

    def _format_value(self, channel: _Channel, keyword: str) -> str:
        value = channel.words[keyword]
        if keyword in SECONDS:
            return f"{float(value):.{SECONDS[keyword][2]}f}"
        if keyword == "ICL:MOD" and value == "XPL" and not self.locked:
            return "XPL?"
        return value


EMULATOR = QuantumComposersEmulator
