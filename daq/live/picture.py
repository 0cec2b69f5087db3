"""Pictures on their way to a browser: cut to what is looked at, and small enough to be sent ten times a second.

Particles do not compress, so pixels are sent raw, 16 bits each; contrast is made where it is looked at.  A picture
larger than the screen is averaged over blocks, but a block with a saturated pixel stays saturated: what must be
seen is never averaged away.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST_PX = 1008  # side of what is sent
SATURATED = 65535  # as sent
NOTHING = 0  # as sent: nothing is recovered here
HEAD = struct.Struct("<4sIIIHHf16s")  # magic, number, left, top, width, height, pixels a pixel, name


@dataclass(frozen=True)
class Part:
    """What a viewer looks at: a square of `size_px` pixels from (left, top); 0 is all of it."""

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


def sent(name: str, number: int, pixels: NDArray[Any], white: int, part: Part) -> bytes:
    """Bytes of one picture: `HEAD` and uint16 pixels, row by row.

    Parameters
    ----------
    name : str
        Which picture.
    number : int
        Of the moment.
    pixels : (H, W) uint16 or float32
        NaN is sent as NOTHING.
    white : int
        Value of a saturated pixel.
    part : Part
        What is looked at.
    """
    height, width = pixels.shape
    left, top = min(part.left_px, max(width - 1, 0)), min(part.top_px, max(height - 1, 0))
    size = part.size_px or max(height, width)
    cut = pixels[top : top + size, left : left + size]
    block = max(1, -(-max(cut.shape) // LARGEST_PX))
    small = _blocks(cut, block)
    with np.errstate(invalid="ignore"):
        bright = _brightest(cut, block) >= white
        known = np.isfinite(small)
        values = np.clip(np.where(known, small, 0.0) + 1.0, 1.0, SATURATED - 1.0).astype("<u2")
    values[~known] = NOTHING
    values[bright] = SATURATED
    head = HEAD.pack(
        b"rtp1", number, left, top, values.shape[1], values.shape[0], float(block), name.encode()[:16]
    )
    return head + values.tobytes()


def _blocks(pixels: NDArray[Any], block: int) -> NDArray[Any]:
    """Means over blocks; a rest at the right and the bottom is left out."""
    if block == 1:
        return pixels
    return np.asarray(_in_blocks(pixels, block).mean(axis=(1, 3), dtype=np.float32))


def _brightest(pixels: NDArray[Any], block: int) -> NDArray[Any]:
    return pixels if block == 1 else np.asarray(_in_blocks(pixels, block).max(axis=(1, 3)))


def _in_blocks(pixels: NDArray[Any], block: int) -> NDArray[Any]:
    height, width = (side // block for side in pixels.shape)
    return pixels[: height * block, : width * block].reshape(height, block, width, block)


def white_of(words: Mapping[str, Any], name: str) -> int:
    """Value of a saturated pixel, from the bits that the camera says; corrected pixels have the camera's."""
    bits = words.get("bits")
    return (1 << bits) - 1 if isinstance(bits, int) and 1 <= bits <= 16 else SATURATED
