"""Kinds of number that frames come in, as the three that are evaluated: uint8, uint16 and float32."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.errors import FrameError

AS_THEY_ARE = (np.uint8, np.uint16, np.float32)
NEEDED = "frames are integers of 8 to 64 bits or float32 or float64"


def as_grey_levels(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return numbers as they are if evaluations take them, else as float32, all frames of a series alike.

    Integers up to 2^24 stay as they are; of larger ones and of float64 the relative change is 6e-8.

    Raises
    ------
    FrameError
        They are no such numbers, as the rest of a sentence.
    """
    if pixels.dtype.kind not in "iuf" or pixels.dtype == np.float16:
        raise FrameError(f"holds {pixels.dtype}; {NEEDED}")
    kind = pixels.dtype.newbyteorder("=")
    return pixels.astype(kind if kind in AS_THEY_ARE else np.float32, copy=False)
