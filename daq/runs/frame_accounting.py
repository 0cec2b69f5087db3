"""Conservation: what became of every frame that was triggered.

    triggered = written + incomplete + rejected + lost

============  ===================================================================================
triggered     software triggers we sent, or exposures the camera numbered when it runs by itself
written       on the disk, in the journal
incomplete    arrived with pixels missing; never used
rejected      arrived whole and not wanted: later than its timeout, exposed for another trigger, surplus of a
              stream, contradicting its announcement
lost          never arrived: no free buffer, id missing, trigger ignored, silent; or the disk did not take it
============  ===================================================================================

The sides come from different counters: the left one from what we sent (or from ids), the right one from what was
handed over and written, and from what the camera's library counted.  The one number without a counter of its own
is `silent`: a trigger that was answered by nothing at all.  It is believed only where we waited in vain, so it can
never hide more frames than there were timeouts; and it is a number of the whole session, for a frame that comes
after its timeout is no longer silent but rejected.

Unasked frames count as triggered where they are known to be just that: exposed before our first
trigger (an earlier process left them behind), unasked by a camera that has forgotten its settings or was gone
before they could be checked, or any where every frame handed over was identified by its time.  Elsewhere they make
an imbalance: with one frame too many and nothing to distinguish them, all are ambiguous.

The account of a whole run is those of its sessions in the journal, added up (`total_accounting`).  An ambiguity is
a reason why some frame of the run may not show what its record says: accounts that do not balance, or a frame that
could not be given to its trigger.  It never goes away by taking more frames, so a run with one is never done and
is not resumed; its frames stay where they are.

In a flow run pairs of light pulses are conserved as well (`chunk_sentences`):

    frames:  2 triggers = 2 pairs + dropped by reason + those that never came
    pairs:   fired = kept + lost + surplus
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from typing import Any, Self

from daq.cameras.camera import Counters
from daq.runs.journal import Entry
from ground.plain_words import quantity


@dataclass(frozen=True, slots=True)
class FrameAccounting:
    """Frames by what became of them; ledgers of several arms or sessions add up."""

    triggered: int = 0
    written: int = 0
    incomplete: int = 0
    rejected: int = 0
    underrun: int = 0
    missing: int = 0
    ignored: int = 0
    silent: int = 0
    unwritten: int = 0

    @property
    def losses(self) -> int:
        """Frames that never arrived, or that the disk did not take."""
        return self.underrun + self.missing + self.ignored + self.silent + self.unwritten

    @property
    def imbalance(self) -> int:
        """Triggered minus everything that became of them; 0 if the account is right."""
        return self.triggered - self.written - self.incomplete - self.rejected - self.losses

    def __add__(self, other: "FrameAccounting") -> "FrameAccounting":
        return FrameAccounting(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def to_dict(self) -> dict[str, int]:
        """Every count by name, `lost` and `imbalance` included."""
        return {**asdict(self), "lost": self.losses, "imbalance": self.imbalance}

    @classmethod
    def from_dict(cls, counts: Mapping[str, Any]) -> Self:
        """Inverse of `to_dict`."""
        return cls(**{f.name: int(counts[f.name]) for f in fields(cls)})

    def sentence(self) -> str:
        """The balance in one line; what did not happen is left out."""
        if not any((self.triggered, self.written, self.incomplete, self.rejected, self.losses)):
            return "no frame triggered yet"
        sign = "=" if self.imbalance == 0 else "!="
        others = ((self.incomplete, "incomplete"), (self.rejected, "rejected"), (self.losses, "lost"))
        failed = "".join(f" + {count} {name}" for count, name in others if count)
        return f"{self.triggered} triggered {sign} {self.written} written{failed}"


class FrameCounters:
    """Makes an accounting from an armed camera's counters and our own; one for all arms of a session.

    A frame that came after its arm had ended is found in a later one, so only the whole session can be balanced.

    Parameters
    ----------
    software : bool
        Whether each frame is triggered by us; otherwise the camera's ids say how many there were.
    """

    def __init__(self, software: bool) -> None:
        self._software = software
        self._ended = Counters()  # of all arms that have ended
        self.triggers = 0
        self.handed = 0  # frames given to the pipeline
        self.rejected = 0
        self.unasked = 0  # of those rejected: no trigger of ours was owed them
        self.timeouts = 0
        self.in_doubt = False  # settings were lost, or the camera was before they could be checked
        # every frame handed over was exposed for its trigger, whatever else the camera sent
        self.by_time = False

    def close(self, counters: Counters) -> FrameAccounting:
        """Add an arm; return the accounting of the session so far.

        All that was handed over counts as written until the disk says otherwise.

        Parameters
        ----------
        counters : Counters
            The camera's, after it was disarmed.
        """
        self._ended = _add_counters(self._ended, counters)
        return self.accounting()

    def accounting(self) -> FrameAccounting:
        """FrameAccounting of the arms that have ended."""
        counters = self._ended
        ignored = (counters.ignored_triggers or 0) if self._software else 0
        seen = counters.delivered + counters.incomplete + counters.underrun + counters.missing + counters.unused
        triggered = self.triggers + self.unasked if self._software else seen
        if self.in_doubt or self.by_time:  # it may have exposed unasked
            triggered = max(triggered, seen + ignored)
        silent = min(self.timeouts, max(0, triggered - seen - ignored)) if self._software else 0
        return FrameAccounting(
            triggered=triggered,
            written=self.handed,
            incomplete=counters.incomplete,
            rejected=self.rejected + counters.unused,
            underrun=counters.underrun,
            missing=counters.missing,
            ignored=ignored,
            silent=silent,
        )


def _add_counters(one: Counters, other: Counters) -> Counters:
    """Add counts; what neither camera tells is None."""
    total: dict[str, Any] = {}
    for name in (field.name for field in fields(Counters)):
        counts = [count for each in (one, other) if (count := getattr(each, name)) is not None]
        total[name] = sum(counts) if counts else None
    return Counters(**total)


def total_accounting(entries: Sequence[Entry]) -> tuple[FrameAccounting, list[dict[str, Any]]]:
    """Add the accounts of all sessions up.

    A session that was killed has none; its frame lines stand for it, and what was under way is not known.  Frames
    that a session discards at its beginning were written by an earlier one.
    """
    starts = [index for index, entry in enumerate(entries) if entry["kind"] == "session"]
    total, sessions = FrameAccounting(), []
    for first, last in pairwise([*starts, len(entries)]):
        lines = [line for line in entries[first + 1 : last] if line["kind"] != "camera"]  # these count nothing
        account = next(
            (FrameAccounting.from_dict(line["books"]) for line in lines if line["kind"] == "counts"), None
        )
        end = next((line for line in lines if line["kind"] == "end"), None)
        was_killed = account is None
        if account is None:
            written = sum(line["kind"] == "frame" for line in lines)
            account = FrameAccounting(triggered=written, written=written)
        for number, line in enumerate(lines):
            if line["kind"] == "discard" and (number == 0 or was_killed):
                account += FrameAccounting(written=-len(line["frames"]), rejected=len(line["frames"]))
        total += account
        why = {"ended": "killed", "error": ""} if end is None else {"ended": end["why"], "error": end["error"]}
        sessions.append({"utc": entries[first]["utc"], **why, "conservation": account.to_dict()})
    return total, sessions


def ambiguities(entries: Sequence[Entry]) -> list[str]:
    """Return the ambiguities of a run, one sentence each, without full stop; [] if there are none.

    Sessions say so themselves (key `doubt` of their lines, lines of the kind `doubt`); accounts that do not
    balance are one in any case.
    """
    found: list[str] = []
    for entry in entries:
        said = entry.get("doubt")
        if said is not None:
            found.append(str(said))
        elif entry["kind"] == "counts":
            account = FrameAccounting.from_dict(entry["books"])
            if account.imbalance:
                found.append(f"the frame counts of a session do not balance ({account.sentence()})")
    return list(dict.fromkeys(found))


def rejection_sentence(entries: Sequence[Entry]) -> str:
    """Say why frames of a run were rejected, as one sentence without full stop; "" if none were.

    Of a run with chunks `chunk_sentences` says it.

    Parameters
    ----------
    entries : sequence of Entry
        The journal.
    """
    rejected = total_accounting(entries)[0].rejected
    if rejected <= 0 or any(entry["kind"] == "chunk" for entry in entries):
        return ""
    why: Counter[str] = Counter()
    for entry in entries:
        why.update(entry.get("why_rejected", {}))
        if entry["kind"] == "discard":
            why["are of steps that were taken again"] += len(entry["frames"])
    why["were left when the camera was stopped"] += max(0, rejected - why.total())
    reasons = ", ".join(f"{number} {reason}" for reason, number in why.items() if number)
    return f"frames rejected: {reasons}; nothing of the run shows them"


ELSEWHERE = "of pairs that another camera has not"
EXTERNAL = "external"  # synchroniser of a chunk that no box of the bench has fired
UNCHECKED = (
    "an external synchroniser triggers laser and camera, so these are not checked: the time between the pulses "
    "(dt_us of the plan is taken as it stands), whether light 1 falls into exposure A and light 2 into B, how "
    "many pulses were fired, door, shutter and what stands in the light sheet; that laser is not switched off "
    "here, and stages move whether it fires or not"
)
SURPLUS, LEFT = "more than wanted", "left when the chunk ended"


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
    external = any(entry.get("synchroniser") == EXTERNAL for entry in chunks)
    verb = "triggered from outside" if external else "fired"
    said = [f"{quantity(fired, 'pair')} {were} {verb} in {bursts}: {kept} are kept{more}, {lost} are lost"]
    dropped: Counter[str] = Counter()
    for entry in chunks:
        dropped.update(entry["dropped"])
    dropped.pop(SURPLUS, None)
    others = [f"{number} {why}" for why, number in sorted(dropped.items()) if number]
    others += [f"{never} never came"] if never > 0 else []
    if others:
        said.append(f"other frames that are in no pair: {', '.join(others)}")
    return [*said, UNCHECKED] if external else said
