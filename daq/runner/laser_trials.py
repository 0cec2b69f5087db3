"""Trials of a laser's box with nothing behind its plugs: a burst of n is n, off is off, no computer is needed.

    count what a burst triggers -> switch off in the middle of one -> pull the cable in the middle of one

The judge is not the box: exposures of a camera that hangs on it are counted.  What the camera's channel does the
Q-switches' do, because they are loaded and begun alike; that light 1 and light 2 come out where they should, an
oscilloscope shows (docs/laser.md, First light).  A person has turned the key off or pulled the Q-switch plugs
before this begins, so conditions of stages are not asked for.
"""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import inf, isnan, nan
from typing import Protocol

from daq.bench.bench_table import CameraSection
from daq.cameras.camera import Camera
from daq.errors import DaqError, FrameIncomplete
from daq.runner.camera_session import CameraSession
from daq.runs.laser_proof import Trial
from daq.timing.conditions import Conditions
from daq.timing.laser import Laser
from daq.timing.pulses import PairExposures, PulseTiming
from daq.timing.states import LaserState
from stages.clock import Clock
from stages.errors import StageError

BURSTS = (1, 7, 20)
OFF_S = 0.2  # behind the word, within which the last exposure has to begin
PATIENCE_S = 5.0  # with a box that does not say that it is off
ENOUGH_S = 5.0  # length of a burst in which a person can pull a cable
TAIL_S, FIRST_S = 3.0, 20.0  # without a frame, after which no more are waited for; for the first one of a burst
STATED = Conditions(True, True, True, inf, 10**9)  # nothing is behind the plugs


class Counter(Protocol):
    """Who counts the pairs that a burst triggers."""

    def count(self, burst: Callable[[], None]) -> list[float]:
        """Let a burst happen; return when each pair was exposed [s], on a clock that nobody else has."""
        ...


class Helper(Protocol):
    """Who has hands."""

    def promise_dark(self, challenge: str) -> str:
        """Return what was typed for the code, when no light can leave."""
        ...

    def pull_cable(self) -> None:
        """Return when the cable between computer and box is out."""
        ...

    def put_back(self) -> None:
        """Return when it is in again."""
        ...


class CameraCounter:
    """Counts by the exposures of a camera that hangs on the box.

    Parameters
    ----------
    camera : Camera
        Open.
    section : CameraSection
        How it is set up, with its pairs.
    """

    def __init__(self, camera: Camera, section: CameraSection) -> None:
        self._camera, self._session = camera, CameraSession(camera, section)
        assert section.pairs is not None
        self._frames = section.pairs.frames
        self.settings = self._session.set_up()

    def count(self, burst: Callable[[], None]) -> list[float]:
        """Arm, let the burst happen beside, and fetch what it makes."""
        times: list[float] = []
        self._session.begin()
        try:
            self._session.make_ready()
            with ThreadPoolExecutor(1) as beside:
                going_on = beside.submit(burst)
                quiet_s = time.monotonic()
                while not going_on.done() or time.monotonic() - quiet_s < (TAIL_S if times else FIRST_S):
                    if (at_s := self._next()) is not None:
                        times.append(at_s)
                    if at_s is not None or not going_on.done():
                        quiet_s = time.monotonic()
                going_on.result()
        finally:
            self._session.end()
        return times[:: self._frames]

    def _next(self) -> float | None:
        """When the next frame was exposed, nan of one that is not whole; None if none came."""
        try:
            frame = self._camera.poll(0.02)
        except FrameIncomplete:
            return nan
        if frame is None:
            return None
        with frame:
            return 1e-9 * (frame.meta.timestamp_ns or frame.meta.received_ns)


def trials(
    laser: Laser, timing: PulseTiming, exposures: PairExposures, counter: Counter, helper: Helper, clock: Clock
) -> Iterator[Trial]:
    """Try everything, one after the other; the laser is SAFE in the end.

    Parameters
    ----------
    laser : Laser
        Open; a person has seen to it that no light can leave.
    timing, exposures : PulseTiming, PairExposures
        Of the bursts.
    counter, helper : Counter, Helper
        Who counts, and who promises that no light can leave and pulls the cable.
    clock : Clock
        The laser's.

    Raises
    ------
    NotArmed, TimingError, StageError
        The code is wrong, or the laser cannot do it at all.
    """
    code = helper.promise_dark(laser.challenge)
    laser.rules = replace(laser.rules, warmup_s=0.0)  # nobody needs a steady beam
    for pairs in BURSTS:
        if pairs <= int(laser.rules.chunk_s * timing.rate_hz):
            _ready(laser, timing, exposures, code)
            yield _burst(laser, counter, pairs)
    _ready(laser, timing, exposures, code)
    yield _off(laser, _long(laser, timing), counter, clock)
    _ready(laser, timing, exposures, laser.challenge)  # another one since; the promise holds
    yield _cable(laser, _long(laser, timing), counter, helper, clock)


def _ready(laser: Laser, timing: PulseTiming, exposures: PairExposures, code: str) -> None:
    if laser.state is not LaserState.READY:
        laser.warm(timing.rate_hz)
        laser.set(timing, exposures)
    laser.arm(STATED, code)


def _burst(laser: Laser, counter: Counter, pairs: int) -> Trial:
    def burst() -> None:
        laser.fire(pairs)
        laser.wait()

    found = len(counter.count(burst))
    return Trial(f"a burst of {pairs}", found == pairs, f"{found} of {pairs}")


def _off(laser: Laser, pairs: int, counter: Counter, clock: Clock) -> Trial:
    begun_s, stopped_s, confirmed_s = nan, nan, inf

    def burst() -> None:
        nonlocal begun_s, stopped_s, confirmed_s
        laser.fire(pairs)
        begun_s = clock.now_s()  # the first pair is exposed with the last word of it
        clock.sleep_s(1.0)
        stopped_s, told_s = clock.now_s(), time.monotonic()
        laser.stop("a trial")
        while not laser.confirm_off() and time.monotonic() < told_s + PATIENCE_S:
            clock.sleep_s(0.01)
        if laser.state is LaserState.FAULT:
            confirmed_s = time.monotonic() - told_s

    times = counter.count(burst)
    seen_s = [at_s for at_s in times if not isnan(at_s)]
    late_s = seen_s[-1] - seen_s[0] - (stopped_s - begun_s) if seen_s else inf
    reads = f"reads back after {1e3 * confirmed_s:.0f} ms" if confirmed_s < inf else "does NOT read back as off"
    laser.safe()
    said = f"off: {len(times)} of {pairs}, the last one {1e3 * late_s:.0f} ms behind the word; {reads}"
    return Trial("off in a burst", late_s <= OFF_S and confirmed_s < inf and len(times) < pairs, said)


def _cable(laser: Laser, pairs: int, counter: Counter, helper: Helper, clock: Clock) -> Trial:
    what, was_in_time = "the cable pulled in a burst", False

    def burst() -> None:
        nonlocal was_in_time
        laser.fire(pairs)
        assert laser.schedule is not None
        end_s = clock.now_s() + pairs / laser.schedule.rate_hz
        helper.pull_cable()
        was_in_time = clock.now_s() < end_s - 0.5
        clock.sleep_s(max(0.0, end_s - clock.now_s()))

    found = len(counter.count(burst))
    helper.put_back()
    try:
        laser.safe()
    except (StageError, DaqError) as error:
        return Trial(what, False, f"{found} of {pairs}, and the box was not reached again: {error}")
    if not was_in_time:
        return Trial(what, None, "it was pulled when the burst had ended; prove again")
    return Trial(what, found == pairs, f"without the cable {found} of {pairs}, then nothing")


def _long(laser: Laser, timing: PulseTiming) -> int:
    """Pairs of a burst that is long enough for hands."""
    return max(1, int(min(laser.rules.chunk_s, ENOUGH_S) * timing.rate_hz))
