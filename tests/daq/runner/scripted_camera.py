"""A camera that follows a script in a time of its own: thousands of sessions with every fault take seconds.

Nothing here waits.  `FakeTime` stands in for the module `time` where the runner asks it; calls of the camera cost
some of it.  Every trigger remembers at which stop it was sent, and every frame prints its trigger into its pixel,
so a test knows what a frame really shows.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from daq.cameras.camera import CameraInfo, Counters, wait_for_frame
from daq.cameras.frame import Frame, FrameMeta
from daq.cameras.ids import IdTracker
from daq.errors import CameraLost, FrameIncomplete, SettingsChanged

MS = 1_000_000
FRAME_NS = 20 * MS  # exposure, readout, transfer
SHAPE = (2, 3)


class FakeTime:
    """Looks like the module `time`."""

    def __init__(self):
        self.now_ns = 5_000_000 * MS

    def monotonic_ns(self):
        self.now_ns += 1000  # asking takes time too
        return self.now_ns

    def monotonic(self):
        return self.monotonic_ns() / 1e9

    def sleep(self, seconds):
        self.now_ns += max(0, round(1e9 * seconds))


@dataclass(frozen=True)
class Script:
    """Faults by frame number, 0 first, and the kind of camera."""

    late_ms: dict[int, int] = field(default_factory=dict)
    dropped: frozenset[int] = frozenset()
    incomplete: frozenset[int] = frozenset()
    ignored: frozenset[int] = frozenset()  # by trigger number: taken for one while busy
    lost_at: int | None = None  # trigger
    reset_at: int | None = None
    latch: str = "same"  # same, none, other: another clock, frozen: never moves
    stamps: str = "ns"  # ns, ticks: of 8 ns, seconds: nanoseconds of the second, none
    tells_id: bool = True
    survive: bool = True  # frames under way outlive a disarming
    leftover_ms: tuple[int, ...] = ()  # frames of an earlier process, by when they arrive
    call_us: tuple[int, ...] = (300,)  # what calls cost, in turn
    latency_us: tuple[int, ...] = (100,)  # from trigger to exposure, in turn


@dataclass(frozen=True)
class Coming:
    arrives_ns: int
    exposed_ns: int
    number: int
    trigger: int
    is_incomplete: bool


class ScriptedCamera:
    def __init__(self, script, time):
        self.script, self.time = script, time
        self.sent = []  # stop of every trigger
        self.stop = 0
        self.exposed = 0
        self._boot_ns = time.now_ns - 1000 * MS
        self._coming = deque()
        self._is_armed = self._is_lost = self._is_reset = False
        self._calls = self._shots = self._last_arrival_ns = 0
        self._ids = IdTracker()
        self._counts = Counters()
        for number, arrives_ms in enumerate(script.leftover_ms):
            self._expose(-1 - number, time.now_ns - (500 + 100 * number) * MS, arrives_ms * MS + 500 * MS)

    info = CameraInfo("scripted", "rtpiv", "script", "1", "here")

    @property
    def counters(self):
        return self._counts_now()

    def open(self):
        self._is_lost = False

    def close(self):
        self._is_armed = False
        self._coming.clear()

    def configure(self, settings):
        self._is_reset = False
        return dict(settings)

    def verify(self):
        self._cost()
        if self._is_reset:
            raise SettingsChanged("the camera lost its settings")

    def settings(self):
        return {}

    def arm(self, buffers=24):
        self._cost()
        self._is_armed = True
        self._ids, self._delivered, self._incomplete, self._ignored, self._unused = IdTracker(), 0, 0, 0, 0

    def clock_ns(self):
        self._cost()
        if self.script.latch == "none":
            return None
        if self.script.latch == "frozen":
            return 0
        return self.time.now_ns - self._boot_ns + (10**15 if self.script.latch == "other" else 0)

    def trigger(self):
        clock_ns = self.clock_ns()
        trigger = len(self.sent)
        self.sent.append(self.stop)
        self._cost()
        if self.script.lost_at == trigger:
            self._is_lost = self._is_reset = True
            self._coming.clear()
            raise CameraLost("somebody stepped on the cable")
        self._is_reset |= self.script.reset_at == trigger
        if trigger in self.script.ignored:
            self._ignored += 1
            return clock_ns
        delay_ns = 1000 * self.script.latency_us[trigger % len(self.script.latency_us)]
        late_ns = self.script.late_ms.get(self.exposed, 0) * MS
        self._expose(trigger, self.time.now_ns + delay_ns, FRAME_NS + late_ns)
        return clock_ns

    def poll(self, timeout_s):
        end_ns = self.time.now_ns + round(1e9 * timeout_s)
        if self._is_lost:
            raise CameraLost("still gone")
        while self._coming and self._coming[0].arrives_ns <= end_ns:
            coming = self._coming.popleft()
            self.time.now_ns = max(self.time.now_ns, coming.arrives_ns)
            if coming.number in self.script.dropped:
                continue
            if coming.is_incomplete:
                self._incomplete += 1
                self._ids.note(coming.number)
                raise FrameIncomplete("pixels missing")
            self._delivered += 1
            return self._frame(coming)
        self.time.now_ns = end_ns
        return None

    def probe(self, timeout_s):
        self._cost()
        if self._is_lost:
            raise CameraLost("no answer")

    def next_frame(self, timeout_s):
        return wait_for_frame(self, timeout_s)

    def disarm(self):
        self._cost()
        self._is_armed = False
        arrived = [c for c in self._coming if c.arrives_ns <= self.time.now_ns]
        for coming in arrived:
            self._coming.remove(coming)
            if coming.number not in self.script.dropped:
                self._ids.note(coming.number)
                self._incomplete += coming.is_incomplete
                self._unused += not coming.is_incomplete
        if not self.script.survive:
            self._coming.clear()
        return self._counts_now()

    def _counts_now(self):
        missing = self._ids.missing(0)
        return Counters(
            self._delivered, self._incomplete, 0, missing, ignored_triggers=self._ignored, unused=self._unused
        )

    def _expose(self, trigger, exposed_ns, takes_ns):
        arrives_ns = max(self._last_arrival_ns, exposed_ns + takes_ns)  # frames stay in order
        self._last_arrival_ns = arrives_ns
        bad = self.exposed in self.script.incomplete
        self._coming.append(Coming(arrives_ns, exposed_ns, self.exposed, trigger, bad))
        self.exposed += 1

    def _frame(self, coming):
        stamp_ns = coming.exposed_ns - self._boot_ns
        stamps = {"ns": stamp_ns, "ticks": stamp_ns // 8, "seconds": stamp_ns % 10**9 + 1, "none": 0}
        stamp = stamps[self.script.stamps]
        frame_id = coming.number if self.script.tells_id else self._delivered
        sequence = self._ids.note(frame_id)
        meta = FrameMeta(
            frame_id, sequence, stamp, self.time.now_ns, 100.0, "Mono12", 12, id_told=self.script.tells_id
        )
        return Frame(np.full(SHAPE, coming.trigger & 0xFFFF, np.uint16), meta)

    def _cost(self):
        self.time.now_ns += 1000 * self.script.call_us[self._calls % len(self.script.call_us)]
        self._calls += 1
