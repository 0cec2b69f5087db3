"""What is believed of a stage that somebody else's library moves, and when.

Such a library says little: no flag for a lost reference, "done" before the stage has begun or has arrived, no
reason why it rests. So nothing is taken from one answer:

* a position is one of a stage that is not busy, read twice with `AGAIN_S` between, both the same;
* a motion has ended where that position is the target. Elsewhere the stage has `GRACE_S` to go on; rests it then
  still farther than `SHORT_MM`, it was stopped at its box, stalled or restarted, which nobody tells: the bench
  is held and the reference is gone;
* a reference is vouched for by the place where the stage came to rest. A stage at rest that reads something else
  was moved, or counts anew since a restart: its reference is gone. Reads it the same at the same place, its
  coordinate is the same.

What that cannot see: a stage that was pushed without power to where it reads the same again, and one that
restarts in motion and then reads its target. A library that opens a box again never learns that it was off, and
that is why no reference outlives the program: after every opening the stage is homed, or a person says where it
stands (`homing: hand`, `confirm`): then its zero lies where that makes it lie.

Calls go through one thread with a deadline (`stages.foreign.calls`). Nothing but finite numbers goes in.
"""

import math
import warnings
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from stages.clock import SYSTEM_CLOCK, Clock
from stages.controller_tables import AnyControllerTable, ForeignTable
from stages.errors import (
    CommandRejected,
    DeviceError,
    DeviceLost,
    MotionStopped,
    NotReferenced,
    OutOfRange,
    PortUnavailable,
    StageError,
    StageUsageError,
    WrongDevice,
)
from stages.foreign.calls import Calls
from stages.motion_controller import Channel, MotionController
from stages.stop_latch import StopLatch

AGAIN_S = 0.05  # between two readings of a position
STILL_MM = 0.001  # two readings of a stage at rest differ by less
THERE_MM = 0.01  # the coarsest tolerance of an axis: nearer than this is there
SHORT_MM = 0.1  # farther than this from its target a motion has ended otherwise
GRACE_S = 1.0  # a stage that is "done" elsewhere may still begin, or go on

T = TypeVar("T")


@dataclass(slots=True)
class Motion:
    """What was begun last and has not been heard to end."""

    channel: str
    start_mm: float
    target_mm: float | None  # None: looks for its reference
    seen_to_move: bool = False
    rests_since_s: float | None = None


class ForeignController(MotionController):
    """Base of all controllers that are a library."""

    library: str  # in messages

    def __init__(
        self,
        name: str,
        channels: Mapping[str, Channel],
        clock: Clock = SYSTEM_CLOCK,
        latch: StopLatch | None = None,
    ) -> None:
        super().__init__(name, channels, clock, latch)
        for channel in channels.values():
            if channel.steps_per_mm is not None:
                raise StageUsageError(f"{name}: remove steps_per_mm of {channel.name}; say mm_per_unit")
        self._calls: Calls | None = None
        self._by_hand = False
        self._home_mm = 0.0
        self._failed = False  # the library has raised where it was only asked: nothing is believed any more
        self._motion: Motion | None = None
        self._rests_mm: dict[str, float] = {}  # where channels came to rest, by the library's own zero
        self._zero_mm: dict[str, float] = dict.fromkeys(channels, 0.0)  # the library's zero, as a person has said
        self._stopped = False

    # ---- life ----------------------------------------------------------------------------------

    def open(self, table: AnyControllerTable) -> str:
        """Load the library and the devices; nothing moves."""
        assert isinstance(table, ForeignTable)
        with self._lock:
            self.close()
            if self._calls is not None and self._calls.alive:
                raise self._still_in(self._calls)
            self._forget_references()
            self._motion, self._stopped, self._failed = None, False, False
            self._by_hand, self._home_mm = table.homing == "hand", table.home_mm
            self._calls = Calls(self.name, table.call_s, lambda: self.latch.count != self.token, self._unload)
            self.token = self.latch.count
            try:
                identity = self._loaded(table)
                if self.identity not in ("", identity):
                    text = f"{identity!r} answers instead of {self.identity!r}; check the cables"
                    raise WrongDevice(f"{self.name}: {text}")
                self._tell_what_a_stop_reaches()
                for channel in self._channels:
                    self._reading_mm(channel)
            except BaseException:
                self.close()
                raise
            self.identity = identity
            self.under_way = False
            return identity

    def _loaded(self, table: ForeignTable) -> str:
        try:
            return self._ask("to load", partial(self._load, table))
        except CommandRejected as refused:
            raise PortUnavailable(f"{refused}; is it switched on, is the cable good?") from refused

    def _tell_what_a_stop_reaches(self) -> None:
        """Say stop at rest, and tell a person what it cannot reach."""
        if why := self._ask("to stop", self._halt):
            warnings.warn(f"{self.name} cannot be stopped by its library ({why})", RuntimeWarning, stacklevel=4)
        warnings.warn(
            f"{self.name} is moved by {self.library}: a stop waits for the call in progress, and if this program "
            "is killed what moves drives on to its target (docs/safety.md)",
            RuntimeWarning,
            stacklevel=4,
        )

    def _still_in(self, calls: Calls) -> DeviceLost:
        doing = f"was asked {calls.stuck} and has not answered" if calls.stuck else "is being closed"
        return DeviceLost(f"{self.name}: its library {doing}; end this program and begin anew")

    def close(self) -> None:
        """Stop and unload; a library that does not come back is left alone."""
        if self._calls is not None and not self._calls.stuck:
            self._calls.end()
        self._forget_references()

    @property
    def lost(self) -> bool:
        """True if the library has failed, has not come back from a call, or is not loaded."""
        return self._calls is None or self._failed or self._calls.ended or bool(self._calls.stuck)

    # ---- reference -----------------------------------------------------------------------------

    def _still_referenced(self, channel: str) -> bool:
        """Look whether the channel reads what it read when it came to rest."""
        busy, here_mm = self._look(channel)
        return not busy and abs(here_mm - self._rests_mm[channel]) <= THERE_MM

    def _forget_references(self) -> None:
        super()._forget_references()
        self._rests_mm.clear()

    def by_hand(self, channel: str) -> bool:
        """Whether a person says where the stage stands."""
        return self._by_hand

    def confirm(self, channel: str, position_mm: float) -> None:
        """Take a person's word for where a channel at rest stands."""
        if not self._by_hand:
            super().confirm(channel, position_mm)
        if not math.isfinite(position_mm):
            raise OutOfRange(f"{self.name}: {position_mm} is no position")
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
            raise OutOfRange(f"{self.name}: {target_mm} is no position")
        with self._lock:
            if channel not in self._referenced:
                raise NotReferenced(f"{self.name} channel {channel} has no reference; home it")
            here_mm, target_mm = self._rests_mm[channel], target_mm - self._zero_mm[channel]
            self._begin(Motion(channel, here_mm, target_mm), partial(self._send, channel, target_mm))

    def start_home(self, channel: str) -> None:
        """Let the device look for its reference."""
        if self._by_hand:
            raise StageUsageError(
                f"{self.name} cannot look for its reference; see where channel {channel} stands, and confirm that"
            )
        with self._lock:
            self._referenced -= self.homed_with(channel)
            try:
                self._begin(Motion(channel, self._look(channel)[1], None), partial(self._seek, channel))
            except CommandRejected as refused:
                text = f"{refused}; if it cannot look for its reference, say homing: hand"
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
        if short_mm > THERE_MM and not self._waited(motion):
            return False
        self._motion, self._rests_mm[motion.channel] = None, here_mm
        if short_mm > SHORT_MM:
            self._forget_references()
            raise MotionStopped(
                f"{self.name} channel {motion.channel} rests {short_mm:.3f} mm from its target: stopped at its "
                "box, stalled, or restarted; home it"
            )
        return True

    def _has_found(self, motion: Motion, here_mm: float) -> bool:
        is_there = abs(here_mm - self._home_mm) <= SHORT_MM
        if not (motion.seen_to_move and is_there) and not self._waited(motion):
            return False
        self._motion = None
        if not motion.seen_to_move:
            raise DeviceError(
                f"{self.name} channel {motion.channel} was told to home and has not moved; if its library cannot "
                "home it, say homing: hand"
            )
        if not is_there:
            raise MotionStopped(
                f"{self.name} channel {motion.channel} reads {here_mm:.3f} mm after its reference run and not "
                f"{self._home_mm:g}: stopped at its box? Otherwise correct home_mm"
            )
        for channel in self.homed_with(motion.channel) & set(self._channels):
            self._zero_mm[channel], self._rests_mm[channel] = 0.0, self._reading_mm(channel)
            self._referenced.add(channel)
        return True

    def _end_stopped(self, motion: Motion, here_mm: float) -> None:
        """Raise MotionStopped; the reference holds where the stage rests on its way."""
        self._motion, self._stopped = None, False
        if motion.target_mm is not None:
            low_mm, high_mm = sorted((motion.start_mm, motion.target_mm))
            if low_mm - SHORT_MM <= here_mm <= high_mm + SHORT_MM:
                self._rests_mm[motion.channel] = here_mm
            else:
                self._forget_references()
        raise MotionStopped(f"{self.name} channel {motion.channel} was stopped")

    def _waited(self, motion: Motion) -> bool:
        """Whether the stage has rested long enough that it will not begin any more."""
        now_s = self.clock.now_s()
        if motion.rests_since_s is None:
            motion.rests_since_s = now_s
        return now_s - motion.rests_since_s >= GRACE_S

    def position_mm(self, channel: str) -> float:
        """Position of a channel at rest: two readings that agree."""
        with self._lock:
            return self._reading_mm(channel) + self._zero_mm[channel]

    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Nothing to check: the stage has the speed that its library was told."""

    def stop(self) -> None:
        """Stop every channel before anything else; waits for nobody."""
        self._stopped = True
        if self._calls is not None:
            self._calls.next(self._say_stop)

    def abandon(self) -> None:
        """Forget a motion whose end was never heard of."""
        self._motion = None

    # ---- talking -------------------------------------------------------------------------------

    def _ask(self, words: str, function: Callable[[], T]) -> T:
        calls = self._calls
        if calls is None:
            raise DeviceLost(f"{self.name} is not open; open it and home its axes")
        try:
            return calls.ask(words, function)
        except StageError:
            if calls.stuck:
                self.stop()  # said when it comes back, if it ever does
            raise
        except Exception as error:
            raise CommandRejected(f"{self.name}, {words}: {_sentence(error)}", type(error).__name__) from error

    def _look(self, channel: str) -> tuple[bool, float]:
        """Whether the stage is busy, and what it reads [mm of the library]."""
        try:
            busy, here_mm = self._ask("for a position", lambda: (self._busy(channel), self._read_mm(channel)))
        except CommandRejected as failed:
            self._forget_references()  # it may have been off
            self._failed = True
            raise DeviceLost(f"{failed}; plug it in, open it again and home its axes") from failed
        if not math.isfinite(here_mm):
            self._forget_references()
            raise DeviceError(f"{self.name} channel {channel} reads {here_mm}; it does not know where it is")
        return busy, here_mm

    def _at_rest(self, channel: str) -> float | None:
        """What a stage at rest reads; None if it moves."""
        busy, first_mm = self._look(channel)
        if busy:
            return None
        self.clock.sleep_s(AGAIN_S)
        busy, again_mm = self._look(channel)
        return None if busy or abs(again_mm - first_mm) > STILL_MM else again_mm

    def _reading_mm(self, channel: str) -> float:
        here_mm = self._at_rest(channel)
        if here_mm is None:
            raise StageUsageError(f"{self.name} channel {channel} moves; wait until it rests")
        return here_mm

    def _say_stop(self) -> None:
        if why := self._halt():
            raise DeviceError(f"{self.name} could not be stopped: {why}")

    # ---- for each kind of library; called in its thread alone ----------------------------------

    @abstractmethod
    def _load(self, table: ForeignTable) -> str:
        """Load library and devices; return who answers."""

    @abstractmethod
    def _unload(self) -> None:
        """Let go of everything."""

    @abstractmethod
    def _busy(self, channel: str) -> bool:
        """Whether the library says that the channel moves."""

    @abstractmethod
    def _read_mm(self, channel: str) -> float:
        """What it reads."""

    @abstractmethod
    def _send(self, channel: str, target_mm: float) -> None:
        """Send a channel somewhere."""

    @abstractmethod
    def _seek(self, channel: str) -> None:
        """Begin a reference run."""

    @abstractmethod
    def _halt(self) -> str:
        """Stop everything, all channels whatever one of them says; return what went wrong, or ""."""


def _sentence(error: BaseException) -> str:
    """First line of what a library has said."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:300]
