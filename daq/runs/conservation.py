"""Conservation: what became of every frame that was triggered.

    triggered = written + incomplete + rejected + lost

============  ===================================================================================
triggered     software triggers we sent, or exposures the camera numbered when it runs by itself
written       on the disk, in the journal
incomplete    arrived with pixels missing; never used
rejected      arrived whole and not wanted: later than its timeout, exposed for somebody else, surplus of a
              stream, contradicting its announcement
lost          never arrived: no free buffer, id missing, trigger ignored, silent; or the disk did not take it
============  ===================================================================================

The sides come from different counters: the left one from what we sent (or from ids), the right one from what was
handed over and written, and from what the camera's library counted.  The one number without a counter of its own
is `silent`: a trigger that was answered by nothing at all.  It is believed only where we waited in vain, so it can
never hide more frames than there were timeouts; and it is a number of the whole session, for a frame that comes
after its timeout is no longer silent but rejected.

Frames that nobody asked for count as triggered where they are known to be just that: exposed before our first
trigger (an earlier process left them behind), unasked by a camera that has forgotten its settings or was gone
before they could be checked, or any where every frame handed over was told by its time.  Elsewhere they make an
imbalance: with one frame too many and nothing to tell them apart, all are in doubt.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Self

from daq.cameras.camera import Counters


@dataclass(frozen=True, slots=True)
class Ledger:
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
    def lost(self) -> int:
        """Frames that never arrived, or that the disk did not take."""
        return self.underrun + self.missing + self.ignored + self.silent + self.unwritten

    @property
    def imbalance(self) -> int:
        """Triggered minus everything that became of them; 0 if the books are right."""
        return self.triggered - self.written - self.incomplete - self.rejected - self.lost

    def __add__(self, other: "Ledger") -> "Ledger":
        return Ledger(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def to_dict(self) -> dict[str, int]:
        """Every count by name, `lost` and `imbalance` included."""
        return {**asdict(self), "lost": self.lost, "imbalance": self.imbalance}

    @classmethod
    def from_dict(cls, counts: Mapping[str, Any]) -> Self:
        """Inverse of `to_dict`."""
        return cls(**{f.name: int(counts[f.name]) for f in fields(cls)})

    def sentence(self) -> str:
        """The balance in one line; what did not happen is left out."""
        if not any((self.triggered, self.written, self.incomplete, self.rejected, self.lost)):
            return "no frame triggered yet"
        sign = "=" if self.imbalance == 0 else "!="
        others = ((self.incomplete, "incomplete"), (self.rejected, "rejected"), (self.lost, "lost"))
        failed = "".join(f" + {count} {name}" for count, name in others if count)
        return f"{self.triggered} triggered {sign} {self.written} written{failed}"


class Bookkeeper:
    """Makes a ledger from an armed camera's counters and our own; one for all arms of a session.

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
        self.by_time = False  # every frame handed over was exposed for its trigger, whatever else the camera sent

    def close(self, counters: Counters) -> Ledger:
        """Add an arm; return the ledger of the session so far.

        All that was handed over counts as written until the disk says otherwise.

        Parameters
        ----------
        counters : Counters
            The camera's, after it was disarmed.
        """
        self._ended = _added(self._ended, counters)
        return self.ledger()

    def ledger(self) -> Ledger:
        """Ledger of the arms that have ended."""
        counters = self._ended
        ignored = (counters.ignored_triggers or 0) if self._software else 0
        seen = counters.delivered + counters.incomplete + counters.underrun + counters.missing + counters.unused
        triggered = self.triggers + self.unasked if self._software else seen
        if self.in_doubt or self.by_time:  # it may have exposed unasked
            triggered = max(triggered, seen + ignored)
        silent = min(self.timeouts, max(0, triggered - seen - ignored)) if self._software else 0
        return Ledger(
            triggered=triggered,
            written=self.handed,
            incomplete=counters.incomplete,
            rejected=self.rejected + counters.unused,
            underrun=counters.underrun,
            missing=counters.missing,
            ignored=ignored,
            silent=silent,
        )


def _added(one: Counters, other: Counters) -> Counters:
    ignored = [each.ignored_triggers for each in (one, other) if each.ignored_triggers is not None]
    return Counters(
        delivered=one.delivered + other.delivered,
        incomplete=one.incomplete + other.incomplete,
        underrun=one.underrun + other.underrun,
        missing=one.missing + other.missing,
        resent=one.resent + other.resent,
        ignored_triggers=sum(ignored) if ignored else None,
        unused=one.unused + other.unused,
    )
