"""What a person wants to know while a run goes on."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from daq.pipeline.flow import Flow
from daq.runs.conservation import Ledger
from daq.timing.states import LaserState


@dataclass
class Progress:
    """State of a session; changed by the runner, read by whoever shows it.

    Parameters
    ----------
    steps, step : int
        Steps of the plan, and the one that is being carried out.
    tag, doing : str
        Its tag, and what happens just now.
    planned, frames : int
        Frames of this session, and those that have been taken.
    begun_s : float
        When the session began, on `time.monotonic`.
    laser : LaserState or None
        Of the laser that the session uses; None if it has none yet.
    """

    steps: int = 0
    step: int = 0
    tag: str = ""
    doing: str = ""
    planned: int = 0
    frames: int = 0
    begun_s: float = field(default_factory=time.monotonic)
    positions_mm: dict[str, float] = field(default_factory=dict)
    ledger: Ledger = field(default_factory=Ledger)
    waiting: tuple[int, int] = (0, 0)
    flow: Flow = field(default_factory=Flow)
    laser: LaserState | None = None

    @property
    def elapsed_s(self) -> float:
        """Time since the session began."""
        return max(1e-9, time.monotonic() - self.begun_s)

    def left(self) -> str:
        """Time left as a person says it; "" while nobody can know."""
        if not self.frames or self.planned <= self.frames:
            return ""
        left_s = round(self.elapsed_s / self.frames * (self.planned - self.frames))
        return f"about {left_s // 60} min {left_s % 60} s left" if left_s >= 60 else f"about {left_s} s left"


Watcher = Callable[[Progress], None]
