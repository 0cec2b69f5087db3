"""A box that speaks bytes: what all serial drivers share; how it is talked to is said in `stages.link`.

The calls that axes use are those of `stages.motion_controller`; here they are made of questions and answers on
one port. How a box confirms its reference (a flag, an error, a mark that a restart wipes out) is
each driver's `_still_referenced`.

Bytes that move go through the gate of the bench's stop latch (`moves=True`); `stop` may be called from any thread
at any time: it bypasses the lock that serialises everything else.
"""

import operator
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar, TypeVar

from stages.clock import SYSTEM_CLOCK, Clock
from stages.controller_tables import AnyControllerTable, ControllerTable
from stages.errors import NoReply, ProtocolViolation, StageError, StageUsageError, WrongDevice
from stages.link import QUIET_S, Link
from stages.motion_controller import Channel, MotionController
from stages.stop_latch import StopLatch
from stages.watchdog import Watchdog, needs_watchdog

__all__ = ["Channel", "Controller"]

T = TypeVar("T")


class Controller(Link, MotionController):
    """Base of all serial drivers.

    Parameters
    ----------
    name : str
        What the bench file calls it; used in messages.
    channels : mapping of str to Channel
        The motors in use, by their name on the controller.
    clock : Clock
        Clock of every deadline.
    latch : StopLatch, optional
        The bench's stop; one of its own by default.
    """

    default_baud: ClassVar[int]
    # tried after it where the bench file says none: usual, not default
    other_bauds: ClassVar[Sequence[int]] = ()
    example_channels: ClassVar[tuple[str, str]]  # two valid names, for messages and contract tests
    hold_dtr: ClassVar[bool] = False
    flow_control: ClassVar[bool] = False  # RTS/CTS, and buffers that are emptied after opening
    wakes_within_s: ClassVar[float] = 0.0  # deaf after opening for as long as this, because opening resets it
    counts_steps: ClassVar[bool] = False  # the protocol speaks steps, so every channel needs steps_per_mm
    homes_together: ClassVar[bool] = False  # one command homes every channel

    def __init__(
        self,
        name: str,
        channels: Mapping[str, Channel],
        clock: Clock = SYSTEM_CLOCK,
        latch: StopLatch | None = None,
    ) -> None:
        Link.__init__(self, name, clock)
        MotionController.__init__(self, name, channels, clock, latch)
        self.watchdog: Watchdog | None = None
        self.baud = self.default_baud  # at which it has answered
        self._at_rest: dict[str, Any] = {}  # readings that two answers agreed on since the last motion
        self._stopped = False
        for channel in self._channels.values():
            self._check_channel(channel)
        self._reset_state()

    # ---- life ----------------------------------------------------------------------------------

    def open(self, table: AnyControllerTable) -> str:
        """Open the port that the bench file names."""
        assert isinstance(table, ControllerTable)
        return self.connect(table.port, table.baud)

    def register_watchdog(self, table: AnyControllerTable, start: Callable[[], Watchdog]) -> None:
        """Tell the watchdog how the box is stopped, where the port outlives the process."""
        assert isinstance(table, ControllerTable)
        if needs_watchdog([table.port]):
            self.watchdog = start()
            baud = table.baud or self.baud
            self.watchdog.know(self.name, table.port, baud, self.hold_dtr, self.watchdog_bytes())

    def connect(self, url: str, baud: int | None = None) -> str:
        """Open the port and find out who answers; nothing moves.

        Parameters
        ----------
        url : str
            What `Port` opens.
        baud : int, optional
            Other than the protocol's usual rate.

        Returns
        -------
        str
            Identity of the controller.

        Raises
        ------
        PortUnavailable, NoReply
            The port cannot be opened, or there is no answer.
        WrongDevice
            Another device answers than the first time, or its set-up does not fit the bench file.
        """
        with self._lock:
            self.close()
            self._forget_references()
            rates = [baud] if baud else [self.baud, *self.other_bauds]
            failures: list[StageError] = []
            for rate in rates:
                try:
                    self._connect_at(url, rate)
                except (NoReply, ProtocolViolation) as error:
                    failures.append(error)
                    if self.identity:  # it has answered before, so the rate is right
                        raise
                else:
                    self.baud = rate
                    return self.identity
            tried = ", ".join(str(rate) for rate in rates[1:])
            raise NoReply(f"{failures[0]} (tried as well: {tried} baud)") if tried else failures[0]

    def _connect_at(self, url: str, baud: int) -> None:
        """Open the port at one rate and find out who answers."""
        self._open_port(url, baud, hold_dtr=self.hold_dtr, flow_control=self.flow_control)
        try:
            if self.under_way:  # what was moving when the port was lost may move still
                self.stop()
            self._get_to_know()
        except BaseException:
            self.close()
            raise

    def _get_to_know(self) -> None:
        first_time = not self.identity
        self._suspect = self._stopped = False
        self._reset_state()
        self.port.drain(QUIET_S)
        try:
            identity = self._ask_until_equal(self._woken)
        except (NoReply, ProtocolViolation) as error:
            raise NoReply(self._unheard()) from error
        if not first_time and identity != self.identity:
            raise WrongDevice(f"{self.name}: {identity!r} answers instead of {self.identity!r}; check the cables")
        self.identity = identity
        self._set_up()
        if first_time:  # after a loss the position is not confirmed, whatever the controller says
            self._referenced |= {name for name in self._channels if self._remembers_reference(name)}

    def _woken(self) -> str:
        """Ask for the identity until there is an answer, or the controller should have woken up."""
        end_s = self.clock.now_s() + self.wakes_within_s
        while True:
            try:
                return self._identify()
            except (NoReply, ProtocolViolation):
                if self.clock.now_s() >= end_s:
                    raise
                self.port.drain(QUIET_S)  # a line that answers nonsense at once is not asked without a pause

    # ---- motion --------------------------------------------------------------------------------

    def stop(self) -> None:
        """Stop every channel now; harmless when nothing moves; does not wait for other threads."""
        self._stopped = True
        port = self._port
        if port is not None and not port.is_lost:
            for data in self._stop_bytes():
                port.write(data)
        # again: another thread may have consumed the first while the bytes were on their way
        self._stopped = True

    def _look_up(self) -> None:
        """Say stop again if one has come since the motion began: it may have overtaken a command still unread."""
        if self.under_way and self.latch.count != self.token:
            self.stop()

    def watchdog_bytes(self) -> Sequence[bytes]:
        """Bytes that stop any motion, for a watchdog that does not know what was begun."""
        return self._stop_bytes()

    def rests(self) -> None:
        """Note that the motion under way is known to have ended."""
        super().rests()
        if self.watchdog is not None:
            self.watchdog.rests(self.name)

    def abandon(self) -> None:
        """Forget a motion whose end was never heard of; the link is checked before it is used again."""
        with self._lock:
            self._suspect = True
            self._at_rest.clear()
            self._reset_state()

    def channels_homed_with(self, channel: str) -> frozenset[str]:
        """All channels where one command homes them, or the one."""
        return frozenset(self._channels) if self.homes_together else frozenset({channel})

    # ---- for drivers ---------------------------------------------------------------------------

    @abstractmethod
    def _stop_bytes(self) -> Sequence[bytes]:
        """Bytes that stop the motion, sent without waiting."""

    @abstractmethod
    def _set_up(self) -> None:
        """Read or write what the controller needs after opening."""

    @abstractmethod
    def _reset_state(self) -> None:
        """Forget what belonged to a motion."""

    def _remembers_reference(self, channel: str) -> bool:
        """Ask whether the controller was referenced before we came."""
        return False

    def _forget_references(self) -> None:
        """Believe nothing of this controller any more; all of its channels restart together."""
        super()._forget_references()
        self._at_rest.clear()

    def _near(self, channel: str, counts_per_mm: float = 1.0) -> Callable[[float, float], bool]:
        """Return whether two readings of a channel differ by no more than noise."""
        noise = self.noise_mm(channel) * counts_per_mm
        return lambda first, second: abs(first - second) <= noise

    def _settle_reading(self, key: str, ask: Callable[[], T], same: Callable[[T, T], bool] = operator.eq) -> T:
        """Return a reading at rest that two answers agree on: of one damaged answer nothing is ever believed.

        The first of the two may be an earlier one, as long as nothing was sent that moves and the link was never
        suspect since: a controller at rest answers the same again.
        """
        if key in self._at_rest:
            now = self._ask_again(ask)
            if key in self._at_rest and same(self._at_rest[key], now):
                return now
        found = self._ask_until_equal(ask, same)
        self._at_rest[key] = found
        return found

    @contextmanager
    def _gate(self, moves: bool) -> Iterator[None]:
        """Bytes that move are written only while no stop has come since their motion began."""
        if not moves:
            yield
            return
        self._at_rest.clear()
        with self.latch.gate(self.token):
            self.under_way = True
            if self.watchdog is not None:
                self.watchdog.moves(self.name)
            yield

    def _check_channel(self, channel: Channel) -> None:
        if self.counts_steps and not channel.steps_per_mm:
            raise StageUsageError(
                f"{self.name}: channel {channel.name} needs steps_per_mm; this controller counts steps"
            )

    def _scale(self, channel: str) -> float:
        """Steps per mm of a channel of a controller that counts steps."""
        return float(self._channels[channel].steps_per_mm or 0.0)
