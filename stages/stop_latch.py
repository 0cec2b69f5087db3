"""The one stop of a bench: pressed from anywhere at any moment, it holds until a person clears it.

Two things may end what moves. A **halt** ends every motion that has begun, and no more: it is what the bench does
to itself when one axis fails, or what a scan engine asks for between two runs. A **stop** is a person's: it ends
every motion AND nothing moves, homes or is exposed any more until `clear`.

A caller that moves something takes a token before its first byte (`begin`) and shows it before every further one
(`check`): every leg, settling, retry, approach, homing and exposure. A token from before the last halt or stop is
no longer good, so a motion of several parts ends as a whole.

Between the look at the latch and the write of a byte that moves, a stop must not slip in: it would be followed by
the motion that it was to prevent. So both happen inside `gate`, and a stop that has been noted passes through the
same gate before its own bytes are written. The gate is held only for the time of a write, never for an answer; a
write that hangs holds a stop up for `GATE_S` at most.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from stages.errors import MotionStopped

GATE_S = 0.05


class StopLatch:
    """Shared by everything on a bench that moves or exposes; safe for several threads."""

    def __init__(self) -> None:
        self._count = 0
        self._held = False
        self._why = ""
        self._gate = threading.RLock()

    @property
    def is_held(self) -> bool:
        """True if a stop holds the bench."""
        return self._held

    @property
    def count(self) -> int:
        """Number of halts and stops so far."""
        return self._count

    def stop(self, why: str = "stopped on request") -> None:
        """End everything that has begun, and hold the bench until `clear`."""
        if not self._held:
            self._why = why
        self._held = True
        self.halt()

    def halt(self) -> None:
        """End everything that has begun; what begins later may move."""
        self._count += 1
        if self._gate.acquire(
            timeout=GATE_S
        ):  # a byte that moves and is being written now comes before the stop's
            self._gate.release()

    def clear(self) -> None:
        """Let the bench move again: a person has looked at it."""
        self._held = False

    def begin(self) -> int:
        """Return the token of a new motion.

        Raises
        ------
        MotionStopped
            A stop holds the bench.
        """
        if self._held:
            raise MotionStopped(f"the bench is held ({self._why}); look at it, then clear the stop")
        return self._count

    def check(self, token: int) -> None:
        """Raise if a motion may not go on.

        Raises
        ------
        MotionStopped
            There was a halt or a stop since it began.
        """
        if self._held:
            raise MotionStopped(f"{self._why}; look at the bench, then clear the stop")
        if self._count != token:
            raise MotionStopped("halted: another part of the bench has failed or requested it")

    @contextmanager
    def gate(self, token: int) -> Iterator[None]:
        """Hold the gate for the write of bytes that move; raises as `check` does."""
        with self._gate:
            self.check(token)
            yield
