"""A reading from a file to which another program adds rows: time, value, and whatever else it likes.

The newest whole row counts.  Its first column is its time: seconds since 1970, or a date as 2026-11-27T14:03:05
(with a zone, or in that of this computer).  A row that has no end yet is still being written.
"""

from datetime import UTC, datetime
from pathlib import Path

from daq.bench.reading import COLUMN, Reading, ReadingSection, missing, reading_of
from ground.plain_file import open_plain

TAIL_BYTES = 65_536
SEPARATORS = (";", "\t", ",")


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
            return missing(section, f"{self._path.name}: {fields[0][:40]!r} is no time")
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
