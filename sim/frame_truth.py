"""Frames that say themselves what they show: bits in a corner of the simulated camera's picture.

With ``prints_truth: true`` in the `simulation` section of a bench file, the top left corner of every frame
carries, as dark and bright pixels, what was true when it was exposed: number of the trigger, number of the
exposure, the true position of every axis, and whether anything moved. It goes through crops (of the other
sides), gains, formats of 8 to 16 bits and losses as every pixel does; so a test can ask a frame on a disk what
it REALLY shows, however it was filed.

The block is `WIDTH_PX` wide. Its first row is a comb, bright and dark in turn: what lies halfway between the two
is the threshold for the rest, whatever gain and offset have made of them. Then come, 32 bits a row and the
highest first: the number of axes, a flag (moving) and which world it is, trigger, exposure, one row an axis
(whole um, two's complement), and the CRC-32 of all that.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

WIDTH_PX = 32
MOVING = 1 << 16
WORLD_AT, WORLDS = 17, 1 << 15  # place and number of worlds that can be distinguished
_WORD = np.dtype(">u4")


class NoTruth(ValueError):  # noqa: N818
    """A frame carries no truth that can be read."""


@dataclass(frozen=True)
class FrameTruth:
    """True state of the world while a frame was exposed.

    Parameters
    ----------
    trigger, exposure : int
        Accepted triggers of this camera's life before it; exposures of this world before it.
    true_mm : mapping of str to float
        Where every axis really was, to a um.
    is_moving : bool
        Whether any of them moved.
    world : int
        Which world it is, 0..WORLDS - 1: one that is put up again may count an exposure that another has counted.
    """

    trigger: int
    exposure: int
    true_mm: Mapping[str, float]
    is_moving: bool
    world: int = 0


def height_px(axes: int) -> int:
    """Rows of the block for so many axes."""
    return axes + 5


def with_truth(image: NDArray[np.uint16], truth: FrameTruth, bits: int) -> NDArray[np.uint16]:
    """Return a picture (H, W) with what is true in its corner.

    Raises
    ------
    ValueError
        The picture is smaller than the block.
    """
    rows = height_px(len(truth.true_mm))
    if image.shape[0] < rows or image.shape[1] < WIDTH_PX:
        raise ValueError(f"prints_truth needs a sensor of at least {WIDTH_PX} x {rows} px")
    places_um = [round(at_mm * 1000.0) & 0xFFFFFFFF for at_mm in truth.true_mm.values()]
    first = len(places_um) | (MOVING if truth.is_moving else 0) | truth.world << WORLD_AT
    words = [first, truth.trigger, truth.exposure, *places_um]
    body = np.array(words, _WORD).tobytes()
    body += np.array([crc32(body)], _WORD).tobytes()
    block = np.unpackbits(np.frombuffer(body, np.uint8)).reshape(rows - 1, WIDTH_PX)
    comb = np.arange(1, WIDTH_PX + 1, dtype=np.uint8) % 2
    printed = image.copy()
    printed[:rows, :WIDTH_PX] = np.vstack([comb, block]).astype(np.uint16) * np.uint16((1 << bits) - 1)
    return printed


def truth_of(pixels: NDArray[np.uint16], axes: Sequence[str]) -> FrameTruth:
    """Read what a frame (H, W) says of itself.

    Parameters
    ----------
    pixels : ndarray
        The frame, its top left corner included.
    axes : sequence of str
        Names of the axes as in the bench file, in its order.

    Raises
    ------
    NoTruth
        There is none, it is damaged, or it is that of another bench.
    """
    if pixels.shape[0] < height_px(0) or pixels.shape[1] < WIDTH_PX:
        raise NoTruth("the frame is too small to carry its truth")
    comb = pixels[0, :WIDTH_PX].astype(np.int64)
    bright, dark = comb[0::2].min(), comb[1::2].max()
    if bright <= dark:
        raise NoTruth("the frame carries no truth in its corner")
    body = np.packbits(2 * pixels[1:, :WIDTH_PX].astype(np.int64) > bright + dark).tobytes()
    words = [int(word) for word in np.frombuffer(body, _WORD)]
    count = words[0] & 0xFFFF
    end = height_px(count) - 2  # of what the check code covers, in rows below the comb
    if end >= len(words) or crc32(body[: 4 * end]) != words[end]:
        raise NoTruth("the truth in the frame's corner is damaged, or there is none")
    if count != len(axes):
        raise NoTruth(f"the frame tells of {count} axes, not of {len(axes)}")
    places_mm = [(word - (word >> 31 << 32)) / 1000.0 for word in words[3:end]]
    true_mm = dict(zip(axes, places_mm, strict=True))
    return FrameTruth(words[1], words[2], true_mm, bool(words[0] & MOVING), words[0] >> WORLD_AT)
