"""The samples of all nodes of a corrector; see ``piv.resampling.kernels.footprint``."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from piv.resampling.kernels.footprint import SPAN, lay_rows, mark_tiles
from piv.resampling.kernels.lanes import TAPS, WIDE
from piv.resampling.sample import TILE, tile_grid


class Views(NamedTuple):
    """Places of the nodes on the frame.

    Parameters
    ----------
    position : (K, h, w, 2) float64
        Pixel u, v of each view.
    jacobian : (K, h, w, 4) float32
        d pixel / d node.
    weight : (K, h, w) float32
        Shares; 0 without a view.
    """

    position: NDArray[np.float64]
    jacobian: NDArray[np.float32]
    weight: NDArray[np.float32]


class Footprints(NamedTuple):
    """Samples in order of use.

    Parameters
    ----------
    anchor : (N,) int32
        Flat index of the pixel above and to the left, in rows of `stride` pixels.
    fraction : (N,) uint32
        Its distance in 1/65535 px, u in the lower half, v in the upper.
    begin : (h + 1,) int64
        Spans of row r: from begin[r] to begin[r + 1].
    span : (S, 5) int64
        First column, nodes, samples a node, whether they add to what is there, first sample.
    share : (S,) float32
        Factor of the sum of a node's samples.
    """

    anchor: NDArray[np.int32]
    fraction: NDArray[np.uint32]
    begin: NDArray[np.int64]
    span: NDArray[np.int64]
    share: NDArray[np.float32]

    @property
    def samples(self) -> int:
        """Samples a frame."""
        return len(self.anchor)

    def tiles(self, memory: tuple[int, int]) -> NDArray[np.int64]:
        """Tiles (T, 4) of coefficients of this shape that the spline's samples read."""
        tiles = tile_grid(memory)
        wanted = np.zeros(tiles.shape[:2], np.uint8)
        mark_tiles(memory[1], TAPS, WIDE, *TILE, self.anchor, wanted)
        return tiles[wanted > 0]


def lay_footprints(
    views: Views, recovered: NDArray[np.bool_], sensor_px: tuple[int, int], stride: int
) -> Footprints:
    """Lay out the samples of the nodes in `recovered` (h, w), on a frame in rows of `stride` pixels in memory."""
    rows, size = len(recovered), np.array((*sensor_px, stride), np.int64)
    samples, begin = np.zeros(rows + 1, np.int64), np.zeros(rows + 1, np.int64)

    def lay(store: bool) -> Footprints:
        count, spans = (int(samples[-1]), int(begin[-1])) if store else (0, 0)
        anchor, fraction = np.empty(count, np.int32), np.empty(count, np.uint32)
        span, share = np.empty((spans, SPAN), np.int64), np.empty(spans, np.float32)
        laid = Footprints(anchor, fraction, begin, span, share)
        run_rows(lambda first, last: lay_rows(views, recovered, size, store, first, last, samples, laid), rows)
        return laid

    lay(store=False)
    np.cumsum(samples, out=samples)
    np.cumsum(begin, out=begin)
    return lay(store=True)
