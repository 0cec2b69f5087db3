"""Take a whole bench back to where it was, in place: homing it anew would take longer than what is played on it.

Everything that can change and is reached from the root is remembered with what it held: attributes of our
objects, lists, dicts, sets, queues, byte arrays, random generators. Going back puts the contents back into the
SAME objects, so bound methods, closures and locks stay what they were; what has been made since is dropped. What
cannot change is shared. A lock must be free when something is remembered or taken back.
"""

import random
from collections import deque
from typing import Any

OURS = ("sim.", "stages.", "tests.", "serial.")


class Checkpoint:
    """The state of everything reached from a root, now.

    Parameters
    ----------
    root : object
        One of our objects.
    """

    def __init__(self, root: object) -> None:
        self._attributes: list[tuple[Any, dict[str, Any]]] = []
        self._lists: list[tuple[list[Any], list[Any]]] = []
        self._dicts: list[tuple[dict[Any, Any], dict[Any, Any]]] = []
        self._others: list[tuple[Any, tuple[Any, ...]]] = []  # sets, queues, byte arrays
        self._generators: list[tuple[random.Random, Any]] = []
        seen: set[int] = set()
        waiting = [root]
        while waiting:
            thing = waiting.pop()
            if id(thing) not in seen:
                seen.add(id(thing))
                waiting += self._remember(thing)

    def _remember(self, thing: Any) -> list[Any]:
        match thing:
            case list():
                self._lists.append((thing, list(thing)))
                return list(thing)
            case dict():
                self._dicts.append((thing, dict(thing)))
                return [*thing, *thing.values()]
            case set() | deque() | bytearray():
                self._others.append((thing, tuple(thing)))
                return list(thing)
            case tuple() | frozenset():
                return list(thing)
            case random.Random():
                self._generators.append((thing, thing.getstate()))
        if hasattr(thing, "__self__"):  # a bound method
            return [thing.__self__]
        if type(thing).__module__.startswith(OURS):
            attributes = getattr(thing, "__dict__", None)
            if attributes is not None:
                self._attributes.append((attributes, dict(attributes)))
                return list(attributes.values())
            names = [name for cls in type(thing).__mro__ for name in getattr(cls, "__slots__", ())]
            return [getattr(thing, name) for name in names if hasattr(thing, name)]
        return []

    @property
    def size(self) -> int:
        """How many things are remembered."""
        return sum(map(len, (self._attributes, self._lists, self._dicts, self._others, self._generators)))

    def go_back(self) -> None:
        """Put everything back."""
        for attributes, held in self._attributes:
            attributes.clear()
            attributes.update(held)
        for things, had in self._lists:
            things[:] = had
        for mapping, entries in self._dicts:
            if mapping != entries:
                mapping.clear()
                mapping.update(entries)
        for container, contents in self._others:
            container.clear()
            (container.update if isinstance(container, set) else container.extend)(contents)
        for generator, state in self._generators:
            generator.setstate(state)
