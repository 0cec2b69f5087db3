"""Check that a frame with glass is not turned or mirrored against the one of the bare target.

Beside the glass both show the same board, at the same height by the same camera.  Where the frames hardly
agree as they are, and agree once one is turned or mirrored, only the other was: a file flipped by a viewer, or a
setting of the camera that changed in between.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

SHRUNK_PX = 2  # pixels averaged, along either side: noise is less, edges of squares stay
TILE_PX = 24  # of a shrunk frame: where glass is, frames differ anyhow
# Correlation coefficient of tiles that show the same; a lattice that lies elsewhere has less
SAME_TILE_CORRELATION = 0.9
LEAST, CLEARLY = 0.1, 3.0  # share of tiles that are alike once a frame is turned; times that of the frame as it is


def turn_between(bare: NDArray[Any], glass: NDArray[Any]) -> str:
    """Say how a frame (H, W) with glass is turned or mirrored against the bare one; "" where it is not."""
    first, second = _shrunk(bare), _shrunk(glass)
    ways = {
        "": second,
        "is mirrored left to right": second[:, ::-1],
        "is mirrored upside down": second[::-1],
        "is turned by 180 degrees": second[::-1, ::-1],
        "is turned by 90 degrees counterclockwise": np.rot90(second, -1),
        "is turned by 90 degrees clockwise": np.rot90(second),
        "has rows and columns exchanged": second.T,
    }
    alike = {words: _share_alike(first, other) for words, other in ways.items() if other.shape == first.shape}
    best = max(alike, key=lambda words: alike[words])
    return best if alike[best] > max(LEAST, CLEARLY * alike.get("", 0.0)) else ""


def _shrunk(frame: NDArray[Any]) -> NDArray[np.float32]:
    """Average pixels of a frame."""
    import cv2

    height, width = (side // SHRUNK_PX for side in frame.shape)
    return np.asarray(cv2.resize(frame.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA))


def _share_alike(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Share of tiles of two frames that show the same, of those with edges in the first."""
    tiles = []
    for frame in (first, second):
        rows, columns = (side // TILE_PX for side in frame.shape)
        cut = frame[: rows * TILE_PX, : columns * TILE_PX].reshape(rows, TILE_PX, columns, TILE_PX)
        tile = cut.transpose(0, 2, 1, 3).reshape(rows * columns, -1)
        tiles.append(tile - tile.mean(axis=1, keepdims=True))
    power, other = (np.sum(tile * tile, axis=1) for tile in tiles)
    has_edges = power > 0.25 * np.median(power)
    if not has_edges.any():
        return 0.0
    both = np.sum(tiles[0] * tiles[1], axis=1)
    return float(np.mean(both[has_edges] > SAME_TILE_CORRELATION * np.sqrt(power * other)[has_edges]))
