"""The wire between an emulator and whoever opens the other end: latency, order, faults, one owner at a time."""

import threading
from collections import deque
from collections.abc import Callable

from sim.emulators.device import Clock, Emulator, Said
from sim.emulators.faults import FaultSchedule
from sim.emulators.hooks import Hooks

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
        self.owner: object | None = None  # whoever has it open
        self.opened_with = 0  # `plugged` when the host opened it
        self.plugged = 0  # times that somebody put the plug in; what was opened before is dead
        self.hooks = Hooks()
        self.on_cut: Callable[[], None] | None = None
        self.after_traffic: Callable[[], None] | None = None  # called without the lock
        self._coming: deque[Said] = deque()

    @property
    def dead(self) -> bool:
        """True once unplugged."""
        faults = self.faults
        return faults.unplugged or (faults.unplug_s is not None and faults.dead(self.clock.now_s()))

    @property
    def reached(self) -> bool:
        """Whether what the host has open leads to the box."""
        return self.owner is not None and not self.dead and self.opened_with == self.plugged

    @property
    def opened(self) -> bool:
        """Whether somebody has it open."""
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
            self.emulator.said()

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
            while data and not self.dead:
                now, data = self.hooks.cut("byte", data)
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
                    self._coming.appendleft(Said(now_s + BYTE_S, rest))
                arrived += data
                self.hooks.count("answer byte", len(data))
            return arrived

    def next_s(self) -> float | None:
        """When the next bytes will reach the host, as far as is known."""
        with self.lock:
            moments = [self._coming[0].time_s] if self._coming else []
            if (acts_s := self.emulator.next_s) is not None:
                moments.append(acts_s)
            return min(moments, default=None)

    def _collect(self) -> None:
        self.emulator.advance()
        if not self.emulator.has_said:
            return
        for said in self.emulator.said():
            self.hooks.count("answer")
            for time_s, data in self.faults.pass_on(said.time_s + LATENCY_S, said.data):
                if data:
                    self._coming.append(Said(time_s, data))
