"""Errors of the correction and the fit; the command line prints them as one sentence.

CorrectionError
+-- BoardError       the description of the target contradicts itself
+-- TargetNotFound   a frame does not show the described target, or too little of it
+-- MapUsageError    a correction map is asked for that cannot be (also a ValueError)
+-- SheetError       the light sheet cannot be found in some frames
+-- DewarpError      pairs of points do not determine the dewarp polynomial, or stored numbers are not one
+-- AlignmentError   a frame does not say where the glass stands
|   +-- RimNotFound     a sphere shows no rim where it may stand
|   +-- RimUnclear      what is seen may be another rim, or more glass than the scene names
|   +-- MoveDoubted     a move did not do to the view what it should have done; nothing may go on by itself
+-- FitError         a scene could not be fitted
    +-- ViewsMissing    the frames given cannot determine the scene
    +-- GlassNotSeen    the frames show no glass, or glass that is not where the scene says
    +-- FitFailed       a fit was found and is not good enough to be used; gate, value and limit are kept
"""

from ground.errors import RtpivError


class CorrectionError(RtpivError):
    """Root of everything this package raises on purpose."""


class SheetError(CorrectionError):
    """The light sheet cannot be found in some frames; the message says what is missing."""


class BoardError(CorrectionError):
    """A target cannot look as described; the message says which number to change."""


class TargetNotFound(CorrectionError):  # noqa: N818 - says what it is
    """The target is not in the frame as described; the message says what was seen and what to do."""


class MapUsageError(CorrectionError, ValueError):
    """A correction map is asked for that cannot be; the message names one that can."""


class DewarpError(CorrectionError):
    """The dewarp polynomial cannot be fitted or loaded; the message says what is missing."""


class AlignmentError(CorrectionError):
    """Root of what alignment raises on purpose."""


class RimNotFound(AlignmentError):  # noqa: N818 - says what is wrong
    """A rim is not seen; the message says whose, and the cure."""


class RimUnclear(AlignmentError):  # noqa: N818
    """Rims can be read in more than one way; the message says which."""


class MoveDoubted(AlignmentError):  # noqa: N818
    """An axis did not move what it should move, or the other way; the message names it."""


class FitError(CorrectionError):
    """Root of what a scene fit raises on purpose."""


class ViewsMissing(FitError):  # noqa: N818 - says what is wrong
    """More or other frames are needed; the message says which."""


class GlassNotSeen(FitError):  # noqa: N818
    """The frames do not show the spheres of the scene."""


class FitFailed(FitError):  # noqa: N818
    """The best fit misses a gate.

    Parameters
    ----------
    gate : str
        Name of the gate.
    value, limit : float
        What was reached, and what is needed.
    reason : str
        A sentence with the cure.
    """

    def __init__(self, gate: str, value: float, limit: float, reason: str) -> None:
        self.gate, self.value, self.limit, self.reason = gate, value, limit, reason
        super().__init__(f"the fit failed at gate {gate!r} ({value:.3g}, limit {limit:.3g}): {reason}")
