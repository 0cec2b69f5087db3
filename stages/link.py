"""The one way of talking to a controller, that makes late and damaged answers harmless.

**Late answers.** Most protocols carry no message number, so the answer to a question that timed out could be
taken for the answer to the next one. After every timeout, unreadable or surplus byte the link is SUSPECT: before
anything else is asked, input is drained, then the controller must identify itself. A wire keeps its order, so
once the identity has come, every older answer has come too. Questions are repeated after that; commands that
move are never repeated here, because only the caller knows what moving twice would do.

**Damaged answers.**  Where the protocol has no checksum, a position counts only when two readings in a row agree.
"""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import ClassVar, Protocol, TypeVar

from stages.clock import Clock
from stages.errors import DeviceLost, NoReply, PortUnavailable, ProtocolViolation, WrongDevice
from stages.port import Port
from stages.who_answers import describe_reply

QUIET_S = 0.12  # silence that ends draining
LOOK_UP_S = 0.03  # how long a wait for an answer takes notice of nothing else
REPEATS = 3  # times a question is asked
FENCES = 6  # times a controller is asked to identify itself before it is given up

T = TypeVar("T")


class Stream(Protocol):
    """A grammar's decoder: bytes in, answers (or violations) out."""

    @property
    def rest(self) -> bytes:
        """Bytes that are no whole answer yet."""

    def feed(self, chunk: bytes) -> Sequence[object]:
        """Add bytes; return what is complete."""


class Link(ABC):
    """A port and the questions that go through it; base of stages' controllers and of timing units.

    Parameters
    ----------
    name : str
        Used in messages.
    clock : Clock
        Clock of every deadline.
    """

    reply_timeout_s: float = 0.5
    decoder: ClassVar[Callable[[], Stream]]  # made for each answer
    first_day: str = ""  # what else may be wrong with a box that has never answered, as a sentence

    def __init__(self, name: str, clock: Clock) -> None:
        self.name = name
        self.clock = clock
        self.identity = ""
        self._port: Port | None = None
        self._lock = threading.RLock()
        self._suspect = False

    @property
    def port(self) -> Port:
        """The open port.

        Raises
        ------
        DeviceLost
            There is none.
        """
        if self._port is None:
            raise DeviceLost(f"{self.name} is not connected; open it and home its axes")
        return self._port

    def _open_port(self, url: str, baud: int, *, hold_dtr: bool = False, flow_control: bool = False) -> None:
        """Open the port, with the name of the box in the sentence that says why not."""
        try:
            self._port = Port(url, baud, clock=self.clock, hold_dtr=hold_dtr, flow_control=flow_control)
        except PortUnavailable as error:
            raise PortUnavailable(f"{self.name} ({baud} baud): {error}") from error

    def _unheard(self) -> str:
        """Say, as a sentence, what came instead of an answer, and what may be done about it."""
        port = self.port
        where = f"{self.name} on {port.url} at {port.baud} baud"
        if self.identity:
            return (
                f"{where} has answered before and gives no clear answer now; is it switched off, or is its cable "
                "loose? See to it, then open it again"
            )
        sent = [chunk.data for chunk in port.trace if chunk.sent]
        own = type(self).__module__.rpartition(".")[2]
        words = [f"{where} {describe_reply(port.heard(), sent, own)}", self.first_day]
        return " ".join([*filter(None, words), f"rtpiv doctor --probe {port.url} tries other rates and boxes"])

    def close(self) -> None:
        """Close the port; safe at any time."""
        if self._port is not None:
            self._port.close()
            self._port = None

    @property
    def is_lost(self) -> bool:
        """True if the box cannot be reached until `connect` is called again."""
        return self._port is None or self._port.is_lost

    @abstractmethod
    def _identify(self) -> str:
        """Ask who answers; also the fence after which no older answer can come."""

    def _stream(self) -> Stream:
        """Decoder for the next answer."""
        return type(self).decoder()

    def _take_drained(self, data: bytes) -> None:  # noqa: B027 - most protocols have no alarms
        """Look at what was swallowed before a fence; alarms must not get lost there."""

    def _take_unsolicited(self, data: bytes) -> None:
        """Judge bytes that came when nothing was asked; they must not be taken for an answer later."""
        self._suspect = True

    def _transact(
        self,
        data: bytes,
        accept: Callable[[object], T | None],
        timeout_s: float | None = None,
        stream: Stream | None = None,
        moves: bool = False,
    ) -> T:
        """Send, and wait for the answer that `accept` recognises.

        `accept` returns None for answers to skip and may raise.  Surplus answers make the link suspect.  With
        `moves` the bytes go through the gate of the stop latch.
        """
        with self._lock:
            self._clear_line()
            return self._converse(data, accept, timeout_s, stream, moves)

    def _send(self, data: bytes, moves: bool = False) -> None:
        """Send what is answered when its motion has ended, or not at all."""
        with self._lock:
            self._clear_line()
            with self._gate(moves):
                self.port.write(data)

    def _gate(self, moves: bool) -> AbstractContextManager[None]:
        """Gate for bytes that start a motion; none for a device that moves nothing."""
        return nullcontext()

    def _clear_line(self) -> None:
        """See that nothing older can be taken for the next answer."""
        if self._suspect:
            self._resynchronise()
        if early := self.port.pending():
            self._take_unsolicited(early)
            if self._suspect:
                self._resynchronise()

    def _converse(
        self,
        data: bytes,
        accept: Callable[[object], T | None],
        timeout_s: float | None = None,
        stream: Stream | None = None,
        moves: bool = False,
    ) -> T:
        port, stream = self.port, stream or self._stream()
        deadline_s = self.clock.now_s() + (timeout_s or self.reply_timeout_s)
        try:
            with self._gate(moves):
                port.write(data)
            while True:
                answers = list(stream.feed(self._read(port, deadline_s)))
                while answers:
                    answer = answers.pop(0)
                    if isinstance(answer, ProtocolViolation):
                        raise answer
                    if (result := accept(answer)) is not None:
                        if answers or stream.rest:
                            self._surplus(answers, stream.rest)
                        return result
        except (NoReply, ProtocolViolation):
            self._suspect = True
            raise

    def _read(self, port: Port, deadline_s: float) -> bytes:
        """Wait for bytes, and look up from time to time."""
        while True:
            try:
                return port.read(min(deadline_s, self.clock.now_s() + LOOK_UP_S))
            except NoReply:
                if self.clock.now_s() >= deadline_s:
                    raise
            self._look_up()

    def _look_up(self) -> None:  # noqa: B027 - nothing can happen to a device that does not move
        """See what has happened while an answer did not come."""

    def _surplus(self, answers: Sequence[object], rest: bytes) -> None:
        """Judge what came in one chunk with, but after, the answer."""
        self._suspect = True

    def _resynchronise(self) -> None:
        """Drain, then make the controller identify itself; afterwards no older answer can be under way."""
        identity = self.identity
        for _ in range(FENCES):
            self._take_drained(self.port.drain(QUIET_S))
            self._suspect = False
            try:
                identity = self._identify()
                if not self._suspect and identity == (self.identity or identity):
                    return
            except (NoReply, ProtocolViolation):
                identity = self.identity
            self._suspect = (
                True  # late answers to earlier fences, or the rest of a damaged one before the identity
            )
        if identity != self.identity:
            raise WrongDevice(f"{self.name}: {identity!r} answers instead of {self.identity!r}; check the cables")
        raise NoReply(self._unheard())

    def _ask_again(self, ask: Callable[[], T]) -> T:
        """Ask a question again when its answer was late or damaged; never for commands that move."""
        for _ in range(REPEATS - 1):
            try:
                return ask()
            except (NoReply, ProtocolViolation):
                continue
        return ask()

    def _ask_until_equal(self, ask: Callable[[], T], same: Callable[[T, T], bool] = lambda a, b: a == b) -> T:
        """Ask until two readings in a row agree: one damaged answer is then never believed."""
        before = self._ask_again(ask)
        for _ in range(2 * REPEATS):
            now = self._ask_again(ask)
            if same(before, now):
                return now
            before = now
        raise ProtocolViolation(f"{self.name}: readings at rest do not agree; check the cable")
