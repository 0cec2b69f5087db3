"""Hot pixels of a sensor: bright at the same place in both frames of a pair, and sharper than images of particles.

They match at no displacement and draw vectors to zero. The height of a hot pixel over its usual neighbour is all
its height over the ground. Of the images of particles it is a part: at most 0.55 where their deviation is 0.7 px,
and where they are as small as a pixel any part up to 1, since few of them lie in the middle of one.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Height over the usual neighbour as a part of that over the ground: of hot pixels and of nearly single ones
SINGLE, NEARLY = 0.9, 0.8
HOT = 0.6  # the same beside light of the flow, once there are hot pixels
ABOVE_NOISE = 6.0  # height in deviations of what differs between the frames
GROUND_PX = 5  # side of the area whose darkest pixel is the ground
FEWEST = 2e-4  # share of the pixels
# Images of particles as small as a pixel coincide by chance as often where frames are shifted so far as where they
# are not; hot pixels are more than twice that.
ASIDE_PX, CHANCE = (31, 17), 2.0


def hot_pixels(a: NDArray[Any], b: NDArray[Any], valid: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Return pixels (H, W) that are hot in both frames; None if there are hardly any."""
    kind = a.dtype if a.dtype == b.dtype and a.dtype in (np.uint8, np.uint16) else np.float32
    one, other = (frame.astype(kind, copy=False) for frame in (a, b))
    places, part = _heights(one, other, valid)
    single, nearly = (np.count_nonzero(part > limit) for limit in (SINGLE, NEARLY))
    if single < FEWEST * one.size or 2 * single < nearly:
        return None
    by_chance = np.count_nonzero(_heights(one, np.roll(other, ASIDE_PX, (0, 1)), valid)[1] > SINGLE)
    if single < CHANCE * by_chance:
        return None
    hot = np.zeros(one.shape, bool)
    hot[places] = part > HOT
    return hot


def _heights(
    a: NDArray[Any], b: NDArray[Any], valid: NDArray[np.bool_]
) -> tuple[tuple[NDArray[np.intp], ...], NDArray[np.float64]]:
    """Places that are bright in both frames, and their height over the usual neighbour by that over the ground."""
    import cv2

    low, high = np.minimum(a, b), np.maximum(a, b)
    usual = np.asarray(cv2.medianBlur(high, 3))
    noise = 1.48 * float(np.median((high - low)[::4, ::4][valid[::4, ::4]])) if valid[::4, ::4].any() else np.inf
    places = np.nonzero((low > usual) & valid)
    ground = np.asarray(cv2.erode(low, np.ones((GROUND_PX, GROUND_PX), np.uint8)))
    top, around, least = (part[places].astype(np.float64) for part in (low, usual, ground))
    part = np.where(top - around > ABOVE_NOISE * noise, (top - around) / np.maximum(top - least, 1e-30), 0.0)
    return places, part
