"""Merge the parts of a series in an order that depends on their numbers alone.

Floating-point sums depend on the order of addition. Here part number k is leaf k of a binary tree; nodes 2 i and
2 i + 1 of a level become node i of the next one, in whatever order they come. Which worker made a part, and when,
shows in no bit. At the end nodes without a partner rise as they are: a missing part counts as an empty one.

Of parts that come in order log2 of their number wait, as the digits of a binary counter; the worst order keeps
half of them waiting. The tree over chunks of 2^m pairs is the upper part of the tree over their pairs: chunks
of any such length lead to the same bits as one stream of pairs.
"""

from collections.abc import Iterable, Iterator
from typing import Generic, Protocol, TypeVar

from piv.errors import SeriesError


class Mergeable(Protocol):
    """Statistics that can be merged with more of their kind, itself first."""

    def merge_with(self: "T", other: "T", /) -> "T":
        """Both together."""
        ...


T = TypeVar("T", bound=Mergeable)


class MergeTree(Generic[T]):
    """Parts of a series on their way to one result."""

    def __init__(self) -> None:
        self._waiting: dict[tuple[int, int], T] = {}
        self._last = -1

    def add(self, number: int, part: T) -> None:
        """Take part `number` (from 0); parts may come in any order.

        Raises
        ------
        SeriesError
            The number is negative, or was there already.
        """
        if number < 0 or any((level, number >> level) in self._waiting for level in range(64)):
            raise SeriesError(f"part {number} of a series was counted twice or is none; merge each part once")
        self._last = max(self._last, number)
        level = 0
        while (partner := self._waiting.pop((level, number ^ 1), None)) is not None:
            part = part.merge_with(partner) if number % 2 == 0 else partner.merge_with(part)
            level, number = level + 1, number >> 1
        self._waiting[level, number] = part

    def __len__(self) -> int:
        """Parts that wait for their partners."""
        return len(self._waiting)

    def result(self) -> T:
        """All parts merged; more may be added afterwards.

        Raises
        ------
        SeriesError
            There is none.
        """
        if not self._waiting:
            raise SeriesError("a series without a single part has no statistics; evaluate some pairs first")
        nodes, level = dict(self._waiting), 0
        while len(nodes) > 1:
            for key in sorted(key for key in nodes if key[0] == level):
                part = nodes.pop(key)
                above = (level + 1, key[1] >> 1)
                nodes[above] = nodes[above].merge_with(part) if above in nodes else part
            level += 1
        return next(iter(nodes.values()))


def merge_in_order(parts: Iterable[tuple[int, T]]) -> T:
    """All numbered parts merged by their tree.

    Raises
    ------
    SeriesError
        There is none, or one came twice.
    """
    tree: MergeTree[T] = MergeTree()
    for number, part in parts:
        tree.add(number, part)
    return tree.result()


def chunks_of(pairs: int, chunk: int) -> Iterator[range]:
    """Numbers of the pairs of each chunk; `chunk` must be a power of two, see the top.

    Raises
    ------
    SeriesError
        It is none.
    """
    if chunk < 1 or chunk & (chunk - 1):
        raise SeriesError(f"a chunk holds 2^m pairs (64, 128, ...), not {chunk}: else bits depend on its length")
    yield from (range(first, min(first + chunk, pairs)) for first in range(0, pairs, chunk))
