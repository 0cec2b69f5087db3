"""Colours as grey: as bright as they look, 0.299 red + 0.587 green + 0.114 blue, and said once.

Three equal channels are that grey, to the bit.  A colour camera has a filter before every pixel and makes up what
the others would have seen; its frames can be measured, and a grey camera's are better.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.terminal import say_once
from piv.errors import FrameError

SAID = "colours are taken as grey: 0.299 red + 0.587 green + 0.114 blue"


def grey_of(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return the grey of an image in red, green and blue (H, W, 3), or with an opaque fourth channel.

    Raises
    ------
    FrameError
        It lets something shine through.
    """
    import cv2

    if pixels.shape[2] > 3 and int(pixels[..., 3].min()) != np.iinfo(pixels.dtype).max:
        raise FrameError("is transparent in places; one grey image is needed, so export it as such")
    first = pixels[..., 0]
    if all(np.array_equal(first, pixels[..., channel]) for channel in (1, 2)):
        return np.ascontiguousarray(first)
    say_once(SAID)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels[..., :3]), cv2.COLOR_RGB2GRAY))
