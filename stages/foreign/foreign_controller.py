"""State of a stage that is moved by a third-party library.

Such a library says little: no flag for a lost reference, "done" before the stage has begun or has arrived, no
reason why it rests. So nothing is taken from one answer:

* a position is one of a stage that is not busy, read twice with `AGAIN_S` between, both the same;
* a motion has ended where that position is the target. Elsewhere the stage has `GRACE_S` to go on; rests it then
  still farther than `EARLY_END_MM`, it was stopped at its box, stalled or restarted, which is not reported: the
  bench is held and the reference is gone;
* a reference is vouched for by the place where the stage came to rest. A stage at rest that reads something else
  was moved, or counts anew since a restart: its reference is gone. Reads it the same at the same place, its
  coordinate is the same.

What that cannot see: a stage that was pushed without power to where it reads the same again, one that restarts in
motion and then reads its target, and one that was stopped at its box so late that it brakes to within
`EARLY_END_MM` of its target or reference. A library that opens a box again never learns that it was off, and that
is why no reference outlives the program: after every opening the stage is homed, or a person says where it stands
(`homing: hand`, `confirm`): then its zero lies where that makes it lie.

Calls go through one thread with a deadline (`stages.foreign.calls`). Nothing but finite numbers goes in.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from stages.clock import SYSTEM_CLOCK, Clock
from stages.controller_tables import ForeignTable
from stages.errors import (
    CommandRejected,
    DeviceError,
    MotionStopped,
    NotReferenced,
    OutOfRange,
    StageUsageError,
)
from stages.foreign.library import STILL_MM, ForeignLibrary
from stages.motion_controller import Channel
from stages.stop_latch import StopLatch

THERE_MM = 0.01  # the coarsest tolerance of an axis: nearer than this is there
EARLY_END_MM = 0.1  # farther than this from its target a motion has ended otherwise
GRACE_S = 1.0  # a stage that is "done" elsewhere may still begin, or go on


@dataclass(slots=True)
class Motion:
    """Last motion that was begun and is not known to have ended."""

    channel: str
    start_mm: float
    target_mm: float | None  # None: looks for its reference
    seen_to_move: bool = False
    rests_since_s: float | None = None


class ForeignController(ForeignLibrary):
    """Base of all controllers that are a library."""

    def __init__(
        self,
        name: str,
        channels: Mapping[str, Channel],
        clock: Clock = SYSTEM_CLOCK,
        latch: StopLatch | None = None,
    ) -> None:
        super().__init__(name, channels, clock, latch)
        self._homed_by_hand = False
        self._home_mm = 0.0
        self._motion: Motion | None = None
        self._rests_mm: dict[str, float] = {}  # where channels came to rest, by the library's own zero
        # the library's zero, as a person has said
        self._zero_mm: dict[str, float] = dict.fromkeys(channels, 0.0)

    def _begin_anew(self, table: ForeignTable) -> None:
        self._motion, self._homed_by_hand, self._home_mm = None, table.homing == "hand", table.home_mm

    # ---- reference -----------------------------------------------------------------------------

    def _still_referenced(self, channel: str) -> bool:
        """Look whether the channel reads what it read when it came to rest."""
        busy, here_mm = self._look(channel)
        if not busy and abs(here_mm - self._rests_mm[channel]) > STILL_MM:  # does it only hunt?
            here_mm = math.inf if (rests_mm := self._at_rest(channel)) is None else rests_mm
        return not busy and abs(here_mm - self._rests_mm[channel]) <= THERE_MM

    def _forget_references(self) -> None:
        super()._forget_references()
        self._rests_mm.clear()

    def needs_hand_homing(self, channel: str) -> bool:
        """Return whether a person says where the stage stands."""
        return self._homed_by_hand

    def confirm(self, channel: str, position_mm: float) -> None:
        """Take a person's word for where a channel at rest stands."""
        if not self._homed_by_hand:
            super().confirm(channel, position_mm)
        if not math.isfinite(position_mm):
            raise OutOfRange(f"{self.name}: {position_mm} is not a position")
        with self._lock:
            here_mm = self._reading_mm(channel)
            self._zero_mm[channel] = position_mm - here_mm
            self._rests_mm[channel] = here_mm
            self._referenced.add(channel)
            self.rests()

    # ---- motion --------------------------------------------------------------------------------

    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Begin an absolute move, with the speed that the library has."""
        if not math.isfinite(target_mm):
            raise OutOfRange(f"{self.name}: {target_mm} is not a position")
        with self._lock:
            if channel not in self._referenced:
                raise NotReferenced(f"{self.name} channel {channel} has no reference; home it")
            here_mm, target_mm = self._rests_mm[channel], target_mm - self._zero_mm[channel]
            self._begin(Motion(channel, here_mm, target_mm), partial(self._send, channel, target_mm))

    def start_home(self, channel: str) -> None:
        """Let the device look for its reference."""
        if self._homed_by_hand:
            raise StageUsageError(
                f"{self.name} cannot search for its reference; read the position of channel {channel}, and "
                "confirm it"
            )
        with self._lock:
            self._referenced -= self.channels_homed_with(channel)
            try:
                self._begin(Motion(channel, self._look(channel)[1], None), partial(self._seek, channel))
            except CommandRejected as refused:
                text = f"{refused}; if it cannot look for its reference, set homing: hand"
                raise CommandRejected(text, refused.code) from refused

    def _begin(self, motion: Motion, function: Callable[[], None]) -> None:
        """Hand a motion over; the library's thread begins it only while no stop has come.

        It does not hold the latch's gate meanwhile: a call that hangs would hold up everybody else. A stop that
        slips in behind the look is the thread's next call, so it comes after the motion and ends it.
        """

        def unless_stopped() -> None:
            self.latch.check(self.token)
            self.under_way = True
            try:
                function()
            except StageUsageError:  # ours: nothing was sent
                self.under_way = False
                raise

        self._stopped, self._motion = False, motion
        self._ask(f"to move {motion.channel}", unless_stopped)

    def moving(self, channel: str) -> bool:
        """Look twice; the end of a motion is a stage at rest where it was sent."""
        with self._lock:
            here_mm = self._at_rest(channel)
            motion = self._motion
            if here_mm is None:
                if motion is not None:
                    motion.seen_to_move, motion.rests_since_s = True, None
                return True
            if motion is None or motion.channel != channel:
                return False
            if self._stopped:
                self._end_stopped(motion, here_mm)
            return not (
                self._has_found(motion, here_mm) if motion.target_mm is None else self._has_come(motion, here_mm)
            )

    def _has_come(self, motion: Motion, here_mm: float) -> bool:
        assert motion.target_mm is not None
        short_mm = abs(here_mm - motion.target_mm)
        if short_mm > THERE_MM and not self._has_rested(motion):
            return False
        self._motion, self._rests_mm[motion.channel] = None, here_mm
        if short_mm > EARLY_END_MM:
            self._forget_references()
            raise MotionStopped(
                f"{self.name} channel {motion.channel} rests {short_mm:.3f} mm from its target: stopped at its "
                "box, stalled, or restarted; home it"
            )
        return True

    def _has_found(self, motion: Motion, here_mm: float) -> bool:
        reads_mm = {motion.channel: here_mm}
        for channel in self.channels_homed_with(motion.channel) - {motion.channel}:
            reads_mm[channel] = self._reading_mm(channel)
        off_mm = max(abs(mm - self._home_mm) for mm in reads_mm.values())
        if not (motion.seen_to_move and off_mm <= EARLY_END_MM) and not self._has_rested(motion):
            return False
        self._motion = None
        where = f"{self.name} channel {' and '.join(reads_mm)}"
        if not motion.seen_to_move:
            raise DeviceError(
                f"{where} was commanded to home and has not moved; if its library cannot home it, set homing: hand"
            )
        if off_mm > EARLY_END_MM:
            read = " and ".join(f"{mm:.3f}" for mm in reads_mm.values())
            raise MotionStopped(
                f"{where} reads {read} mm after its reference run and not {self._home_mm:g}: stopped at its box? "
                "Otherwise correct home_mm"
            )
        for channel, mm in reads_mm.items():
            self._zero_mm[channel], self._rests_mm[channel] = 0.0, mm
            self._referenced.add(channel)
        return True

    def _end_stopped(self, motion: Motion, here_mm: float) -> None:
        """Raise MotionStopped; the reference holds where the stage rests on its way."""
        self._motion, self._stopped = None, False
        if motion.target_mm is not None:
            low_mm, high_mm = sorted((motion.start_mm, motion.target_mm))
            if low_mm - EARLY_END_MM <= here_mm <= high_mm + EARLY_END_MM:
                self._rests_mm[motion.channel] = here_mm
            else:
                self._forget_references()
        raise MotionStopped(f"{self.name} channel {motion.channel} was stopped")

    def _has_rested(self, motion: Motion) -> bool:
        """Return whether the stage has rested long enough that it will not begin any more."""
        now_s = self.clock.now_s()
        if motion.rests_since_s is None:
            motion.rests_since_s = now_s
        return now_s - motion.rests_since_s >= GRACE_S

    def position_mm(self, channel: str) -> float:
        """Position of a channel at rest: two readings that agree."""
        with self._lock:
            return self._reading_mm(channel) + self._zero_mm[channel]

    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Nothing to check: the stage has the speed that was set in its library."""

    def abandon(self) -> None:
        """Forget a motion whose end was never heard of."""
        self._motion = None
