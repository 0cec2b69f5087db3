"""Queue of the live thread: recent frames, and never half of a group.

A live thread that is too slow has to leave frames out.  Left out one by one, nearly every pair would lose one of
its two frames: at half the needed speed half of the frames would be corrected, and no vectors measured at all.  So
a group (`Step.group`; a pair of a flow has two frames) is left out whole or not at all:

* when too much waits, the OLDEST group that is not begun goes, so that what is shown is recent;
* a frame whose group was left out follows it, and a group that has been begun is brought to its end.

What waits is bounded: by the limit in groups that are not begun, or by one group if that is larger, and by the
rest of the one that was begun.
"""

import threading
from collections import OrderedDict, deque
from collections.abc import Iterator
from typing import Generic, TypeVar

Item = TypeVar("Item")
Group = tuple[int, int]  # step, number of the group's first frame
REMEMBERED = 64  # groups that were left out and may still send frames; numbers of a camera hardly overtake


class LiveQueue(Generic[Item]):
    """Frames that wait to be corrected as they come.

    Parameters
    ----------
    limit : int
        Frames that may wait.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._waiting: OrderedDict[Group, deque[Item]] = OrderedDict()
        self._begun: Group | None = None
        self._left_out: deque[Group] = deque(maxlen=REMEMBERED)
        self._wake = threading.Condition()
        self._ended = False

    def __len__(self) -> int:
        with self._wake:
            return sum(map(len, self._waiting.values()))

    def put(self, item: Item, group: Group, size: int, room: bool = True) -> list[Item]:
        """Add a frame.

        Parameters
        ----------
        item : Item
            The frame.
        group : (int, int)
            What it belongs to.
        size : int
            Frames of that group.
        room : bool
            False if there is no time for another group now; one that waits already may still grow.

        Returns
        -------
        list of Item
            What is left out for it, itself included where that is so; oldest first.
        """
        with self._wake:
            known = group in self._waiting or group == self._begun
            if group in self._left_out or not (room or known):
                self._leave_out(group)
                return [item]
            self._waiting.setdefault(group, deque()).append(item)
            dropped = [lost for other in self._too_many(group, size) for lost in self._take_back(other)]
            self._wake.notify()
            return dropped

    def take(self) -> Item | None:
        """Wait for the next frame; None when the queue has been ended and is empty."""
        with self._wake:
            while not self._waiting and not self._ended:
                self._wake.wait()
            if not self._waiting:
                return None
            group = self._begun
            if group is None or group not in self._waiting:
                group = next(iter(self._waiting))
            frames = self._waiting[group]
            item = frames.popleft()
            if not frames:
                del self._waiting[group]
            self._begun = group
            return item

    def end(self) -> None:
        """Say that nothing comes any more."""
        with self._wake:
            self._ended = True
            self._wake.notify_all()

    def _too_many(self, newest: Group, size: int) -> Iterator[Group]:
        """Groups that have to go, oldest first; never the newest one nor the one that was begun."""
        free = [group for group in self._waiting if group != self._begun]
        waiting = sum(len(self._waiting[group]) for group in free)
        for group in free:
            if waiting <= max(self._limit, size) or group == newest:
                return
            waiting -= len(self._waiting[group])
            yield group

    def _take_back(self, group: Group) -> deque[Item]:
        self._leave_out(group)
        return self._waiting.pop(group)

    def _leave_out(self, group: Group) -> None:
        if group not in self._left_out:
            self._left_out.append(group)
