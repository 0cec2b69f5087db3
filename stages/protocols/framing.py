"""What line-based grammars share: cutting a byte stream into lines, and the shape of a documented example."""

from typing import NamedTuple, Protocol

from stages.errors import ProtocolViolation


class Message(Protocol):
    """Anything that goes over a wire."""

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        ...


class Example(NamedTuple):
    """A message as somebody else documented it: the bytes, what they mean, and where that is written."""

    raw: bytes
    message: Message
    source: str


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
        self._ends = frozenset(ends)
        self._longest = longest
        self._rest = bytearray()

    @property
    def rest(self) -> bytes:
        """The unfinished line."""
        return bytes(self._rest)

    def feed(self, chunk: bytes) -> list[bytes]:
        """Add bytes; return the lines that are complete now, without their ends.

        Raises
        ------
        ProtocolViolation
            A line grew past the limit; everything unfinished is dropped.
        """
        lines = []
        for byte in chunk:
            if byte not in self._ends:
                self._rest.append(byte)
            elif self._rest:
                lines.append(bytes(self._rest))
                self._rest.clear()
        if len(self._rest) > self._longest:
            raw = bytes(self._rest[:60])
            self._rest.clear()
            raise ProtocolViolation("a line has no end", raw)
        return lines


def text_of(raw: bytes) -> str:
    """Text of a line; printable ASCII only.

    Raises
    ------
    ProtocolViolation
        The line holds other bytes.
    """
    if any(byte < 0x20 or byte > 0x7E for byte in raw):
        raise ProtocolViolation("a line holds bytes that are not text", raw)
    return raw.decode("ascii")
