"""Conservation: what became of every frame that was triggered.

    triggered = written + incomplete + rejected + lost

============  ===================================================================================
triggered     software triggers we sent, or exposures the camera numbered when it runs by itself
written       on the disk, in the journal
incomplete    arrived with pixels missing; never used
rejected      arrived whole and not wanted: surplus of a stream, contradicting its announcement
lost          never arrived: no free buffer, id missing, trigger ignored, silent; or the disk did not take it
============  ===================================================================================

The sides come from different counters: the left one from what we sent (or from ids), the right one from what was
handed over and written, and from what the camera's library counted.  The one number without a counter of its own
is `silent`: a trigger that was answered by nothing at all.  It is believed only where we waited in vain, so it can
never hide more frames than there were timeouts.  A camera that has forgotten its settings, or has gone before
they could be checked, may have exposed unasked; only then such frames count as triggered.
"""

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
    def from_dict(cls, counts: dict[str, Any]) -> Self:
        """Inverse of `to_dict`."""
        return cls(**{f.name: int(counts[f.name]) for f in fields(cls)})

    def sentence(self) -> str:
        """The balance in one line."""
        sign = "=" if self.imbalance == 0 else "!="
        return (
            f"{self.triggered} triggered {sign} {self.written} written + {self.incomplete} incomplete "
            f"+ {self.rejected} rejected + {self.lost} lost"
        )


class Bookkeeper:
    """Makes a ledger from an armed camera's counters and our own; one for each arm.

    Parameters
    ----------
    software : bool
        Whether each frame is triggered by us; otherwise the camera's ids say how many there were.
    """

    def __init__(self, software: bool) -> None:
        self._software = software
        self.triggers = 0
        self.handed = 0  # frames given to the pipeline
        self.rejected = 0
        self.timeouts = 0
        self.in_doubt = False  # settings were lost, or the camera was before they could be checked

    def close(self, counters: Counters) -> Ledger:
        """Return the ledger of an arm; all that was handed over counts as written until the disk says otherwise.

        Parameters
        ----------
        counters : Counters
            The camera's, after it was disarmed.
        """
        ignored = (counters.ignored_triggers or 0) if self._software else 0
        seen = counters.delivered + counters.incomplete + counters.underrun + counters.missing
        triggered = self.triggers if self._software else seen
        if self.in_doubt:  # it may have run by itself since the last check
            triggered = max(triggered, seen + ignored)
        silent = min(self.timeouts, max(0, triggered - seen - ignored)) if self._software else 0
        return Ledger(
            triggered=triggered,
            written=self.handed,
            incomplete=counters.incomplete,
            rejected=self.rejected,
            underrun=counters.underrun,
            missing=counters.missing,
            ignored=ignored,
            silent=silent,
        )
