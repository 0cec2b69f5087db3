"""Micro-Manager's pulse generator as firmware, by its text.

One input, one output, and a timer that ticks every `interval` from its start on. While it waits for its input, a
tick sends a pulse if the input is at the level at which the device is ready, and so does an edge to that level, if
the timer has ticked since the last pulse. The level is built in: LOW for busy, where edges rise, is what counting
needs; HIGH is what the text comes with.

`start` begins the timer and sends a first pulse at once, or at the first edge where the input is busy then. `stop`
says how many pulses were sent. A count that was set ends it by itself.
"""

import math

from daq.timing.protocols.pulse_box import (
    INTERVAL_US,
    LENGTH_US,
    PULSES,
    START,
    STOP,
    VERSION,
    WAITS,
    Command,
    CommandStream,
    Question,
    Reply,
)
from sim.emulators.device import Clock, Emulator
from sim.timing_boxes.pulsing import Pulse


class PulseBoxEmulator(Emulator):
    """A Teensy.

    Parameters
    ----------
    clock : Clock
        Time of the world.
    busy_is_high : bool
        How its firmware was built.
    version : int
        Of the firmware.
    clock_off : float
        Share by which its own clock runs fast.
    """

    decoder = CommandStream

    def __init__(
        self,
        clock: Clock,
        busy_is_high: bool = False,
        version: int = 1,
        clock_off: float = 0.0,
    ) -> None:
        super().__init__({}, clock)
        self._busy_is_high, self._version, self._clock_off = busy_is_high, version, clock_off
        self._edges: list[tuple[float, bool]] = []  # of the input, to come
        self._is_high = self._runs = self._is_ready = self._starts_at_edge = False
        self._power_up()

    def hear_pulse(self, pulse: Pulse) -> None:
        """A pulse comes to its input."""
        self._edges += [(pulse.rises_s, True), (pulse.falls_s, False)]
        self._edges.sort()

    @property
    def next_s(self) -> float | None:
        """Next moment at which its timer ticks or its input changes."""
        next_s = min([self._tick_s, *(time_s for time_s, _ in self._edges[:1])])
        return None if math.isinf(next_s) else next_s

    def advance(self) -> None:
        """Live through ticks and edges up to now, in order; an edge before a tick of the same moment."""
        now_s = self._clock.now_s()
        while True:
            edge_s = self._edges[0][0] if self._edges else math.inf
            if min(edge_s, self._tick_s) > now_s:
                break
            if edge_s <= self._tick_s:
                self._change(*self._edges.pop(0))
            else:
                self._timer_ticks()
        super().advance()

    def _change(self, time_s: float, is_high: bool) -> None:
        self._is_high = is_high
        if is_high is self._busy_is_high:
            return  # only the edge at which the device becomes ready interrupts
        if self._starts_at_edge:
            self._tick_s, self._starts_at_edge = time_s + self._interval_s, False
        if self._settings[WAITS] and self._is_ready:
            self._pulse()

    def _timer_ticks(self) -> None:
        self._tick_s += self._interval_s
        self._is_ready = True
        if not (self._settings[WAITS] and self._is_high is self._busy_is_high):
            self._pulse()

    def _pulse(self) -> None:
        self._is_ready = False
        self._sent += 1
        if self._settings[PULSES] and self._sent == self._settings[PULSES]:
            self._end()

    def _end(self) -> None:
        self._tick_s, self._runs, self._is_ready = math.inf, False, False

    @property
    def _interval_s(self) -> float:
        return 1e-6 * self._settings[INTERVAL_US] / (1.0 + self._clock_off)

    def _power_up(self) -> None:
        self._settings = {INTERVAL_US: 100_000, LENGTH_US: 1000, WAITS: 0, PULSES: 0}
        self._runs = self._is_ready = self._starts_at_edge = False
        self._sent = 0
        self._tick_s = math.inf

    def _hear(self, command: Command | Question) -> None:
        if isinstance(command, Question):
            state = {
                VERSION: self._version,
                START: int(self._runs),
                STOP: int(not self._runs),
                **self._settings,
            }
            if command.code in state:
                self.say(Reply(command.code, state[command.code]).to_bytes())
        elif command.code <= PULSES:
            self.say(Reply(command.code, self._obey(command)).to_bytes())

    def _obey(self, command: Command) -> int:
        if command.code == VERSION:
            return self._version
        if command.code == START:
            self._begin()
            return 1
        if command.code == STOP:
            self._end()
            return self._sent
        self._settings[command.code] = int(command.number > 0) if command.code == WAITS else command.number
        if command.code == INTERVAL_US and self._runs:
            self._tick_s = self.event_s + self._interval_s
        return self._settings[command.code]

    def _begin(self) -> None:
        self._is_ready, self._runs, self._sent, self._tick_s = True, True, 0, math.inf
        if self._settings[WAITS] and self._is_high is self._busy_is_high:
            self._starts_at_edge = True
            return
        self._tick_s = self.event_s + self._interval_s
        self._pulse()


EMULATOR = PulseBoxEmulator
