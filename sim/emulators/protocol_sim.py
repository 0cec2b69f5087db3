"""pyserial's handler for ``sim://NAME``: the line of that name, in this process, without a device file.

pyserial finds this module by its own rule (``protocol_<scheme>`` in a listed package) when such a URL is
opened. Lines are put up by name in `LINES`. On a `VirtualClock` a read that finds nothing lets time pass
instead of waiting.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import serial
from typing_extensions import Buffer

from sim.emulators.line import Line
from sim.mechanics.clock import VirtualClock

LINES: dict[str, Line] = {}


@contextmanager
def put_up(line: Line, name: str = "line") -> Iterator[str]:
    """Yield the URL of a line while the block runs; errors and recordings show the name in it."""
    address = f"{name}-{id(line):x}"
    LINES[address] = line
    try:
        yield f"sim://{address}"
    finally:
        LINES.pop(address)


class SimSerial(serial.SerialBase):
    """One end of a simulated line with the manners of a serial port."""

    _line: Line | None = None
    _rest = b""

    def open(self) -> None:
        """Claim the line.

        Raises
        ------
        serial.SerialException
            There is no line of that name, it is unplugged, or it is open elsewhere.
        """
        name = str(self.port).removeprefix("sim://")
        line = LINES.get(name)
        if line is None:
            raise serial.SerialException(2, f"there is no simulated line {name!r}")
        if line.dead:
            raise serial.SerialException(2, f"simulated line {name!r} is unplugged")
        with line.lock:
            if line.is_opened:
                raise serial.SerialException(11, f"simulated line {name!r} is open elsewhere")
            line.open(self)
        self._line, self._rest, self.is_open = line, b"", True  # the rest of an earlier owner is not ours

    def close(self) -> None:
        """Give the line back."""
        if self.is_open and self._line is not None:
            self._line.close(self)
        self.is_open = False

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read now."""
        line = self._alive()
        if self._rest:
            return len(self._rest)
        came = line.receive()
        self._rest += came if line.baud in (None, self.baudrate) else _misread(came)
        return len(self._rest)

    def read(self, size: int = 1) -> bytes:
        """Return what is there, waiting up to the timeout for the first byte."""
        if not self._rest and not self.in_waiting and self.timeout:
            self._wait(self.timeout)
        data, self._rest = self._rest[:size], self._rest[size:]
        return data

    def _wait(self, timeout_s: float) -> None:
        """Let time pass until something has come."""
        line = self._alive()
        clock = line.clock
        end_s = clock.now_s() + timeout_s
        while clock.now_s() < end_s:
            if isinstance(clock, VirtualClock):
                next_s = line.next_s()
                clock.advance_to(end_s if next_s is None else min(end_s, next_s))
            else:
                time.sleep(0.0005)
            if self.in_waiting:
                return

    def write(self, data: Buffer) -> int:
        """Send everything."""
        sent, line = bytes(data), self._alive()
        line.send(sent if line.baud in (None, self.baudrate) else _misread(sent))
        return len(sent)

    def reset_input_buffer(self) -> None:
        """Forget what has arrived."""
        self._alive().receive()
        self._rest = b""

    def reset_output_buffer(self) -> None:
        """Nothing waits to be sent."""

    def _alive(self) -> Line:
        line = self._line
        if not self.is_open or line is None:
            raise serial.PortNotOpenError()
        if line.owner is not self or line.dead or line.opened_with != line.plugged:
            raise serial.SerialException("device reports readiness to read but returned no data")
        return line

    def _reconfigure_port(self) -> None:
        """A rate matters only to a box that has one; see `_misread`."""

    def _update_dtr_state(self) -> None:
        """Nor modem lines."""

    def _update_rts_state(self) -> None:
        """Same."""


def _misread(data: bytes) -> bytes:
    """Bytes read at a wrong rate: as many others, some of which are no text."""
    return bytes(0xFF & ~(7 * byte + 0x1D) for byte in data)


def serial_class_for_url(url: str) -> tuple[str, type[SimSerial]]:
    """Class and URL that pyserial asks a handler for."""
    return url, SimSerial
