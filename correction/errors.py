"""Errors of the correction and the fit; the command line prints them as one sentence.

CorrectionError
+-- BoardError       the description of the target contradicts itself
+-- TargetNotFound   a frame does not show the described target, or too little of it
+-- MapUsageError    a correction map is asked for that cannot be (also a ValueError)
+-- SheetError       the light sheet cannot be found in some frames
+-- DewarpError      pairs of points do not determine the dewarp polynomial, or stored numbers are not one
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
    """What is asked of a correction map makes no sense; the message says what would."""


class DewarpError(CorrectionError):
    """The dewarp polynomial cannot be fitted or loaded; the message says what is missing."""
