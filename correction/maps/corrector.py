"""The corrector: acquired frame -> frame as if the glass were not there, in one resampling.

Dewarp, crop and correction are all maps of coordinates; they are composed once, and each frame is
interpolated once.  A node whose view is magnified covers several sensor pixels: the corrected value is the
mean over that footprint (one sample a pixel along each side), so no recorded light is thrown away where the
corrected image shrinks the view.  Footprints are symmetric about the node, hence they shift nothing.

What a frame needs is laid out when the corrector is made: a list of samples in order of use and, for the spline,
the tiles of the frame that any of them reads.  A frame then costs in proportion to what is corrected.

Skips, both switched off by ``skip=False``: tiles that no sample reads are not filtered (the result has the same
bits), and a dewarp that moves no pixel by more than `NEGLIGIBLE_PX` is left out (the result moves by no more).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.maps.correction_map import CorrectionMap
from correction.maps.dewarp import Dewarp
from correction.node_status import NodeStatus
from ground.rows import run_rows
from piv.errors import FrameError
from piv.resampling.footprints import Views, lay_footprints
from piv.resampling.kernels.correct import CHUNK, WEIGHTS, correct_rows, to_offset_uint16
from piv.resampling.kernels.lanes import TAPS, WIDE
from piv.resampling.sample import Method, checked_frame, filter_tiles, tile_grid

UINT16_OFFSET = 1024  # room for the negative lobes beside bright particles: clipping them shifts centroids
NEGLIGIBLE_PX = 1e-3  # a tenth of what calibrated glass is good for
MIRRORED_COEFFICIENTS = 2  # mirrored coefficients above and to the left of the frame


class Corrector:
    """Corrects frames of one camera in one scene.

    Parameters
    ----------
    correction_map : CorrectionMap
        Where each node lies on the (ideal, if there is a dewarp) sensor.
    dewarp : Dewarp, optional
        Ideal pixel -> acquired pixel.
    method : {"quintic", "bilinear"}
        Interpolation.
    fill : float
        Value of nodes that cannot be recovered.
    mask : (h, w) bool, optional
        Nodes that are wanted; the others get `fill` and cost nothing.
    skip : bool
        Whether work may be left out whose effect is bounded, see the top of this file.

    Attributes
    ----------
    status : (h, w) uint8
        NodeStatus; nodes that the dewarp moves off the sensor are OUT_OF_FRAME.

    Notes
    -----
    Positions are kept as a pixel and fractions of 1/65535 px, which rounds them by 8e-6 px at most.
    """

    def __init__(
        self,
        correction_map: CorrectionMap,
        dewarp: Dewarp | None = None,
        method: Method = "quintic",
        fill: float = float("nan"),
        mask: NDArray[np.bool_] | None = None,
        skip: bool = True,
    ) -> None:
        self.map, self.dewarp, self.method, self.fill = correction_map, dewarp, method, fill
        self.status = correction_map.status
        views = Views(correction_map.pixel, correction_map.jacobian, correction_map.weight)
        width, height = correction_map.sensor_px
        if dewarp is not None and not (skip and dewarp.largest_shift_px((width, height)) <= NEGLIGIBLE_PX):
            views = _bend_views(correction_map, dewarp)
            lost = (self.status == NodeStatus.RECOVERED) & ~(views.weight > 0.0).any(axis=0)
            self.status = np.where(lost, np.uint8(NodeStatus.OUT_OF_FRAME), self.status)
        self.recovered: NDArray[np.bool_] = self.status == NodeStatus.RECOVERED
        if mask is not None:
            self.recovered &= mask
        margin = (TAPS - 2, WIDE - 2) if method == "quintic" else (0, 0)
        self._memory = (height + margin[0], width + margin[1])
        self._footprints = lay_footprints(views, self.recovered, (width, height), self._memory[1])
        self._tiles = self._footprints.tiles(self._memory) if skip else tile_grid(self._memory).reshape(-1, 4)
        self._spare: list[NDArray[np.float32]] = []

    def __call__(self, frame: NDArray[Any], out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Correct one frame.

        Parameters
        ----------
        frame : ndarray, shape (H, W)
            uint8, uint16 or float32, as acquired.
        out : ndarray of float32, shape of the grid, optional
            Where to put the result.

        Returns
        -------
        ndarray of float32
            Corrected frame; `fill` where nothing can be recovered.

        Raises
        ------
        FrameError
            The frame does not have the sensor's size, or is no frame.
        """
        frame = checked_frame(frame)
        width, height = self.map.sensor_px
        if frame.shape != (height, width):
            raise FrameError(
                f"the frame is {frame.shape[1]} x {frame.shape[0]} px, the scene's camera {width} x {height}; "
                "correct sensor_px in the scene file or give the frames of this camera"
            )
        rows, columns = self.map.grid.shape
        result = np.empty((rows, columns), np.float32) if out is None else out
        quintic, image = self.method == "quintic", frame
        if quintic:
            # One buffer for each thread that corrects at the same time; what no tile covers must be finite.
            image = self._spare.pop() if self._spare else np.zeros(self._memory, np.float32)
            filter_tiles(frame, MIRRORED_COEFFICIENTS, self._tiles, image)
        flat, stride = image.reshape(image.size), image.shape[1]

        def work(first: int, last: int) -> None:
            pixels = np.empty((2, 2 * CHUNK), frame.dtype)
            scratch = np.empty((WEIGHTS, CHUNK), np.float32) if quintic else pixels
            memory = scratch, np.empty(CHUNK, np.float32)
            correct_rows((flat, stride), quintic, self._footprints, self.fill, first, last, memory, result)

        run_rows(work, rows)
        if quintic:
            self._spare.append(image)
        return result


def _bend_views(correction_map: CorrectionMap, dewarp: Dewarp) -> Views:
    """Views on the acquired frame; weight 0 where one is off the sensor."""
    position, jacobian = np.empty_like(correction_map.pixel), np.empty_like(correction_map.jacobian)
    weight = np.empty_like(correction_map.weight)
    right, bottom = correction_map.sensor_px[0] - 1, correction_map.sensor_px[1] - 1

    def work(first: int, last: int) -> None:
        ideal, inner = correction_map.pixel[:, first:last], correction_map.jacobian[:, first:last]
        acquired = dewarp.apply(ideal)
        u, v = acquired[..., 0], acquired[..., 1]
        inside = (u >= 0.0) & (u <= right) & (v >= 0.0) & (v <= bottom)
        part = np.where(inside, correction_map.weight[:, first:last], np.float32(0.0))
        total = part.sum(axis=0)
        weight[:, first:last] = part / np.where(total > 0.0, total, np.float32(1.0))
        position[:, first:last] = acquired
        outer = dewarp.jacobian(ideal).astype(np.float32)
        jacobian[:, first:last] = (outer @ inner.reshape(*inner.shape[:-1], 2, 2)).reshape(inner.shape)

    run_rows(work, position.shape[1])
    return Views(position, jacobian, weight)


def to_uint16(corrected: NDArray[np.float32], offset: int = UINT16_OFFSET) -> tuple[NDArray[np.uint16], int]:
    """Round a corrected frame to uint16, `offset` counts above zero; NaN becomes 0.

    Returns
    -------
    frame : ndarray of uint16
        round(value + offset); 0 marks nodes without a value.
    clipped : int
        Values that did not fit into 1..65535 and were cut.
    """
    values = np.ascontiguousarray(corrected, np.float32)
    stored = np.empty(values.shape, np.uint16)
    clipped = to_offset_uint16(values.ravel(), np.float32(offset), 0, values.size, stored.ravel())
    return stored, int(clipped)
