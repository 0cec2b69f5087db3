"""Errors of the correction and its evaluation; the command line prints them as one sentence.

CorrectionError
+-- FrameError       a frame cannot be used as it is: shape, kind of number, NaN where values are needed
|   +-- FrameDamaged     its pixels are not those that its checksum was made from
+-- PairError        two frames do not make a pair: different size, nothing valid, no texture
+-- BoardError       the description of the target contradicts itself
+-- TargetNotFound   a frame does not show the described target, or too little of it
+-- MapUsageError    a correction map is asked for that cannot be (also a ValueError)
+-- SheetError       the light sheet cannot be found in some frames
+-- SeriesError      statistics of a series do not belong together, or a file of them is damaged
+-- DewarpError      pairs of points do not determine the dewarp polynomial, or stored numbers are not one
"""


class CorrectionError(Exception):
    """Root of everything this package raises on purpose."""


class FrameError(CorrectionError):
    """A frame is not a 2-D array of finite intensities; the message says what it is instead."""


class FrameDamaged(FrameError):  # noqa: N818 - says what it is
    """The pixels or the checksum of a frame are not what was written; restore the file from a copy."""


class PairError(CorrectionError):
    """Two frames cannot be evaluated as a pair; the message names the reason and the cure."""


class SeriesError(CorrectionError):
    """Statistics of a series cannot be added up or read; the message names what differs and the cure."""


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
