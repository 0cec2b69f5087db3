"""A library that moves stages, as far as it is talked to: loaded, asked, stopped and closed in its one thread.

What it is asked has a deadline (`stages.foreign.calls`). A position is what a stage at rest reads: not busy, read
twice with `AGAIN_S` between, both the same. A servo may hunt: then it is the mean of more readings that stay
within `noise_mm` and do not all go one way, as those of a knob that is turned would. Where asking fails, the
library is lost: the box behind it may have been off, and nothing else would tell. What is made of the answers is
said in `stages.foreign.foreign_controller`.
"""

import math
import warnings
from abc import abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import ClassVar, TypeVar

from ground.errors import RtpivWarning
from stages.clock import SYSTEM_CLOCK, Clock
from stages.controller_tables import AnyControllerTable, ForeignTable
from stages.errors import (
    CommandRejected,
    DeviceError,
    DeviceLost,
    PortUnavailable,
    StageError,
    StageUsageError,
    WrongDevice,
)
from stages.foreign.calls import Calls, first_line
from stages.motion_controller import Channel, MotionController
from stages.stop_latch import StopLatch

AGAIN_S = 0.05  # between two readings of a position
STILL_MM = 0.001  # two readings of a stage at rest differ by less, unless it hunts
READINGS = 7  # of a stage that hunts; 2 of 7! = 5040 orders go one way

T = TypeVar("T")


class ForeignLibrary(MotionController):
    """The talking half of a controller that is a library."""

    library: ClassVar[str]  # in messages

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
                raise StageUsageError(f"{name}: remove steps_per_mm of {channel.name}; set mm_per_unit instead")
        self._calls: Calls | None = None
        self._failed = False  # it has raised where it was only asked: nothing is believed any more
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
            self._stopped = self._failed = False
            self._begin_anew(table)
            self._calls = Calls(self.name, table.call_s, lambda: self.latch.count != self.token, self._unload)
            self.token = self.latch.count
            try:
                identity = self._load_library(table)
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

    def _load_library(self, table: ForeignTable) -> str:
        try:
            return self._ask("to load", partial(self._load, table))
        except CommandRejected as refused:
            raise PortUnavailable(f"{refused}; is it switched on, is the cable good?") from refused

    def _tell_what_a_stop_reaches(self) -> None:
        """Say stop at rest, and tell a person what it cannot reach."""
        if why := self._ask("to stop", self._halt):
            warnings.warn(f"{self.name} cannot be stopped by its library ({why})", RtpivWarning, stacklevel=4)
        warnings.warn(
            f"{self.name} is moved by {self.library}: a stop waits for the call in progress, and if this program "
            "is killed what moves drives on to its target (docs/safety.md)",
            RtpivWarning,
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
    def is_lost(self) -> bool:
        """True if the library has failed, has not come back from a call, or is not loaded."""
        return self._calls is None or self._failed or self._calls.has_ended or bool(self._calls.stuck)

    def stop(self) -> None:
        """Stop every channel before anything else; without waiting."""
        self._stopped = True
        if self._calls is not None:
            self._calls.next(self._say_stop)

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
            raise CommandRejected(f"{self.name}, {words}: {first_line(error)}", type(error).__name__) from error

    def _look(self, channel: str) -> tuple[bool, float]:
        """Return whether the stage is busy, and what it reads [mm of the library]."""
        try:
            busy, here_mm = self._ask("for a position", lambda: (self._busy(channel), self._read_mm(channel)))
        except CommandRejected as failed:
            self._forget_references()  # it may have been off
            self._failed = True
            if self.under_way:
                with suppress(DeviceError):
                    self.stop()
            raise DeviceLost(f"{failed}; plug it in, open it again and home its axes") from failed
        if not math.isfinite(here_mm):
            self._forget_references()
            raise DeviceError(f"{self.name} channel {channel} reads {here_mm}; it has no position reference")
        return busy, here_mm

    def _at_rest(self, channel: str) -> float | None:
        """Reading of a stage at rest; None if it moves."""
        reads_mm: list[float] = []
        while len(reads_mm) < READINGS:
            if reads_mm:
                self.clock.sleep_s(AGAIN_S)
            busy, here_mm = self._look(channel)
            reads_mm.append(here_mm)
            if busy or max(reads_mm) - min(reads_mm) > self.noise_mm(channel):
                return None
            if len(reads_mm) == 2 and abs(reads_mm[1] - reads_mm[0]) <= STILL_MM:
                return here_mm
        goes_one_way = sorted(reads_mm) in (reads_mm, reads_mm[::-1])
        return None if goes_one_way else math.fsum(reads_mm) / READINGS

    def _reading_mm(self, channel: str) -> float:
        here_mm = self._at_rest(channel)
        if here_mm is None:
            raise StageUsageError(f"{self.name} channel {channel} is moving; wait until it stops")
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
        """Return whether the library says that the channel moves."""

    @abstractmethod
    def _read_mm(self, channel: str) -> float:
        """Position that it reads."""

    @abstractmethod
    def _send(self, channel: str, target_mm: float) -> None:
        """Send a channel somewhere."""

    @abstractmethod
    def _seek(self, channel: str) -> None:
        """Begin a reference run."""

    @abstractmethod
    def _halt(self) -> str:
        """Stop everything, all channels whatever one of them says; return what went wrong, or ""."""

    @abstractmethod
    def _begin_anew(self, table: ForeignTable) -> None:
        """Forget what was believed of the library that was open before."""
