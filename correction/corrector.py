"""The corrector: acquired frame -> frame as if the glass were not there, in one resampling.

Dewarp, crop and correction are all maps of coordinates; they are composed once, and each frame is
interpolated once.  A node whose view is magnified covers several sensor pixels: the corrected value is the
mean over that footprint (one sample a pixel along each side), so no recorded light is thrown away where the
corrected image shrinks the view.  Footprints are symmetric about the node, hence they shift nothing.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.correction_map import CorrectionMap
from correction.dewarp import Dewarp
from correction.errors import FrameError
from correction.kernels.correct import correct_rows
from correction.kernels.store import to_offset_uint16
from correction.node_status import NodeStatus
from correction.resample import Method, checked_frame, prefilter
from tracer.rows import run_rows

UINT16_OFFSET = 1024  # room for the negative lobes beside bright particles: clipping them shifts centroids


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

    Attributes
    ----------
    status : (h, w) uint8
        NodeStatus; nodes that the dewarp moves off the sensor are OUT_OF_FRAME.

    Notes
    -----
    Positions are kept in float32: on a sensor 2016 px wide that rounds by 6e-5 px at most.
    """

    def __init__(
        self,
        correction_map: CorrectionMap,
        dewarp: Dewarp | None = None,
        method: Method = "quintic",
        fill: float = float("nan"),
    ) -> None:
        self.map, self.dewarp, self.method, self.fill = correction_map, dewarp, method, fill
        self.status = correction_map.status
        position: NDArray[np.float64] = correction_map.pixel
        self._jacobian = correction_map.jacobian
        if dewarp is not None:
            self._jacobian = _chain(dewarp.jacobian(position), correction_map.jacobian)
            position = dewarp.apply(position)
            u, v = position[0, ..., 0], position[0, ..., 1]
            width, height = correction_map.sensor_px
            outside = ~((u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1))
            lost = outside & (self.status == NodeStatus.RECOVERED)
            self.status = np.where(lost, np.uint8(NodeStatus.OUT_OF_FRAME), self.status)
        self._position = position.astype(np.float32)

    @property
    def recovered(self) -> NDArray[np.bool_]:
        """Nodes that get a value (h, w)."""
        return np.asarray(self.status == NodeStatus.RECOVERED)

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
        quintic = self.method == "quintic"
        image = prefilter(frame) if quintic else frame
        rows, columns = self.map.grid.shape
        result = np.empty((rows, columns), np.float32) if out is None else out
        maps = (self._position, self._jacobian, self.map.weight, self.status)

        def work(first: int, last: int) -> None:
            correct_rows(image, quintic, *maps, self.fill, first, last, result)

        run_rows(work, rows)
        return result


def _chain(outer: NDArray[np.float64], inner: NDArray[np.float32]) -> NDArray[np.float32]:
    """Jacobian product (..., 2, 2) @ (..., 4) -> (..., 4)."""
    product = outer.astype(np.float32) @ inner.reshape(*inner.shape[:-1], 2, 2)
    return np.asarray(product.reshape(inner.shape), dtype=np.float32)


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
