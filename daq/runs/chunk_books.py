"""What became of the pairs of a flow run and of their frames, in words for who reads it.

frames:  2 triggers = 2 pairs + dropped by reason + those that never came
pairs:   fired = kept + lost + surplus
"""

from collections import Counter
from collections.abc import Iterable

from daq.runs.journal import Entry
from ground.plain_words import counted

DARK, HALF = "without light", "of pairs with one light"
ELSEWHERE = "of pairs that another camera has not"
SURPLUS, LEFT = "more than wanted", "left when the chunk ended"
_AT_THE_ENDS = (
    "where lamps run all the time the camera takes some pairs before the first light of a chunk and after the "
    "last, and the two lights may begin and end a period apart, so a chunk may begin and end with half a pair; "
    "none of these is kept"
)


def chunk_sentences(entries: Iterable[Entry]) -> list[str]:
    """Return what the lines of all chunks of a run come to, a sentence each; nothing for a run without chunks.

    Parameters
    ----------
    entries : iterable of Entry
        Lines of the journal.
    """
    chunks = [entry for entry in entries if entry["kind"] == "chunk"]
    if not chunks:
        return []
    fired, kept, surplus, lost, never = (
        sum(entry[name] for entry in chunks) for name in ("fired", "pairs", "surplus", "lost", "never_came")
    )
    more = f", {surplus} more than were wanted" if surplus else ""
    bursts = f"{len(chunks)} chunks" if len(chunks) > 1 else "one chunk"
    were = "was" if fired == 1 else "were"
    said = [f"{counted(fired, 'pair')} {were} fired in {bursts}: {kept} are kept{more}, {lost} are lost"]
    dropped: Counter[str] = Counter()
    for entry in chunks:
        dropped.update(entry["dropped"])
    dark, half = dropped.pop(DARK, 0), dropped.pop(HALF, 0)
    if dark or half:
        said.append(f"{dark} frames had no light and {half} were {HALF}: {_AT_THE_ENDS}")
    dropped.pop(SURPLUS, None)
    others = [f"{number} {why}" for why, number in sorted(dropped.items()) if number]
    others += [f"{never} never came"] if never > 0 else []
    if others:
        said.append(f"other frames that are in no pair: {', '.join(others)}")
    return said
