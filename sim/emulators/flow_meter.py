r"""A flow meter: it says its flow when asked, or by itself ten times a second.

    F?\r\n -> F=+5.203 l/min\r\n         S1\r\n: it streams such lines from now on         S0\r\n: no more

The flow wavers by one per cent about what flows, as a supply of gas does; the same seed wavers alike.
"""

import math

from sim.emulators.device import Clock, Emulator

EVERY_S = 0.1
WAVES = ((0.7, 0.31), (0.3, 1.9))  # share, Hz
WAVERS = 0.01
FLOW = 5.2  # in the unit that it says


class FlowMeter(Emulator):
    """The meter.

    Parameters
    ----------
    clock : Clock
        Time of the world.
    unit : str
        Of the flow that it says.
    """

    def __init__(self, clock: Clock, unit: str = "l/min") -> None:
        super().__init__({}, clock)
        self.flow, self.unit = FLOW, unit
        self.is_silent = False
        self._heard = b""
        self._next_s = math.inf

    def flow_at(self, time_s: float) -> float:
        """Return what flows at a time."""
        waver = sum(share * math.sin(2.0 * math.pi * hz * time_s) for share, hz in WAVES)
        return self.flow * (1.0 + WAVERS * waver)

    def _take(self, data: bytes) -> None:
        *lines, self._heard = (self._heard + data)[-200:].split(b"\n")
        for line in lines:
            word = line.strip()
            if word == b"F?":
                self._tell(self.event_s)
            elif word in (b"S0", b"S1"):
                self._next_s = self.event_s + EVERY_S if word == b"S1" else math.inf
                if word == b"S1":
                    self.act_at(self._next_s)

    def _tick(self, now_s: float) -> None:
        while self._next_s <= now_s:
            self._tell(self._next_s)
            self._next_s += EVERY_S
            self.act_at(self._next_s)

    def _tell(self, time_s: float) -> None:
        if not self.is_silent:
            self.say(f"F={self.flow_at(time_s):+.3f} {self.unit}\r\n".encode(), time_s)

    def _power_up(self) -> None:
        self._heard, self._next_s = b"", math.inf
