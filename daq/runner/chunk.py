"""Books of one chunk of pairs while it is taken."""

from collections import Counter
from dataclasses import dataclass, field

from ground.plain_words import counted


@dataclass
class Chunk:
    """Books of one chunk; frames are dropped by reason, pairs are kept."""

    fired: int
    triggers: int
    kept: int = 0
    surplus: int = 0
    dropped: Counter[str] = field(default_factory=Counter)

    @property
    def lost(self) -> int:
        """Pairs that were fired and are neither kept nor surplus."""
        return self.fired - self.kept - self.surplus

    @property
    def never_came(self) -> int:
        """Frames that were triggered and never seen whole; below 0 if the camera sent more than were asked for."""
        return 2 * (self.triggers - self.kept) - sum(self.dropped.values())

    def sentence(self) -> str:
        """What became of the pairs that were fired."""
        reasons = ", ".join(f"{counted(number, 'frame')} {why}" for why, number in sorted(self.dropped.items()))
        never = f"{counted(self.never_came, 'frame')} never came" if self.never_came > 0 else ""
        told = "; ".join(filter(None, (reasons, never)))
        return f"{self.kept} of {self.fired} pairs that were fired are sure ({told or 'nothing else came'})"
