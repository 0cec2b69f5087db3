"""DG645 of Stanford Research Systems as firmware.

A trigger begins a cycle, or a burst of BURC cycles BURP apart, the first BURD behind the trigger, with or without
a listener and a living host. In a cycle every output whose second channel comes behind its first is
high from one to the other. What triggers is TSRC: 0 its own rate TRAT, 5 the word *TRG or a key; a trigger that
comes while it is busy is lost.

What ends a burst that runs, no text says. `ends` is what does: "mode" (BURM 0), or "nothing", where it goes on to
its count; a new delay holds from the next cycle on, and what has not risen yet is taken back.
"""

from typing import Literal

from daq.timing.protocols.srs_dg645 import (
    ENDED_BURST,
    IS_BUSY,
    IS_IN_BURST,
    SINGLE_SHOT,
    WAS_TRIGGERED,
    Command,
    CommandStream,
    Value,
)
from sim.emulators.device import Clock
from sim.timing_boxes.pulsing import Pulse, PulsingEmulator
from stages.errors import ProtocolViolation

PLUGS = ("T0", "AB", "CD", "EF", "GH")
WORDS = {
    "TSRC": (0, 6), "TRAT": (1e-3, 1e6), "BURM": (0, 1), "BURC": (1, 2**31 - 1), "BURP": (1e-7, 2000.0),
    "BURD": (0.0, 2000.0), "BURT": (0, 1), "ADVT": (0, 1), "INHB": (0, 5), "HOLD": (0.0, 1000.0),
}  # fmt: skip
WHOLE = ("TSRC", "BURM", "BURC", "BURT", "ADVT", "INHB")
FACTORY = {
    "TSRC": 5, "TRAT": 1000.0, "BURM": 0, "BURC": 5, "BURP": 1e-4, "BURD": 0.0, "BURT": 0, "ADVT": 0, "INHB": 1,
    "HOLD": 0.0,
}  # fmt: skip
LAST_S = 1e-7  # behind the last channel, until a cycle is over


class Dg645Emulator(PulsingEmulator):
    """A DG645.

    Parameters
    ----------
    clock : Clock
        Time of the world.
    serial : int
        Serial number.
    ends : {"mode", "nothing"}
        What ends a burst that runs.
    """

    decoder = CommandStream
    has_serial = True

    def __init__(
        self,
        clock: Clock,
        serial: int = 1013,
        ends: Literal["mode", "nothing"] = "mode",
    ) -> None:
        super().__init__(clock)
        self._name = f"Stanford Research Systems,DG645,s/n{serial:06d},ver1.00.10E"
        self._ends = ends
        self.unlocked = 0  # bits of INSR that say that a clock is not locked
        self._settings: dict[str, float] = {}
        self._delays: dict[int, tuple[int, float]] = {}
        self._power_up()

    @property
    def has_something_to_stop(self) -> bool:
        """Return whether it gives cycles or is ready to."""
        return self.is_running or self._settings["BURM"] == 1

    def set_inside(self, word: str, value: float) -> None:
        """Set something at the keys of the box."""
        self.advance()
        self._set(word, value)

    def person_stops(self) -> None:
        """Burst mode is switched off at its keys, and no output is left a length."""
        self.advance()
        self._set("BURM", 0)
        self._end_periods()

    def person_runs(self) -> None:
        """The key that triggers is pressed."""
        self.advance()
        if self._settings["TSRC"] == SINGLE_SHOT:
            self._trigger(self.event_s)

    def _power_up(self) -> None:
        self._settings = dict(FACTORY)
        # factory settings: A, C, E, G at T0, and the second channels 10 ns behind the first
        self._delays = {channel: (channel - 1, 1e-8) if channel % 2 else (0, 0.0) for channel in range(2, 10)}
        self._polarities = dict.fromkeys(range(len(PLUGS)), 1)
        self._left, self._events, self._errors = 0, 0, list[int]()
        self._busy_until_s = self.event_s
        self._end_periods()

    def _comes_s(self, channel: int) -> float:
        """Delay of a channel behind T0, along its references."""
        after_s = 0.0
        while channel > 1:
            channel, delay_s = self._delays[channel]
            after_s += delay_s
        return after_s

    def _trigger(self, time_s: float) -> None:
        if not self._is_on or self.is_running or time_s < self._busy_until_s:
            return
        self._events |= WAS_TRIGGERED
        self._left = int(self._settings["BURC"]) if self._settings["BURM"] else 1
        self._period_begins_s = time_s + (self._settings["BURD"] if self._settings["BURM"] else 0.0)

    def _begin_period(self, time_s: float) -> None:
        for number, plug in enumerate(PLUGS[1:], start=1):
            rises_s, falls_s = self._comes_s(2 * number), self._comes_s(2 * number + 1)
            if falls_s > rises_s:
                self._send(time_s + rises_s, number, Pulse(plug, time_s + rises_s, time_s + falls_s))
        self._busy_until_s = time_s + max(map(self._comes_s, range(2, 10))) + LAST_S
        self._left -= 1
        if self._left > 0:
            self._period_begins_s = time_s + self._settings["BURP"]
            return
        self._period_begins_s = None
        if self._settings["BURM"]:
            self._events |= ENDED_BURST
        if self._settings["TSRC"] == 0:
            self._left, self._period_begins_s = 1, time_s + 1.0 / self._settings["TRAT"]

    def _set(self, word: str, value: float) -> None:
        self._settings[word] = value
        if word == "BURM" and not value and self._ends == "mode":
            self._end_periods()
        if word == "TSRC" and value == 0:
            self._trigger(self.event_s)
        elif word == "TSRC" and self._left <= 1:
            self._end_periods()

    def _hear(self, command: Command | ProtocolViolation) -> None:
        if isinstance(command, ProtocolViolation):
            self._errors.append(110)
        elif command.asks:
            self.say(Value(self._answer(command)).to_bytes())
        else:
            self._obey(command)

    def _answer(self, command: Command) -> str:
        word = command.word
        if word == "*IDN":
            return self._name
        if word == "*STB":
            return str(IS_BUSY * (self.event_s < self._busy_until_s) | IS_IN_BURST * self.is_running)
        if word == "INSR":
            events, self._events = self._events | self.unlocked, 0
            return str(events)
        if word == "LERR":
            return str(self._errors.pop(0)) if self._errors else "0"
        if word == "DLAY" and command.values.isdecimal() and int(command.values) in self._delays:
            reference, delay_s = self._delays[int(command.values)]
            return f"{reference},{delay_s:+.12f}"
        if word == "LPOL" and command.values.isdecimal() and int(command.values) in self._polarities:
            return str(self._polarities[int(command.values)])
        if word in self._settings:
            value = self._settings[word]
            return str(int(value)) if word in WHOLE else f"{value:.12f}"
        self._errors.append(111)
        return "0"

    def _obey(self, command: Command) -> None:
        if command.word == "*TRG":
            if self._settings["TSRC"] == SINGLE_SHOT:
                self._trigger(self.event_s)
            return
        try:
            values = [float(value) for value in command.values.split(",")]
        except ValueError:
            self._errors.append(110)
            return
        if command.word == "DLAY" and len(values) == 3 and 2 <= values[0] <= 9 and values[1] != values[0]:
            channel = int(values[0])
            self._delays[channel] = (int(values[1]), 5e-12 * round(values[2] / 5e-12))
            self._withdraw(channel // 2)
        elif command.word == "LPOL" and len(values) == 2 and values[0] in self._polarities:
            self._polarities[int(values[0])] = int(values[1])
        elif command.word in WORDS and len(values) == 1:
            low, high = WORDS[command.word]
            if low <= values[0] <= high:
                self._set(command.word, values[0])
            else:
                self._errors.append(10)
        else:
            self._errors.append(111)


EMULATOR = Dg645Emulator
