"""Sources of readings: a file to which another program adds rows, or a device on a serial line.

**File**: time, value, and whatever else it likes.  The newest whole row counts.  Its first column is its time:
seconds since 1970, or a date as 2026-11-27T14:03:05 (with a zone, or in that of this computer).  A row that has no
end yet is still being written.

**Port**: a box that is asked, or one that streams lines.  What lies in the buffers is thrown away first, so that
what is read was said now: behind a question the next line, of a stream the first line that begins behind it.
Nothing believes the box a length: MAX_LINE_BYTES bytes without the end of a line are no line.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from daq.bench.reading import Gauge, Reading, ReadingSection, missing, reading_of
from ground.plain_file import open_plain
from stages.clock import Clock
from stages.errors import StageError
from stages.port import Port

if TYPE_CHECKING:
    from daq.bench.bench_table import Bench

COLUMN = 2  # of a file; the first is the time
TAIL_BYTES = 65_536
SEPARATORS = (";", "\t", ",")
MAX_LINE_BYTES = 1000  # bytes of a line
MAX_DISCARDED_BYTES = 65_536  # bytes that are thrown away first, should a line be faster than they are read
FIELDS = re.compile(r"[;,\s]+")


class ReadingKind:
    """A device of kind `reading`."""

    section = ReadingSection
    simulator = "sim.devices:simulate_reading"

    @contextmanager
    def open(self, section: ReadingSection, bench: "Bench", clock: Clock) -> Iterator[Gauge]:
        """Open it; what is not there is missing from the readings."""
        if section.file is not None:
            yield FileGauge(section, bench.path.parent / section.file)
            return
        gauge = PortGauge(section, clock)
        try:
            yield gauge
        finally:
            gauge.close()

    def places(self, section: ReadingSection) -> Iterator[str]:
        """File or port."""
        yield f"reading: {section.file or section.port}"


class FileGauge:
    """The newest row of a file.

    Parameters
    ----------
    section : ReadingSection
        What the bench file says.
    path : Path
        The file.
    """

    def __init__(self, section: ReadingSection, path: Path) -> None:
        self._section, self._path = section, path

    def reading(self) -> Reading:
        """Return the value of the newest row; missing if it is too old, or none can be read."""
        section = self._section
        try:
            row = self._newest_row()
        except OSError as error:
            return missing(section, f"{self._path.name}: {error.strerror or error}")
        separator = next((mark for mark in SEPARATORS if mark in row), ",")
        fields = [field.strip().strip('"') for field in row.split(separator)]
        column = section.column or COLUMN
        if len(fields) < column:
            return missing(section, f"{self._path.name} has no row with {column} columns at its end")
        when = _time_of(fields[0])
        if when is None:
            return missing(section, f"{self._path.name}: {fields[0][:40]!r} is not a time")
        age_s = (datetime.now(UTC) - when).total_seconds()
        if abs(age_s) > section.oldest_s:
            way = "old" if age_s > 0.0 else "in the future"
            return missing(section, f"the newest row of {self._path.name} is {abs(age_s):.0f} s {way}")
        return reading_of(section, fields[column - 1], when)

    def _newest_row(self) -> str:
        with open_plain(self._path) as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - TAIL_BYTES))
            tail: bytes = file.read(TAIL_BYTES)
        whole, _, _ = tail.rpartition(b"\n")
        rows = [row for row in whole.decode("utf-8", "replace").splitlines() if row.strip()]
        return rows[-1] if rows else ""


def _time_of(text: str) -> datetime | None:
    try:
        return datetime.fromtimestamp(float(text), UTC)
    except (ValueError, OverflowError, OSError):
        pass
    try:
        return datetime.fromisoformat(text).astimezone(UTC)
    except (ValueError, OverflowError, OSError):
        return None


class PortGauge:
    """A box on a serial line; one that is not there is looked for again at every reading.

    Parameters
    ----------
    section : ReadingSection
        What the bench file says.
    clock : Clock
        Of the time that it is given.
    """

    def __init__(self, section: ReadingSection, clock: Clock) -> None:
        self._section, self._clock = section, clock
        self._port: Port | None = None
        with suppress(StageError):
            self._open_port()

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
        self._port = None

    def reading(self) -> Reading:
        """Return what the box says now."""
        section = self._section
        try:
            line = self._line(self._open_port())
        except StageError as error:
            if self._port is not None and self._port.is_lost:
                self.close()
            return missing(section, str(error)[:200])
        if line is None:
            return missing(section, f"{section.port} sends {MAX_LINE_BYTES} bytes without the end of a line")
        when = datetime.now(UTC)
        if section.column is not None:
            fields = [field for field in FIELDS.split(line) if field]
            if len(fields) < section.column:
                return missing(section, f"{line[:40]!r} has no column {section.column}")
            return reading_of(section, fields[section.column - 1], when)
        found = re.search(section.find, line)
        if found is None or found[1] is None:
            return missing(section, f"{line[:40]!r} is not what find looks for")
        return reading_of(section, found[1], when)

    def _open_port(self) -> Port:
        if self._port is None:
            assert self._section.port is not None
            self._port = Port(self._section.port, self._section.baud, clock=self._clock)
        return self._port

    def _line(self, port: Port) -> str | None:
        """Next whole line, without its end; None if there is no end to it.  NoReply if none comes in time."""
        thrown = 0
        while thrown < MAX_DISCARDED_BYTES and (old := port.pending()):
            thrown += len(old)
        deadline_s = self._clock.now_s() + self._section.wait_s
        if self._section.ask:
            port.write(self._section.ask.encode("utf-8"))
        heard, skip = b"", not self._section.ask  # a stream is met in the middle of a line
        while len(heard) < MAX_LINE_BYTES:
            heard += port.read(deadline_s)
            *lines, heard = heard.replace(b"\r", b"\n").split(b"\n")
            for line in lines:
                if skip:
                    skip = False
                elif line.strip():
                    return line[:MAX_LINE_BYTES].decode("utf-8", "replace")
        return None
