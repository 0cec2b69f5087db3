"""Common part of line-based protocols: from bytes to lines to messages."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Generic, TypeVar

from stages.errors import ProtocolViolation

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class TextLine:
    """A message that is its own text, on a line that ends with CR LF; base of those that have a name."""

    text: str

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"{self.text}\r\n".encode("ascii")


class Lines:
    """Cuts chunks of any size into lines.

    Parameters
    ----------
    ends : bytes
        Every byte that ends a line; empty lines are dropped, so CR LF needs no care.
    longest : int
        Length after which unfinished input is thrown away: a peer that never ends a line must not fill memory.
    """

    def __init__(self, ends: bytes, longest: int = 512) -> None:
        self._cut = _ends_of(ends)
        self._longest = longest
        self._rest = bytearray()

    @property
    def rest(self) -> bytes:
        """The unfinished line."""
        return bytes(self._rest)

    def forget(self) -> None:
        """Drop the bytes of a line that is not complete."""
        self._rest.clear()

    def fitting(self, chunk: bytes) -> Sequence[bytes]:
        """Part a chunk so that a line without an end is noticed at the byte that is too many."""
        if len(self._rest) + len(chunk) <= self._longest:
            return (chunk,)
        return [chunk[place : place + 1] for place in range(len(chunk))]

    def feed(self, chunk: bytes) -> list[bytes]:
        """Add bytes; return the lines that are complete now, without their ends.

        Raises
        ------
        ProtocolViolation
            A line grew past the limit; everything unfinished is dropped.
        """
        *whole, rest = self._cut.split(chunk)
        lines = []
        for part in whole:
            self._rest += part
            if self._rest:
                lines.append(bytes(self._rest))
                self._rest.clear()
        self._rest += rest
        if len(self._rest) > self._longest:
            raw = bytes(self._rest[:60])
            self._rest.clear()
            raise ProtocolViolation("a line has no end", raw)
        return lines


class LineStream(Generic[T]):
    """Bytes to messages: a line at a time, a violation in place of each that cannot be read.

    Parameters
    ----------
    read : callable
        Reads one line, without its end; raises ProtocolViolation.
    ends : bytes
        See `Lines`.
    longest : int
        See `Lines`.
    singles : mapping of int to message, optional
        Bytes that are a message of their own, wherever they stand.
    """

    def __init__(
        self,
        read: Callable[[bytes], T],
        ends: bytes = b"\r\n",
        longest: int = 512,
        singles: Mapping[int, T] | None = None,
    ) -> None:
        self._read = read
        self._lines = Lines(ends, longest)
        self._singles = singles or {}
        self._parts = _parts_of(bytes(self._singles))

    @property
    def rest(self) -> bytes:
        """Bytes of a line that is not complete."""
        return self._lines.rest

    def feed(self, chunk: bytes) -> list[T | ProtocolViolation]:
        """Add bytes; return what is complete now."""
        found: list[T | ProtocolViolation] = []
        for part in self._parts.split(chunk) if self._singles else (chunk,):
            if part and part[0] in self._singles:
                found.append(self._singles[part[0]])
                continue
            for piece in self._lines.fitting(part):
                try:
                    lines = self._lines.feed(piece)
                except ProtocolViolation as violation:
                    found.append(violation)
                    continue
                for line in lines:
                    try:
                        found.append(self._read(line))
                    except ProtocolViolation as violation:
                        found.append(violation)
        return found


def text_of(raw: bytes) -> str:
    """Text of a line; printable ASCII only.

    Raises
    ------
    ProtocolViolation
        The line holds other bytes.
    """
    if not raw.isascii() or not (text := raw.decode("ascii")).isprintable():
        raise ProtocolViolation("a line holds bytes that are not text", raw)
    return text


@cache
def _ends_of(ends: bytes) -> re.Pattern[bytes]:
    """Pattern that cuts a chunk into lines; each answer has a decoder of its own, all share the same patterns."""
    return re.compile(b"[" + re.escape(ends) + b"]")


@cache
def _parts_of(singles: bytes) -> re.Pattern[bytes]:
    """Pattern that cuts a chunk before and behind bytes that are whole messages, which it keeps."""
    return re.compile(b"([" + re.escape(singles) + b"])" if singles else b"")
