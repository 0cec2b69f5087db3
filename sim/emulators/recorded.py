"""A box that answers from a recording: what a real box has once answered, it answers again, as late.

The bytes sent to it must be those recorded, in order, byte for byte; the first byte that is another ends the
conversation, with both in the sentence and the line of the file (`SaidOtherwise`).  At which rate the port is
open does not matter.  A recording is `stages.dialogue`.

Words alone move nothing.  So behind the recording stands an emulator of the same driver, which hears what the box
hears and moves the motors of the world as it would; its own answers are dropped.
"""

from pathlib import Path
from typing import NoReturn

from sim.emulators.device import Clock, Emulator, Purpose
from stages.dialogue import read_dialogue
from stages.errors import DeviceLost

SHOWN = 60  # bytes in a sentence


class SaidOtherwise(DeviceLost):
    """A box of a recording received other bytes than were recorded; it answers no more."""


class RecordedBox(Emulator):
    """One box, as far as it was recorded.

    Parameters
    ----------
    path : Path
        The recording.
    clock : Clock
        Time of the world.
    obeys : Emulator, optional
        What moves the world's motors by the same words.

    Raises
    ------
    ConfigError
        The recording cannot be read.
    """

    def __init__(self, path: Path, clock: Clock, obeys: Emulator | None = None) -> None:
        super().__init__({}, clock)
        self.path, self._obeys = path, obeys
        self._words = read_dialogue(path)
        self._next = 0
        self._heard = b""  # of a word that is not whole yet
        self._differs = ""
        self._answer()

    @property
    def differs(self) -> str:
        """First difference from the recording so far, or what is still missing; "" if nothing."""
        left = [word for word in self._words[self._next :] if word.by == ">"]
        if self._differs or not left:
            return self._differs
        more = f" and {len(left) - 1} more words" if len(left) > 1 else ""
        return f"{self.path}:{left[0].line}: {_quote(left[0].data)} was recorded{more}, and has not been said"

    def advance(self) -> None:
        """Let the motors catch up with the clock."""
        if self._obeys is not None:
            self._obeys.advance()
            self._obeys.take_answers()
        super().advance()

    @property
    def next_s(self) -> float | None:
        """Next moment at which firmware acts by itself, as far as is known."""
        moments = (super().next_s, None if self._obeys is None else self._obeys.next_s)
        return min((moment for moment in moments if moment is not None), default=None)

    def switch_off(self) -> None:
        """Power fails."""
        super().switch_off()
        if self._obeys is not None:
            self._obeys.switch_off()

    def switch_on(self) -> None:
        """Power is back."""
        super().switch_on()
        if self._obeys is not None:
            self._obeys.switch_on()

    def person_stops(self) -> None:
        """Stop what moves, as a person does."""
        if self._obeys is not None:
            self._obeys.person_stops()

    def purpose(self, channel: str) -> Purpose:
        """Purpose of the present motion of a motor."""
        return "move" if self._obeys is None else self._obeys.purpose(channel)

    def _take(self, data: bytes) -> None:
        if self._obeys is not None:
            self._obeys.feed(data)  # a stop is heard, whatever is recorded
        if self._differs:
            raise SaidOtherwise(self._differs)
        self._heard += data
        while self._heard:
            if self._next == len(self._words):
                self._end(f"{self.path}: {_quote(self._heard)} was said behind the end of the recording")
            word = self._words[self._next]
            if word.data != self._heard and word.data.startswith(self._heard):
                return  # the rest is on its way
            if not self._heard.startswith(word.data):
                said = f"{_quote(self._heard)} was said, {_quote(word.data)} was recorded"
                self._end(f"{self.path}:{word.line}: {said}")
            self._heard = self._heard[len(word.data) :]
            self._next += 1
            self._answer()

    def _answer(self) -> None:
        """Answer what was answered next, and go on to the next word of the host."""
        while self._next < len(self._words) and self._words[self._next].by == "<":
            word = self._words[self._next]
            self.say(word.data, self.event_s + word.after_s)
            self._next += 1

    def _end(self, why: str) -> NoReturn:
        self._differs = f"{why}; say what was recorded, or record anew"
        raise SaidOtherwise(self._differs)


def _quote(data: bytes) -> str:
    """Bytes for a sentence."""
    text = data.decode("latin-1") if data.isascii() else data.hex(" ")
    return repr(text if len(text) <= SHOWN else f"{text[:SHOWN]}..")
