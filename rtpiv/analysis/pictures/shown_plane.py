"""What a picture of the plane needs of a correction map: a few megabytes of two hundred."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.maps.correction_map import CorrectionMap
from correction.node_status import NodeStatus

MOST_PX = 1000  # along the longer side of a panel: a picture shows no more


@dataclass(frozen=True)
class ShownPlane:
    """Nodes of a map, (h, w) of them, as many as are drawn.

    Parameters
    ----------
    grid : PlaneGrid
        Of the whole map.
    status : (h, w) uint8
        NodeStatus.
    through_glass : (h, w) bool
        Recovered, and seen through glass.
    magnification : (h, w) float32
        Sensor px a corrected px; NaN where nothing is recovered.
    """

    grid: PlaneGrid
    status: NDArray[np.uint8]
    through_glass: NDArray[np.bool_]
    magnification: NDArray[np.float32]

    @staticmethod
    def of(found: CorrectionMap) -> "ShownPlane":
        """Take what is drawn from a map."""
        step = max(1, -(-max(found.grid.shape) // MOST_PX))
        status = np.ascontiguousarray(found.status[::step, ::step])
        smallest, largest = found.magnification(step)
        size = np.where(status == NodeStatus.RECOVERED, np.sqrt(smallest * largest), np.nan)
        return ShownPlane(found.grid, status, np.ascontiguousarray(found.behind_glass[::step, ::step]), size)
