"""A timing unit that is only a few variables: what the laser asks of a box, without bytes."""

from daq.timing.box import TimingBox
from daq.timing.errors import LaserDoubt
from daq.timing.pulses import LAMPS, Q_SWITCHES, Role, Schedule
from stages.errors import DeviceLost, NoReply

WIRING = {role: str(number) for number, role in enumerate(Role, start=1)}


class FakeBox(TimingBox):
    """Counts its own pulses on the clock that it is given."""

    default_baud = 9600
    counts = True
    least_step_us = 0.005

    def __init__(self, clock, wiring=WIRING, latch=None):
        super().__init__("laser", wiring, clock, latch)
        self.is_gone = False
        self.unreadable = False
        self.lamps = False
        self.loaded = None
        self.burst = None  # begun, pairs, rate
        self.fired = 0
        self.said = []

    @property
    def is_lost(self):
        return self.is_gone

    def connect(self, url, baud=None):
        self.said.append(f"connect {url}")
        return "fake"

    def reconnect(self):
        if self.is_gone:
            raise DeviceLost("fake is gone")

    def close(self):
        pass

    def drop(self):
        if self.is_gone:
            raise DeviceLost("fake is gone")
        self.count()
        self.said.append("drop")
        self.burst, self.lamps = None, False

    def off_bytes(self):
        return [b"off"]

    def silence(self):
        self.drop()
        if self.unreadable:
            raise NoReply("fake does not answer")

    def load(self, schedule):
        if self.running():
            raise LaserDoubt("a Q-switch is on")
        pulses = {role: pulse for role, pulse in schedule.pulses.items() if role in self.wiring}
        self.loaded = Schedule(schedule.period_us, pulses, schedule.light_delay_us)
        return self.loaded

    def start_lamps(self):
        with self._gate(True):
            self.lamps = True

    def confirm(self, schedule, lamps):
        if self.loaded != schedule or self.lamps != lamps or self.burst is not None:
            raise LaserDoubt("fake was restarted")

    def begin(self, pairs, camera=True):
        with self._gate(True):
            self.burst = (self.clock.now_s(), pairs, self.loaded.rate_hz)

    def count(self):
        """Pulses so far."""
        if self.burst is not None:
            begun_s, pairs, rate_hz = self.burst
            done = min(pairs, int((self.clock.now_s() - begun_s) * rate_hz + 1e-6))
            self.fired += done
            self.burst = (begun_s + done / rate_hz, pairs - done, rate_hz) if pairs > done else None
        return self.fired

    def running(self):
        self.count()
        return self.burst is not None

    def end(self):
        self.count()
        self.burst = None

    def _set_up(self):
        pass

    def _identify(self):
        return "fake"


assert set(LAMPS) | set(Q_SWITCHES) <= set(WIRING)
