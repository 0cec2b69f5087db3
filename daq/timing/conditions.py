"""Conditions that must hold before and while light may leave, as a value stated at one moment.

A condition that is not stated is not met: every field is False, zero or None by default. The laser asks for a new
statement all the time while it fires, and goes off when one of them no longer holds, or when no statement comes.
Switches of door, shutter and key are not among them: the laser reads those itself (`switches`).

`Rules` are what a laboratory asks beyond what the laser can do.
"""

from dataclasses import dataclass

from daq.timing.low_energy import LowEnergyRules
from daq.timing.pulses import PairExposures, Schedule

CLEAR_MM = 4.0  # of the sheet, where the bench file says nothing else


@dataclass(frozen=True, slots=True)
class Conditions:
    """Present state of the bench.

    Parameters
    ----------
    camera_armed : bool
        The camera waits for triggers.
    buffers_empty : bool
        No older frame is under way. Asked at arming; while it fires frames are what is wanted.
    at_rest : bool
        Every axis vouches for its position and none moves.
    sheet_clearance_mm : float or None
        From the sheet to the nearest glass or target; None if not known.
    frames_fit : int
        Pairs for which there is room on the disk.
    """

    camera_armed: bool = False
    buffers_empty: bool = False
    at_rest: bool = False
    sheet_clearance_mm: float | None = None
    frames_fit: int = 0

    def missing(self, pairs: int, clear_mm: float = CLEAR_MM, fires: bool = False) -> str | None:
        """Say the first condition that is not met, as part of a sentence; None if all are.

        Parameters
        ----------
        pairs : int
            How many more are to be taken.
        clear_mm : float
            What must be kept free on either side of the sheet.
        fires : bool
            Whether it fires already, when frames are under way.
        """
        if not self.camera_armed:
            return "the camera does not wait for triggers"
        if not (self.buffers_empty or fires):
            return "older frames are still in the camera's buffers"
        if not self.at_rest:
            return "something on the bench moves, or does not know where it is"
        if self.sheet_clearance_mm is None:
            return "the distance of glass and target from the sheet is unknown"
        if not self.sheet_clearance_mm >= clear_mm:  # NaN is not clear
            return f"something is {self.sheet_clearance_mm:.1f} mm from the sheet; {clear_mm:g} mm must be free"
        if self.frames_fit < pairs:
            return f"the disk has room for {self.frames_fit} pairs, not for {pairs}"
        return None


def exposure_problem(schedule: Schedule, exposures: PairExposures, dark_us: float | None) -> str | None:
    """Say why exposures are too long for a pair, as part of a sentence; None if they are not.

    Parameters
    ----------
    schedule : Schedule
        What the box has been loaded with.
    exposures : PairExposures
        Of the camera.
    dark_us : float or None
        Longest exposure B for which the room is dark enough; None if not given.
    """
    if exposures.length_us >= schedule.period_us:
        return f"two exposures of {exposures.length_us:g} us do not fit into {schedule.period_us:g} us"
    if dark_us is not None and exposures.exposure_b_us > dark_us:
        return f"exposure B of {exposures.exposure_b_us:g} us is longer than the {dark_us:g} us of a dark room"
    return None


@dataclass(frozen=True, slots=True)
class Rules:
    """Requirements of the laboratory beyond the limits of the laser.

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
    align : LowEnergyRules or None
        None if there is no alignment mode.
    """

    warmup_s: float = 600.0
    chunk_s: float = 10.0
    clear_mm: float = CLEAR_MM
    dark_us: float | None = None
    uncounted: bool = False
    align: LowEnergyRules | None = None
