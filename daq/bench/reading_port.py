"""A reading by a serial line: a box that is asked, or one that streams lines.

What lies in the buffers is thrown away first, so that what is read was said now: behind a question the next line,
of a stream the first line that begins behind it.  Nothing believes the box a length: LONGEST bytes without the end
of a line are no line.
"""

import re
from contextlib import suppress
from datetime import UTC, datetime

from daq.bench.reading import Reading, ReadingSection, missing, reading_of
from stages.clock import Clock
from stages.errors import StageError
from stages.port import Port

LONGEST = 1000  # bytes of a line
MOST = 65_536  # bytes that are thrown away first, should a line be faster than they are read
FIELDS = re.compile(r"[;,\s]+")


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
            self._opened()

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
        self._port = None

    def reading(self) -> Reading:
        """Return what the box says now."""
        section = self._section
        try:
            line = self._line(self._opened())
        except StageError as error:
            if self._port is not None and self._port.lost:
                self.close()
            return missing(section, str(error)[:200])
        if line is None:
            return missing(section, f"{section.port} sends {LONGEST} bytes without the end of a line")
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

    def _opened(self) -> Port:
        if self._port is None:
            assert self._section.port is not None
            self._port = Port(self._section.port, self._section.baud, clock=self._clock)
        return self._port

    def _line(self, port: Port) -> str | None:
        """Next whole line, without its end; None if there is no end to it.  NoReply if none comes in time."""
        thrown = 0
        while thrown < MOST and (old := port.pending()):
            thrown += len(old)
        deadline_s = self._clock.now_s() + self._section.wait_s
        if self._section.ask:
            port.write(self._section.ask.encode("utf-8"))
        heard, skip = b"", not self._section.ask  # a stream is met in the middle of a line
        while len(heard) < LONGEST:
            heard += port.read(deadline_s)
            *lines, heard = heard.replace(b"\r", b"\n").split(b"\n")
            for line in lines:
                if skip:
                    skip = False
                elif line.strip():
                    return line[:LONGEST].decode("utf-8", "replace")
        return None
