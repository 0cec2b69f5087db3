"""The wire between an emulator and whoever opens the other end: latency, order, faults, one owner at a time."""

import threading
from collections import deque

from sim.emulators.device import Clock, Emulator, Said
from sim.faults_serial import FaultSchedule

LATENCY_S = 0.001  # a converter's and a controller's own time


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
        self.opened = False
        self._coming: deque[Said] = deque()

    @property
    def dead(self) -> bool:
        """True once unplugged."""
        return self.faults.dead(self.clock.now_s())

    def unplug(self) -> None:
        """Pull the plug now."""
        self.faults.unplugged = True

    def plug_in(self) -> None:
        """Put the plug back; answers under way are gone."""
        with self.lock:
            self.faults = FaultSchedule()
            self._coming.clear()
            self.emulator.said()

    def send(self, data: bytes) -> None:
        """Bytes from the host."""
        with self.lock:
            self._collect()
            self.emulator.feed(data)
            self._collect()

    def receive(self) -> bytes:
        """Bytes that have reached the host by now."""
        with self.lock:
            self._collect()
            arrived = b""
            while self._coming and self._coming[0].time_s <= self.clock.now_s():
                arrived += self._coming.popleft().data
            return arrived

    def next_s(self) -> float | None:
        """When the next bytes will reach the host, as far as is known."""
        with self.lock:
            return self._coming[0].time_s if self._coming else None

    def _collect(self) -> None:
        for said in self.emulator.said():
            time_s, data = self.faults.pass_on(said.time_s + LATENCY_S, said.data)
            if data:
                self._coming.append(Said(time_s, data))
