"""Which branches the rays of a sensor took: a book with one entry for each, found by a hash of its trail.

Entry e holds the spheres met, in order: met[begin[e] : begin[e + 1]], rows of ``balls``.  Entry 0 is the direct
view. ``slots`` (a power of two,) int32 is a hash table with open addressing: entry + 1, or 0; ``hashes``
(entries,) int64. A hash only says where to look: that two trails are the same is seen by comparing them.  Each
thread keeps a book of its own; they become one afterwards (`copy_book`).

``counts`` (1,) int64 is how many entries there are.
"""

from typing import NamedTuple

from ground.jit import Array, kernel

INDEX = (1 << 62) - 1  # says that a number is not negative
FULL = -1


class BranchBook(NamedTuple):
    """See the top of the file."""

    slots: Array
    hashes: Array
    begin: Array
    met: Array
    counts: Array


@kernel
def enter(hashed: int, events: int, first: int, trail: Array, book: BranchBook) -> int:
    """Entry of the trail trail[first : first + events], made if it is new."""
    slots, hashes, begin, met, counts = book
    mask = slots.shape[0] - 1
    # the lower bits of a product know nothing of the upper ones
    slot = ((hashed >> 32) ^ hashed) & mask
    while slots[slot] != 0:
        entry = slots[slot] - 1
        at = begin[entry]
        if hashes[entry] == hashed and begin[entry + 1] - at == events:
            same = 0
            while same < events and met[at + same] == trail[first + same]:
                same += 1
            if same == events:
                return int(entry)
        slot = (slot + 1) & mask
    entry = counts[0]
    at = begin[entry]
    for e in range(events):
        met[at + e] = trail[first + e]
    begin[entry + 1] = at + events
    hashes[entry] = hashed
    slots[slot] = entry + 1
    counts[0] = entry + 1
    return int(entry)


@kernel
def has_room(entries: int, longest: int, book: BranchBook) -> bool:
    """Whether so many more entries fit, none longer than `longest`."""
    count = book.counts[0] + entries
    fits = count < book.hashes.shape[0] and 2 * count <= book.slots.shape[0]
    return bool(fits and book.begin[book.counts[0]] + entries * longest <= book.met.shape[0])


@kernel
def copy_book(book: BranchBook, other: BranchBook, entries: Array) -> None:
    """Enter all that `book` has into `other`, which has room: its entries there go to entries (E,) int64."""
    for entry in range(book.counts[0]):
        at = book.begin[entry]
        entries[entry] = enter(book.hashes[entry], book.begin[entry + 1] - at, at, book.met, other)


@kernel
def pack_ranks(book: BranchBook, rank: Array, bits: int, packed: Array) -> None:
    """Words (W, E) uint64 of the entries that sort as their lengths, then the ranks (N,) of what they met, do.

    The first word of each is the length.
    """
    fit = 63 // bits
    for entry in range(book.counts[0]):
        at, events = book.begin[entry], book.begin[entry + 1] - book.begin[entry]
        packed[0, entry] = events
        for w in range(1, packed.shape[0]):
            word = 0
            for e in range((w - 1) * fit, w * fit):
                word = word << bits | (rank[book.met[at + e]] if e < events else 0)
            packed[w, entry] = word
