"""Pixels of pictures and pages, without matplotlib: small pictures, the colours of a mask, a plane reduced.

A picture in a page is grey or tint and encoded as an address that is the picture itself.  The colours of a mask
are the same in every picture, table and page.  Of a correction map a picture of the plane needs a few megabytes of
two hundred (`ShownPlane`).
"""

import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.maps.correction_map import CorrectionMap
from correction.node_status import MEANING, NodeStatus

if TYPE_CHECKING:
    from matplotlib.patches import Patch

Colour = tuple[int, int, int]
COLOURS: dict[NodeStatus, Colour] = {
    NodeStatus.RECOVERED: (226, 232, 226),
    NodeStatus.RIM: (56, 66, 92),
    NodeStatus.FOLD: (168, 50, 62),
    NodeStatus.BLOCKED: (40, 40, 40),
    NodeStatus.OUT_OF_FRAME: (150, 156, 168),
    NodeStatus.LOW_MAGNIFICATION: (221, 122, 58),
    NodeStatus.UNSURE: (132, 86, 168),
    NodeStatus.BLURRED: (64, 142, 142),
    NodeStatus.IN_GLASS: (104, 128, 150),
    NodeStatus.UNLISTED: (186, 84, 140),
    NodeStatus.UNCONFIRMED: (196, 168, 74),
    NodeStatus.LEFT_OUT: (118, 110, 98),
    NodeStatus.DARK: (28, 24, 46),
    NodeStatus.OVERLIT: (250, 226, 120),
    NodeStatus.EDGE: (78, 104, 84),
}
THROUGH: Colour = (176, 208, 231)  # recovered, and seen through glass
_PALETTE = np.array([COLOURS[status] for status in NodeStatus], np.uint8)


def mask_picture(status: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """RGB picture (H, W, 3) of a mask (H, W)."""
    return np.take(_PALETTE, status, axis=0)


def web(colour: Colour) -> str:
    """Return a colour as pages and drawings write it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def swatch(status: NodeStatus) -> "Patch":
    """Entry of a legend."""
    from matplotlib.patches import Patch

    return Patch(facecolor=web(COLOURS[status]), edgecolor="#d9dee8", label=MEANING[status])


WIDEST_PX = 1008  # the full frames are files beside the page
GAMMA = 0.6  # particles are few and small: shown as recorded, a reduced picture of them is black


def grey(frame: NDArray[Any], limits: tuple[float, float]) -> NDArray[np.uint8]:
    """8-bit picture of a frame between two grey levels, brightened for the eye; NaN is the darker one."""
    low, high = limits
    scaled = (np.nan_to_num(frame.astype(np.float32), nan=low) - low) / max(high - low, 1e-9)
    return np.asarray(255.0 * np.clip(scaled, 0.0, 1.0) ** GAMMA, dtype=np.uint8)


def tint(picture: NDArray[np.uint8], status: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """RGB picture of a grey one (H, W): in the colours of a mask (H, W) where nothing is recovered."""
    import cv2

    rgb = cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB)
    lost = (status != NodeStatus.RECOVERED).astype(np.uint8)
    return np.asarray(cv2.copyTo(mask_picture(status), lost, rgb), dtype=np.uint8)


def shrink(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture that is at most WIDEST_PX wide; what is left out is averaged."""
    import cv2

    height, width = image.shape[:2]
    if width <= WIDEST_PX:
        return image
    size = (WIDEST_PX, max(1, round(height * WIDEST_PX / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def data_address(image: NDArray[np.uint8]) -> str:
    """Data address of a picture, grey (H, W) or RGB (H, W, 3), reduced to WIDEST_PX."""
    import cv2

    image = shrink(image)
    if image.ndim == 3:
        image = np.ascontiguousarray(image[..., ::-1])
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


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
