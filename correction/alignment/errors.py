"""Why a frame does not say where the glass stands.

CorrectionError
+-- AlignmentError
    +-- RimNotFound     a sphere shows no rim where it may stand
    +-- RimUnclear      what is seen may be another rim, or more glass than the scene names
    +-- MoveDoubted     a move did not do to the view what it should have done; nothing may go on by itself
"""

from correction.errors import CorrectionError


class AlignmentError(CorrectionError):
    """Root of what alignment raises on purpose."""


class RimNotFound(AlignmentError):  # noqa: N818 - says what is wrong
    """A rim is not seen; the message says whose, and the cure."""


class RimUnclear(AlignmentError):  # noqa: N818
    """Rims can be read in more than one way; the message says which."""


class MoveDoubted(AlignmentError):  # noqa: N818
    """An axis did not move what it should move, or the other way; the message names it."""
