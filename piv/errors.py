"""Errors of the evaluation of pairs and series; the command line prints them as one sentence.

PivError
+-- FrameError       a frame cannot be used as it is: shape, kind of number, NaN where values are needed
|   +-- FrameDamaged     its pixels are not those that its checksum was made from
+-- PairError        two frames do not make a pair: different size, nothing valid, no texture
+-- SeriesError      statistics of a series do not belong together, or a file of them is damaged
+-- VectorFileError  a file holds no vectors on a grid, or is damaged
"""

from ground.errors import DEVICE, RtpivError


class PivError(RtpivError):
    """Root of everything this package raises on purpose."""


class FrameError(PivError):
    """A frame is not a 2-D array of finite intensities; the message says what it is instead."""


class FrameDamaged(FrameError):  # noqa: N818 - says what it is
    """The pixels or the checksum of a frame are not what was written; restore the file from a copy."""

    exit_code = DEVICE


class PairError(PivError):
    """Two frames cannot be evaluated as a pair; the message names the reason and the cure."""


class SeriesError(PivError):
    """Statistics of a series cannot be added up or read; the message names what differs and the cure."""


class VectorFileError(PivError):
    """A file of vectors cannot be read; the message names it and what is wrong with it."""
