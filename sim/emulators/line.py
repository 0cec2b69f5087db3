"""The wire between an emulator and the program at the other end: latency, order, faults, one owner at a time.

Actions may wait for a place in the traffic (hooks): what goes wrong does so between two bytes.

============  ===========================================================================
write         before the n-th write of the host from now reaches the box
byte          as soon as n more bytes of the host have reached the box
answer        before the n-th answer of the box from now leaves it
answer byte   as soon as n more bytes of the box have reached the host
============  ===========================================================================

What happens to the world (power, plugs, buttons) happens at that very moment, in the middle of a command if it
must be. What **another thread of the host** does cannot: it waits for the locks that the present one holds. So
`press` puts an action off until the host next looks for input, and further while `is_kept_out` says that the
present thread holds what the other would wait for. Thereby a race of two threads runs in one, the same way every
time.
"""

import threading
from collections import deque
from collections.abc import Callable
from typing import Literal

from sim.emulators.device import Clock, Emulator, TimedReply
from sim.emulators.faults import FaultSchedule

Counted = Literal["write", "byte", "answer", "answer byte"]
Action = Callable[[], object]


class Hooks:
    """Counts what passes on one line and calls what waits for a count."""

    def __init__(self) -> None:
        self.passed: dict[Counted, int] = {"write": 0, "byte": 0, "answer": 0, "answer byte": 0}
        self._waiting: list[tuple[Counted, int, Action]] = []
        self._pressed: list[tuple[Action, Callable[[], bool]]] = []

    def after(self, number: int, what: Counted, action: Action) -> None:
        """Do something to the world after so many more of something; see the table."""
        self._waiting.append((what, self.passed[what] + number, action))

    def press(self, number: int, what: Counted, action: Action, is_kept_out: Callable[[], bool]) -> None:
        """Do what another thread of the host would do at that moment, or as soon as it could."""
        self.after(number, what, lambda: self._pressed.append((action, is_kept_out)))

    def clear(self) -> None:
        """Forget everything that waits."""
        self._waiting.clear()
        self._pressed.clear()

    def count(self, what: Counted, number: int = 1) -> None:
        """Note what has passed, and act."""
        self.passed[what] += number
        if self._waiting:
            due = [hook for hook in self._waiting if hook[0] == what and hook[1] <= self.passed[what]]
            self._waiting = [hook for hook in self._waiting if hook not in due]
            for _, _, action in due:
                action()

    def cut(self, what: Counted, data: bytes) -> tuple[bytes, bytes]:
        """Part data where the next action waits."""
        if not self._waiting:
            return data, b""
        places = (number - self.passed[what] for kind, number, _ in self._waiting if kind == what)
        place = min((place for place in places if place > 0), default=len(data))
        return data[:place], data[place:]

    def let_in(self) -> None:
        """Let other threads of the host do what they wait for; to be called without any lock."""
        while self._pressed and not self._pressed[0][1]():
            self._pressed.pop(0)[0]()


LATENCY_S = 0.001  # a converter's and a controller's own time
BYTE_S = 1e-4  # about 115200 baud


class Line:
    """A serial line with an emulator at its far end; safe for several threads.

    Parameters
    ----------
    emulator : Emulator
        What answers.
    clock : Clock
        Time of the world.
    faults : FaultSchedule, optional
        What happens to the answers.
    """

    def __init__(self, emulator: Emulator, clock: Clock, faults: FaultSchedule | None = None) -> None:
        self.emulator = emulator
        self.clock = clock
        self.faults = faults or FaultSchedule()
        self.lock = threading.RLock()
        self.owner: object | None = None  # the program that has it open
        self.opened_with = 0  # `plugged` when the host opened it
        self.plugged = 0  # times that the plug was put in; what was opened before is dead
        self.baud: int | None = None  # rate at which the box listens; None for any
        self.hooks = Hooks()
        self.has_echo = False  # the host hears itself
        self.on_cut: Callable[[], None] | None = None
        self.after_traffic: Callable[[], None] | None = None  # called without the lock
        self.on_told: Callable[[bytes], None] | None = None  # called before the box hears it
        self._coming: deque[TimedReply] = deque()

    @property
    def dead(self) -> bool:
        """True once unplugged."""
        faults = self.faults
        return faults.unplugged or (faults.unplug_s is not None and faults.dead(self.clock.now_s()))

    @property
    def is_reached(self) -> bool:
        """Return whether what the host has open leads to the box."""
        return self.owner is not None and not self.dead and self.opened_with == self.plugged

    @property
    def is_opened(self) -> bool:
        """Return whether a program has it open."""
        return self.owner is not None

    def open(self, owner: object) -> None:
        """Claim it."""
        self.owner, self.opened_with = owner, self.plugged

    def close(self, owner: object | None = None) -> None:
        """Give it back; without a name, as the system does it for a process that has died."""
        if owner is None or self.owner is owner:
            self.owner = None

    def unplug(self) -> None:
        """Pull the plug now; the box does not notice."""
        self.faults.unplugged = True
        if self.on_cut is not None:
            self.on_cut()

    def plug_in(self) -> None:
        """Put the plug back; answers under way are gone, and the host has to open the port again."""
        with self.lock:
            self.plugged += self.dead
            self.faults = FaultSchedule()
            self._coming.clear()
            self.emulator.take_answers()

    def power_cycle(self, off_s: float = 0.3) -> None:
        """Switch the box off, and on again `off_s` later.

        The host's converter has its own power, so the port stays open; what the host sends meanwhile is lost, and
        so is what the box had not said yet.
        """
        with self.lock:
            self._collect()
            now_s = self.clock.now_s()
            while self._coming and self._coming[-1].time_s > now_s:
                self._coming.pop()
            self.emulator.restart(off_s)

    def send(self, data: bytes) -> None:
        """Bytes from the host."""
        with self.lock:
            self._collect()
            self.hooks.count("write")
            if self.on_told is not None:
                self.on_told(data)
            while data and not self.dead:
                now, data = self.hooks.cut("byte", data)
                if self.has_echo:
                    self._coming.append(TimedReply(self.clock.now_s() + LATENCY_S, now))
                self.emulator.feed(now)
                self.hooks.count("byte", len(now))
            self._collect()
        if self.after_traffic is not None:
            self.after_traffic()

    def receive(self) -> bytes:
        """Bytes that have reached the host by now."""
        self.hooks.let_in()
        with self.lock:
            self._collect()
            if not self._coming:
                return b""
            arrived, now_s = b"", self.clock.now_s()
            while self._coming and self._coming[0].time_s <= now_s:
                data, rest = self.hooks.cut("answer byte", self._coming.popleft().data)
                if rest:
                    self._coming.appendleft(TimedReply(now_s + BYTE_S, rest))
                arrived += data
                self.hooks.count("answer byte", len(data))
            return arrived

    def next_s(self) -> float | None:
        """Next moment at which bytes reach the host, as far as is known."""
        with self.lock:
            moments = [self._coming[0].time_s] if self._coming else []
            if (acts_s := self.emulator.next_s) is not None:
                moments.append(acts_s)
            return min(moments, default=None)

    def _collect(self) -> None:
        self.emulator.advance()
        if not self.emulator.has_answers:
            return
        for said in self.emulator.take_answers():
            self.hooks.count("answer")
            for time_s, data in self.faults.pass_on(said.time_s + LATENCY_S, said.data):
                if data:
                    self._coming.append(TimedReply(time_s, data))
