"""What a laboratory asks of a laser beyond what the laser can do."""

from dataclasses import dataclass

from daq.timing.alignment import AlignRules
from daq.timing.conditions import CLEAR_MM


@dataclass(frozen=True, slots=True)
class Rules:
    """What the laboratory asks for beyond what the laser can do.

    Parameters
    ----------
    warmup_s : float
        How long lamps run before the first pulse.
    chunk_s : float
        Longest burst.
    clear_mm : float
        What must be free on either side of the sheet.
    dark_us : float or None
        Longest exposure B for which the room is dark enough; None if that is no matter.
    uncounted : bool
        Whether a box that cannot count may fire.
    align : AlignRules or None
        None if there is no alignment mode.
    """

    warmup_s: float = 600.0
    chunk_s: float = 10.0
    clear_mm: float = CLEAR_MM
    dark_us: float | None = None
    uncounted: bool = False
    align: AlignRules | None = None
