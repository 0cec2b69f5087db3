"""Actions that wait for a place in the traffic of a line: what goes wrong does so between two bytes.

============  ===========================================================================
write         before the n-th write of the host from now reaches the box
byte          as soon as n more bytes of the host have reached the box
answer        before the n-th answer of the box from now leaves it
answer byte   as soon as n more bytes of the box have reached the host
============  ===========================================================================

What happens to the world (power, plugs, buttons) happens at that very moment, in the middle of a command if it
must be. What **another thread of the host** does cannot: it waits for the locks that the present one holds. So
`press` puts an action off until the host next looks for input, and further while `is_kept_out` says that the
present thread holds what the other would wait for. Thereby a race of two threads runs in one, the same way every
time.
"""

from collections.abc import Callable
from typing import Literal

Counted = Literal["write", "byte", "answer", "answer byte"]
Action = Callable[[], object]


class Hooks:
    """Counts what passes on one line and calls what waits for a count."""

    def __init__(self) -> None:
        self.passed: dict[Counted, int] = {"write": 0, "byte": 0, "answer": 0, "answer byte": 0}
        self._waiting: list[tuple[Counted, int, Action]] = []
        self._pressed: list[tuple[Action, Callable[[], bool]]] = []

    def after(self, number: int, what: Counted, action: Action) -> None:
        """Do something to the world after so many more of something; see the table."""
        self._waiting.append((what, self.passed[what] + number, action))

    def press(self, number: int, what: Counted, action: Action, is_kept_out: Callable[[], bool]) -> None:
        """Do what another thread of the host would do at that moment, or as soon as it could."""
        self.after(number, what, lambda: self._pressed.append((action, is_kept_out)))

    def clear(self) -> None:
        """Forget everything that waits."""
        self._waiting.clear()
        self._pressed.clear()

    def count(self, what: Counted, number: int = 1) -> None:
        """Note what has passed, and act."""
        self.passed[what] += number
        if self._waiting:
            due = [hook for hook in self._waiting if hook[0] == what and hook[1] <= self.passed[what]]
            self._waiting = [hook for hook in self._waiting if hook not in due]
            for _, _, action in due:
                action()

    def cut(self, what: Counted, data: bytes) -> tuple[bytes, bytes]:
        """Part data where the next action waits."""
        if not self._waiting:
            return data, b""
        places = (number - self.passed[what] for kind, number, _ in self._waiting if kind == what)
        place = min((place for place in places if place > 0), default=len(data))
        return data[:place], data[place:]

    def let_in(self) -> None:
        """Let other threads of the host do what they wait for; to be called without any lock."""
        while self._pressed and not self._pressed[0][1]():
            self._pressed.pop(0)[0]()
