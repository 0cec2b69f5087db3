"""The serial port: the only file of the stages that knows pyserial.

Three things go wrong with serial ports in ways that hurt a long run, and all three are settled here:

* **Unplugging.**  pyserial reports it as ``SerialException`` from read and write, as ``OSError`` from
  ``in_waiting`` and as ``termios.error`` (no OSError) from flushing, while ``is_open`` stays true.  Here all of
  them become `DeviceLost`, and the port stays lost until it is opened again.
* **Waiting.**  Every read has a deadline on the port's clock; there is no call without one.  A read returns what
  has arrived, never "a line": half a line is for the grammar to keep.
* **Sharing.**  The lock of ``exclusive=True`` is advisory but honoured by every program that asks for it, ours
  included: a second opener is refused instead of stealing replies.

`write` may be called from any thread and is atomic, so a stop gets through while another thread waits in
`read`. The last `TRACE_LENGTH` chunks in both directions are kept for the error report; all of them go to a file
if that is recorded (`stages.dialogue`).

URLs are pyserial's: a device name, ``socket://``, ``loop://``; ``sim://`` is the simulated bench, found by the
name of its package only when such a port is opened.
"""

import errno
import threading
from collections import deque
from contextlib import suppress
from typing import NamedTuple

import serial

from stages.clock import SYSTEM_CLOCK, Clock
from stages.dialogue import Dialogue, RecordedFile, recording_file
from stages.errors import DeviceLost, NoReply, PortUnavailable

try:
    from termios import error as TermiosError  # noqa: N812 - it is a class
except ImportError:  # not a POSIX machine: pyserial raises nothing of the kind there
    TermiosError = OSError  # type: ignore[assignment,misc]

PORT_POLL_S = 0.02  # how long one read blocks; the deadline is checked in between
WRITE_TIMEOUT_S = 1.0
DWELL_S = 0.05  # before and behind the emptying of buffers (APT protocol, issue 26, p. 30)
TRACE_LENGTH = 2000
SIMULATED = "sim.emulators"  # package with pyserial's handler for sim://

_FAILURES = (serial.SerialException, OSError, TermiosError)


class Chunk(NamedTuple):
    """Bytes that went over the wire together."""

    time_s: float
    sent: bool
    data: bytes


class Port:
    """An open serial port with deadlines and a trace.

    Parameters
    ----------
    url : str
        What pyserial opens.
    baud : int
        Symbols per second; 8 data bits, no parity, 1 stop bit.
    clock : Clock
        Clock of every deadline.
    hold_dtr : bool
        Keep DTR low on opening; boards that reset on DTR would forget their position.
    flow_control : bool
        RTS/CTS, and after opening buffers that are emptied with a dwell before and behind it.

    Raises
    ------
    PortUnavailable
        The port cannot be opened; the message names the cure.
    """

    def __init__(
        self,
        url: str,
        baud: int,
        *,
        clock: Clock = SYSTEM_CLOCK,
        hold_dtr: bool = False,
        flow_control: bool = False,
    ) -> None:
        self.url, self.baud = url, baud
        self.clock = clock
        self.trace: deque[Chunk] = deque(maxlen=TRACE_LENGTH)
        self._file: RecordedFile | None = None
        self._said: Dialogue | None = None
        self._lost = False
        self._cable = _Cable(self)
        self._write_lock = threading.Lock()
        if url.startswith("sim://") and SIMULATED not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(SIMULATED)
        try:
            self._serial = serial.serial_for_url(
                url,
                baud,
                timeout=PORT_POLL_S,
                write_timeout=WRITE_TIMEOUT_S,
                exclusive=True,
                do_not_open=True,
                rtscts=flow_control,
            )
            if hold_dtr:
                self._serial.dtr = False
            self._serial.open()
            if flow_control:
                self._purge()
        except (*_FAILURES, ValueError) as error:
            raise PortUnavailable(_why_not(url, error)) from error
        self._record()

    @property
    def is_lost(self) -> bool:
        """True once the device behind the port has gone; open a new port then."""
        return self._lost

    def write(self, data: bytes) -> None:
        """Send bytes, whole, from any thread.

        Raises
        ------
        DeviceLost
            The port is dead or takes no bytes.
        """
        with self._write_lock, self._cable:
            if self._said is not None:
                self._said.record_sent(data)  # first, so that no answer is recorded before its question
            self._serial.write(data)
        self.trace.append(Chunk(self.clock.now_s(), True, data))

    def read(self, deadline_s: float) -> bytes:
        """Wait for at least one byte and return all that have arrived.

        Parameters
        ----------
        deadline_s : float
            Time on `clock` after which to give up.

        Raises
        ------
        NoReply
            Nothing came before the deadline.
        DeviceLost
            The port is dead.
        """
        while True:
            with self._cable:
                data: bytes = self._serial.read(1)
                if data and (waiting := self._serial.in_waiting):
                    data += self._serial.read(waiting)
            if data:
                self._came(data)
                return data
            if self.clock.now_s() >= deadline_s:
                raise NoReply(f"{self.url} at {self.baud} baud: no answer in time")

    def pending(self) -> bytes:
        """Return what has arrived already, without waiting."""
        with self._cable:
            waiting = self._serial.in_waiting
            data: bytes = self._serial.read(waiting) if waiting else b""
        if data:
            self._came(data)
        return data

    def drain(self, quiet_s: float, limit_s: float = 5.0) -> bytes:
        """Swallow input until nothing has come for `quiet_s`, at most for `limit_s`; return what it was."""
        swallowed = b""
        end_s = self.clock.now_s() + limit_s
        while self.clock.now_s() < end_s:
            try:
                swallowed += self.read(self.clock.now_s() + quiet_s)
            except NoReply:
                break
        return swallowed

    def heard(self) -> bytes:
        """Bytes that were received, as far as they are kept; for messages."""
        return b"".join(chunk.data for chunk in self.trace if not chunk.sent)

    def close(self) -> None:
        """Close; safe at any time, on a dead port too."""
        try:
            self._serial.close()
        except _FAILURES:
            self._lost = True
        if self._file is not None:
            self._file.close()

    def _record(self) -> None:
        """Keep what is said from now on, if that is wanted."""
        try:
            self._file = recording_file(self.url)
        except PortUnavailable:
            self.close()
            raise
        if self._file is not None:
            self._said = Dialogue(self._file.line, self.clock)
            self._said.record_opening(self.baud)

    def _came(self, data: bytes) -> None:
        """Note what has come."""
        self.trace.append(Chunk(self.clock.now_s(), False, data))
        if self._said is not None:
            self._said.came(data)

    def _purge(self) -> None:
        """Set RTS, and empty what the adapter holds of an earlier program."""
        with suppress(*_FAILURES):  # not every port has the line
            self._serial.rts = True
        self.clock.sleep_s(DWELL_S)
        self._serial.reset_input_buffer()
        self._serial.reset_output_buffer()
        self.clock.sleep_s(DWELL_S)


class _Cable:
    """Context of every access to a port; a class, because a bench enters it thousands of times a minute."""

    def __init__(self, port: Port) -> None:
        self._port = port

    def __enter__(self) -> None:
        if self._port._lost:
            raise DeviceLost(f"{self._port.url} is gone; plug it in, open it again and home its axes")

    def __exit__(self, kind: object, error: BaseException | None, where: object) -> None:
        # TypeError: closed by another thread in the middle of a read
        if isinstance(error, (*_FAILURES, TypeError)):
            self._port._lost = True
            raise DeviceLost(
                f"{self._port.url} was lost ({error}); plug it in, open it again and home its axes"
            ) from error


class ModemLine:
    """One input line of a serial port, as a switch between it and an output line that is high.

    RTS and DTR are held high: a contact between one of them and the input closes the circuit.

    Parameters
    ----------
    url : str
        What pyserial opens; nothing is written to it.
    line : {"cts", "dsr", "cd", "ri"}
        The input.

    Raises
    ------
    PortUnavailable
        The port cannot be opened, or has no such lines.
    """

    def __init__(self, url: str, line: str) -> None:
        self._line = line
        try:
            self._serial = serial.serial_for_url(url, exclusive=True)
            self._serial.rts = self._serial.dtr = True
            self.is_closed()
        except (*_FAILURES, ValueError) as error:
            if getattr(error, "errno", None) in (errno.ENOTTY, errno.EINVAL):
                raise PortUnavailable(f"{url} has no line {line.upper()} that could be read") from error
            raise PortUnavailable(_why_not(url, error)) from error

    def is_closed(self) -> bool:
        """Return whether the line is high."""
        return bool(getattr(self._serial, self._line))

    def close(self) -> None:
        """Close; safe on a dead port too."""
        with suppress(*_FAILURES):
            self._serial.close()


def _why_not(url: str, error: Exception) -> str:
    code = getattr(error, "errno", None)
    if code in (errno.EAGAIN, errno.EBUSY) or "lock port" in str(error):
        return f"{url} is in use by another process; close it there first"
    if code == errno.ENOENT:
        return f"{url} does not exist; is the controller plugged in and switched on?"
    if code == errno.EACCES:
        return f"{url} may not be opened by this user; add the user to the group that owns it (often dialout)"
    return f"{url} cannot be opened: {error}"
