"""Pictures on their way to a browser: cut to what is looked at, and small enough to be sent ten times a second.

Particles do not compress, so pixels are sent raw, 16 bits each; contrast is made where it is looked at.  A picture
larger than what the viewer has room for is averaged over blocks, but a block with a saturated pixel stays
saturated: what must be seen is never averaged away.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

LEAST_PX, LARGEST_PX = 64, 1008  # side of what is sent
SATURATED = 65535  # as sent
NOTHING = 0  # as sent: nothing is recovered here
DARK, BRIGHT = 1.0, 99.7  # percentiles of a still frame that is shown from black to white
# magic, number, left, top, width, height, pixels a pixel, columns, name
HEAD = struct.Struct("<4sIIIHHfHH16s")


@dataclass(frozen=True)
class Part:
    """Part of a picture that a viewer looks at: a square of `size_px` pixels from (left, top); 0 is all of it."""

    left_px: int = 0
    top_px: int = 0
    size_px: int = 0

    @classmethod
    def of(cls, asked: object) -> "Part":
        """Part that a viewer has asked for; all of it for anything else."""
        if isinstance(asked, list) and len(asked) == 3 and all(type(number) is int for number in asked):
            left, top, size = (min(max(number, 0), 1_000_000) for number in asked)
            return cls(left, top, size)
        return cls()


Columns = tuple[float, float]  # shares of a part's width that are seen, from and to
EVERY: Columns = (0.0, 1.0)


def columns_of(asked: object) -> Columns:
    """Columns that a viewer has asked for; all of them for anything else."""
    if isinstance(asked, list) and len(asked) == 2 and all(type(share) in (int, float) for share in asked):
        low, high = (round(float(min(max(share, 0.0), 1.0)), 2) for share in asked)
        return (low, high) if low < high else EVERY
    return EVERY


def room_px(asked: object) -> int:
    """Side of a picture for which a viewer has room, as it says; the largest for anything else."""
    return min(max(asked, LEAST_PX), LARGEST_PX) if type(asked) is int else LARGEST_PX


def picture_bytes(
    name: str,
    number: int,
    pixels: NDArray[Any],
    white: int,
    part: Part,
    room: int = LARGEST_PX,
    columns: Columns = EVERY,
) -> bytes:
    """Bytes of one picture: `HEAD` and uint16 pixels, row by row.

    The head has the part's size in blocks, and which of its columns follow.

    Parameters
    ----------
    name : str
        Which picture.
    number : int
        Of the snapshot.
    pixels : (H, W) uint16 or float32
        NaN is sent as NOTHING.
    white : int
        Value of a saturated pixel.
    part : Part
        What is looked at.
    room : int
        Side [px] of the picture for which there is room; blocks are whole, so it is met to about a third.
    columns : (float, float)
        Share of the part's width that is seen.
    """
    height, width = pixels.shape
    left, top = min(part.left_px, max(width - 1, 0)), min(part.top_px, max(height - 1, 0))
    size = part.size_px or max(height, width)
    cut = pixels[top : top + size, left : left + size]
    side = max(cut.shape)
    block = max(1, round(side / room), -(-side // LARGEST_PX))
    wide, high = cut.shape[1] // block, cut.shape[0] // block
    first = min(int(columns[0] * wide), max(wide - 1, 0))
    cut = cut[:, first * block : max(math.ceil(columns[1] * wide), first + 1) * block]
    small = _means(cut, block)
    values: NDArray[np.uint16]
    if pixels.dtype.kind == "u":
        values = np.minimum(small, SATURATED - 2) + np.uint16(1)
        brightest = float(cut.max(initial=0))
    else:
        grey = np.fmax(small + np.float32(1.0), np.float32(1.0))  # of a number and NaN the number
        values = np.minimum(grey, np.float32(SATURATED - 1.0), out=grey).astype("<u2")
        values[np.isnan(small)] = NOTHING
        brightest = float(np.fmax.reduce(cut, axis=None, initial=0.0))
    if brightest >= white:
        values[_any(cut >= white, block)] = SATURATED
    follow = first, values.shape[1]
    head = HEAD.pack(b"rtp2", number, left, top, wide, high, float(block), *follow, name.encode()[:16])
    return b"".join((head, np.ascontiguousarray(values).data.cast("B")))


def _means(pixels: NDArray[Any], block: int) -> NDArray[Any]:
    """Means over blocks, NaN where one of them is; a rest at the right and the bottom is left out."""
    if block == 1:
        return pixels
    height, width = (side // block for side in pixels.shape)
    whole = pixels[: height * block, : width * block]  # OpenCV reads rows where they lie
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


def _any(marked: NDArray[np.bool_], block: int) -> NDArray[np.bool_]:
    """Blocks with a marked pixel."""
    height, width = (side // block for side in marked.shape)
    found = np.zeros((height, width), dtype=np.bool_)
    for down in range(block):
        for right in range(block):
            found |= marked[down : height * block : block, right : width * block : block]
    return found


def white_of(words: Mapping[str, Any]) -> int:
    """Value of a saturated pixel, from the bits that the camera says; corrected pixels have the camera's."""
    bits = words.get("bits")
    return (1 << bits) - 1 if isinstance(bits, int) and 1 <= bits <= 16 else SATURATED


def grey_bytes(frame: NDArray[Any]) -> bytes:
    """Still frame (H, W) from black to white, one byte a pixel, row by row; black where it is NaN."""
    grey = frame.astype(np.float32)
    low, high = np.nanpercentile(grey, (DARK, BRIGHT)) if np.isfinite(grey).any() else (0.0, 1.0)
    scaled = (np.nan_to_num(grey, nan=low) - low) * (255.0 / max(high - low, 1e-9))
    shown: NDArray[np.uint8] = np.clip(scaled, 0.0, 255.0).astype(np.uint8)
    return shown.tobytes()
