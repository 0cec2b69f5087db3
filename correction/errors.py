"""Errors of the correction and its evaluation; the command line prints them as one sentence.

CorrectionError
+-- FrameError       a frame cannot be used as it is: shape, kind of number, NaN where values are needed
+-- PairError        two frames do not make a pair: different size, nothing valid, no texture
"""


class CorrectionError(Exception):
    """Root of everything this package raises on purpose."""


class FrameError(CorrectionError):
    """A frame is not a 2-D array of finite intensities; the message says what it is instead."""


class PairError(CorrectionError):
    """Two frames cannot be evaluated as a pair; the message names the reason and the cure."""
