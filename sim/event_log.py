"""Events of a simulated world, and what was true then: for tests, not for the user of a run.

Each line of `world.jsonl` in the folder of a run, and each `Event` in Python, is one of these:

=========  =========================  =====================================================================
what       of                         said
=========  =========================  =====================================================================
step       the run                    its number, 1 first: what follows belongs to it
told       a box                      bytes that have reached it, as text (Latin-1)
exposed    a camera                   `number` of the exposure, `crc32` of its pixels, `true_mm` of every axis
light      a timing unit              `pulse` 0 or 1 of a pair; the time is when the light fell
fault      what it is of              `what` has happened to it, and `due` when
waiting    the same                   a fault whose moment has not come
violation  an axis or two things      a limit passed, too close, moved on after a stop, a false position reported
=========  =========================  =====================================================================

Times are seconds of the world's clock, 0 where the bench was opened.
"""

import json
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

from daq.errors import RunUsageError

FILE = "world.jsonl"
What = Literal["step", "told", "exposed", "light", "fault", "waiting", "violation"]


class Event(NamedTuple):
    """Something that has happened, and when [s]."""

    time_s: float
    what: What
    of: str
    said: Any

    def line(self) -> str:
        """As a line of JSON."""
        tree = {"s": round(self.time_s, 9), "what": self.what, "of": self.of, "said": self.said}
        return json.dumps(tree, sort_keys=True) + "\n"


class Kept:
    """Takes down what happens; from any thread."""

    def __init__(self) -> None:
        self._events: list[Event] = []
        self._lock = threading.Lock()

    def note(self, time_s: float, what: What, of: str, said: object) -> None:
        """Take down one event."""
        with self._lock:
            self._events.append(Event(time_s, what, of, said))

    def events(self) -> tuple[Event, ...]:
        """Everything so far."""
        with self._lock:
            return tuple(self._events)


@dataclass(frozen=True)
class EventLog:
    """Events of a simulated world, in order.

    Parameters
    ----------
    events : tuple of Event
        All of it.
    """

    events: tuple[Event, ...]

    def bytes_to(self, box: str) -> str:
        """Everything that has reached a box, as text."""
        return "".join(str(event.said) for event in self.events if event.what == "told" and event.of == box)

    def of_kind(self, what: What) -> list[Event]:
        """Events of one kind."""
        return [event for event in self.events if event.what == what]

    @property
    def faults(self) -> list[str]:
        """Faults that have struck, as "unplug of target at step 7"."""
        return [_of_fault(event) for event in self.of_kind("fault")]

    @property
    def waiting(self) -> list[str]:
        """Faults whose moment has not come, in the same words."""
        return [_of_fault(event) for event in self.of_kind("waiting")]

    @property
    def violations(self) -> list[str]:
        """Violations of the rules that the witness holds."""
        return [str(event.said) for event in self.of_kind("violation")]

    def text(self) -> str:
        """All of it as lines of JSON; the same seed gives the same bytes."""
        return "".join(event.line() for event in self.events)


def read_event_log(run: Path | str) -> EventLog:
    """Read what has happened in the world of a rehearsed run, all of its sessions.

    Parameters
    ----------
    run : path
        Folder of the run.

    Raises
    ------
    RunUsageError
        The run was no rehearsal, so nothing was kept.
    """
    path = Path(run) / FILE
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError:
        raise RunUsageError(
            f"{path} is not there: only a rehearsal keeps what happens; acquire the run with a seed or with faults"
        ) from None
    return EventLog(tuple(_events(lines)))


def _events(lines: Iterable[str]) -> Iterable[Event]:
    for line in lines:
        tree = json.loads(line)
        yield Event(tree["s"], tree["what"], tree["of"], tree["said"])


def _of_fault(event: Event) -> str:
    return f"{event.said['what']} of {event.of} at {event.said['due']}"


def in_words(events: Sequence[Event]) -> str:
    """Some events for a person, a line each."""
    return "\n".join(f"{event.time_s:10.3f} s  {event.what} {event.of}: {event.said}" for event in events)
