"""Faults of cables and converters, on a schedule.

A fault waits for the n-th answer of a controller (counted from 0 on the line) or, for ``unplug``, for a moment.
A wire keeps its order: behind a late answer everything is late.

==========  =================================================================
late        the answer comes `delay_s` later
lost        the answer does not come
cut         only its first half comes
doubled     it comes twice
garbled     one of its bytes is another
split       its second half comes `delay_s` after the first
unplug      the line dies; nothing comes any more, not even silence
==========  =================================================================
"""

import random
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Kind = Literal["late", "lost", "cut", "doubled", "garbled", "split", "unplug"]
KINDS: tuple[Kind, ...] = ("late", "lost", "cut", "doubled", "garbled", "split", "unplug")


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Parameters
    ----------
    kind : str
        See the module's text.
    answer : int, optional
        Which answer it meets.
    time_s : float, optional
        For ``unplug``: when, on the clock of the world.
    delay_s : float
        For ``late`` and ``split``.
    """

    kind: Kind
    answer: int | None = None
    time_s: float | None = None
    delay_s: float = 0.0


class FaultSchedule:
    """Applies faults to the answers of one line.

    Parameters
    ----------
    faults : iterable of Fault
        At most one per answer; later ones win.
    seed : int
        Chooses the damaged bytes.
    """

    def __init__(self, faults: Iterable[Fault] = (), seed: int = 0) -> None:
        faults = tuple(faults)
        self._by_answer = {fault.answer: fault for fault in faults if fault.answer is not None}
        self.unplug_s = min(
            (f.time_s for f in faults if f.kind == "unplug" and f.time_s is not None), default=None
        )
        self._random = random.Random(seed)
        self._count = 0
        self._busy_until_s = 0.0
        self.met: list[Fault] = []
        self.unplugged = False
        self._is_mute = False

    def dead(self, now_s: float) -> bool:
        """True once the line has been unplugged."""
        if self.unplug_s is not None and now_s >= self.unplug_s:
            self.unplugged = True
        return self.unplugged

    def strike(self, fault: Fault, times: int = 1) -> None:
        """Let the next answers meet a fault."""
        self._by_answer.update(dict.fromkeys(range(self._count, self._count + times), fault))

    def mute(self) -> None:
        """Let no answer come any more, though the line lives."""
        self._is_mute = True

    def pass_on(self, time_s: float, data: bytes) -> list[tuple[float, bytes]]:
        """Return when an answer comes and what is left of it, in one piece or two."""
        fault = self._by_answer.get(self._count)
        self._count += 1
        if self._is_mute:
            return []
        if fault is None:
            return [(self._after(time_s), data)]
        self.met.append(fault)
        if fault.kind == "split":
            half = len(data) // 2
            first_s = self._after(time_s)
            return [(first_s, data[:half]), (self._after(first_s + fault.delay_s), data[half:])]
        return [(self._after(time_s + fault.delay_s), self._damage(fault.kind, data))]

    def _after(self, time_s: float) -> float:
        """That moment, or the end of what comes before."""
        self._busy_until_s = max(self._busy_until_s, time_s)
        return self._busy_until_s

    def _damage(self, kind: Kind, data: bytes) -> bytes:
        if kind == "lost":
            return b""
        if kind == "cut":
            return data[: len(data) // 2]
        if kind == "doubled":
            return data + data
        if kind == "garbled" and data:
            place = self._random.randrange(len(data))
            other = self._random.choice([byte for byte in range(32, 127) if byte != data[place]])
            return data[:place] + bytes([other]) + data[place + 1 :]
        if kind == "unplug":
            self.unplugged = True
            return b""
        return data
