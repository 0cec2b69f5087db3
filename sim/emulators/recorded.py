"""A box that is only a recorded dialogue: what somebody's box has once answered, it answers again.

    @ 115200                rate from here on
    > 2f 0a                 the host has sent this
    < 40 30 31 ..           this came, until it was quiet

It is what `rtpiv probe` writes.  What is sent in another order than recorded, or at another rate, is not answered.
"""

from collections.abc import Iterator
from pathlib import Path

from sim.emulators.device import Clock, Emulator


class RecordedBox(Emulator):
    """One box, as far as it was asked.

    Parameters
    ----------
    path : Path
        The dialogue.
    clock : Clock
        Time of the world.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        super().__init__({}, clock)
        self._words = list(_words_of(path))
        self._next = 0
        self._skip_rates()

    def _take(self, data: bytes) -> None:
        kind, wanted = self._words[self._next] if self._next < len(self._words) else ("", b"")
        if kind != ">" or data != wanted:
            return
        self._next += 1
        self._skip_rates()

    def _skip_rates(self) -> None:
        """Say what was said next, and go on to the next question."""
        while self._next < len(self._words) and self._words[self._next][0] != ">":
            kind, data = self._words[self._next]
            if kind == "<":
                self.say(data)
            self._next += 1


def _words_of(path: Path) -> Iterator[tuple[str, bytes]]:
    for line in path.read_text(encoding="utf-8").splitlines():
        kind, _, rest = line.partition(" ")
        if kind in ("<", ">"):
            yield kind, bytes.fromhex(rest)
        elif kind == "@":
            yield kind, b""
