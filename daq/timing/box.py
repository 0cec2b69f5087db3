"""Interface of a timing unit, as the laser uses it; a driver is a box on `stages.link.Link`.

**Off has two ways.** `silence` is the thorough one: it converses, writes every output off, reads every one back,
and raises if anything is not off. `drop` is the one that nothing postpones: it writes the same without waiting
for an answer or for a lock, so it may come from any thread while another one waits in a conversation. The line
is suspect afterwards and is cleared before anything else is asked.

**On has one way**: bytes after which an output can pulse pass the gate of a `StopLatch` (`moves=True`), so that no
stop slips in between the look and the write, and the watchdog has heard of it before they leave.
"""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import ClassVar, Literal

from daq.timing.errors import LaserDoubt, LaserStopped, PulsesRefused
from daq.timing.pulses import Pulse, Role, Schedule
from stages.clock import SYSTEM_CLOCK, Clock
from stages.errors import CommandRejected, DeviceLost, MotionStopped, NoReply, PortError, ProtocolViolation
from stages.link import QUIET_S, Link
from stages.stop_latch import StopLatch
from stages.watchdog import Watchdog


class TimingBox(Link):
    """Base of the drivers of timing units.

    Parameters
    ----------
    name : str
        What the bench file calls it; used in messages.
    wiring : mapping of Role to str
        Output of the box by the device connected to it.
    clock : Clock
        Clock of every deadline.
    latch : StopLatch, optional
        What switches it off; one of its own by default.
    """

    default_baud: ClassVar[int]
    counts: ClassVar[bool]  # the box ends a burst by itself after so many pulses, whatever becomes of us
    least_step_us: ClassVar[float]  # of delays and widths

    def __init__(
        self, name: str, wiring: Mapping[Role, str], clock: Clock = SYSTEM_CLOCK, latch: StopLatch | None = None
    ) -> None:
        super().__init__(name, clock)
        self.wiring = dict(wiring)
        self.latch = latch or StopLatch()
        self.token = self.latch.count  # of what may be switched on now; set by the laser
        self.may_be_on = False  # something was switched on, and nothing has read back as off since
        self.watchdog: Watchdog | None = None  # set where a port is opened that outlives the process
        self.gate: Literal["high", "low"] | None = (
            None  # level of the gate input that lets pulses out; None: not used
        )
        self.address = ""  # of boxes that have to be called by their name; from the bench file
        self._url, self._baud = "", 0

    # ---- life ----------------------------------------------------------------------------------

    def connect(self, url: str, baud: int | None = None) -> str:
        """Open the port and find out who answers; nothing is switched on. `silence` is the next thing to ask.

        Returns
        -------
        str
            What the box says of itself.

        Raises
        ------
        PortUnavailable, NoReply
            The port cannot be opened, or there is no answer.
        WrongBox
            Another box answers, it lacks an output that the wiring names, or it is set up to act by itself.
        """
        with self._lock:
            self.close()
            self._url, self._baud = url, baud or self.default_baud
            self._open_port(self._url, self._baud)
            try:
                self._suspect = False
                self.drop()  # before a word is asked: whatever ran before us is not ours
                self.port.drain(QUIET_S)
                self._suspect = False
                try:
                    identity = self._ask_until_equal(self._identify)
                except (NoReply, ProtocolViolation) as error:
                    raise NoReply(self._unheard()) from error
                if self.identity and identity != self.identity:
                    raise LaserDoubt(f"{self.name}: {identity!r} answers instead of {self.identity!r}")
                self.identity = identity
                self._set_up()
            except BaseException:
                self.close()
                raise
            return self.identity

    def reconnect(self) -> None:
        """Open the same port again after it was lost."""
        self.connect(self._url, self._baud)

    def answers(self) -> bool:
        """Return whether the box says who it is when it is asked once; a port that is lost is not opened again."""
        with self._lock:
            if self.is_lost:
                return False
            try:
                self.port.drain(QUIET_S)
                self._suspect = False
                return self._identify() == self.identity
            except (PortError, ProtocolViolation, CommandRejected):
                return False
            finally:
                self._suspect = True  # its answer may still come

    # ---- off -----------------------------------------------------------------------------------

    def drop(self) -> None:
        """Write everything off now, Q-switches first; from any thread, without waiting.

        Raises
        ------
        DeviceLost
            There is no port to write to.
        """
        self._write_off(self.off_bytes())

    def _write_off(self, strings: Sequence[bytes]) -> None:
        port = self._port
        if port is None or port.is_lost:
            raise DeviceLost(f"{self.name} is not connected; no command could be sent")
        self._suspect = True
        for data in strings:
            port.write(data)
        self._suspect = True  # again: another thread may have cleared it while the bytes were on their way

    @abstractmethod
    def off_bytes(self) -> Sequence[bytes]:
        """Return the bytes that switch everything off, Q-switches first; each is written whole, at any time."""

    @abstractmethod
    def silence(self) -> None:
        """Write everything off, Q-switches first, and read every output back.

        Raises
        ------
        LaserDoubt
            Something reads back as on.
        PortError, ProtocolViolation
            It could not be read.
        """

    # ---- on ------------------------------------------------------------------------------------

    def _with_output(self, schedule: Schedule) -> dict[Role, Pulse]:
        """Pulses of a schedule, all of which have an output; a marker needs none."""
        for role in schedule.pulses:
            if role not in self.wiring and role is not Role.MARKER:
                raise PulsesRefused(f"{self.name} has no output for {role}; assign one in channels")
        return {role: pulse for role, pulse in schedule.pulses.items() if role in self.wiring}

    @abstractmethod
    def load(self, schedule: Schedule) -> Schedule:
        """Write the period and every pulse while no Q-switch output is on; return what the box says it has.

        Raises
        ------
        LaserDoubt
            A Q-switch output is on, or a number reads back as another one.
        PulsesRefused
            The box cannot do one of the numbers, or has no output for a pulse; nothing was sent.
        """

    @abstractmethod
    def start_lamps(self) -> None:
        """Let the lamps run at the loaded period, and nothing else."""

    def stand_by(self) -> None:
        """Without lamps: keep running what any off clears, so that `begin` finds it; no output is switched on."""

    @abstractmethod
    def confirm(self, schedule: Schedule, lamps: bool) -> None:
        """Ask whether the box still holds a schedule, its lamps run (or not) and every Q-switch is off.

        Raises
        ------
        LaserDoubt
            It does not: a restart, or a person at its keys.
        """

    def require_lamps(self, on: bool) -> None:
        """Ask whether the lamps run, or do not; LaserDoubt if it is the other way."""

    @abstractmethod
    def begin(self, pairs: int, camera: bool = True) -> None:
        """Give that many pulses on each Q-switch output; the box counts them where it can.

        Parameters
        ----------
        pairs : int
            How many.
        camera : bool
            Whether camera and marker get their pulses as well.
        """

    @abstractmethod
    def end(self) -> None:
        """End a burst whose time is over: Q-switches, camera and marker off and read back, lamps as they are.

        Raises
        ------
        LaserDoubt
            It does not end, or had ended before its time.
        """

    # ---- for drivers ---------------------------------------------------------------------------

    @abstractmethod
    def _set_up(self) -> None:
        """Look at the box after opening; refuse what must not be used. Nothing is switched on."""

    @contextmanager
    def _gate(self, moves: bool) -> Iterator[None]:
        """Bytes that switch on are written only while no stop has come since they were wanted."""
        if not moves:
            yield
            return
        try:
            with self.latch.gate(self.token):
                self.may_be_on = True
                if self.watchdog is not None:
                    self.watchdog.moves(self.name)
                yield
        except MotionStopped:
            raise LaserStopped(f"{self.name} was switched off meanwhile") from None


UNREADABLE = (PortError, ProtocolViolation, CommandRejected, LaserDoubt)
