"""The colours of a mask, the same in every picture, table and page."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

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
}
THROUGH: Colour = (176, 208, 231)  # recovered, and seen through glass
_PALETTE = np.array([COLOURS[status] for status in NodeStatus], np.uint8)


def mask_picture(status: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """RGB picture (H, W, 3) of a mask (H, W)."""
    return np.asarray(_PALETTE[status], dtype=np.uint8)


def covered(status: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """RGB picture (H, W, 3) of what is not recovered; black where a corrected frame shows."""
    return np.where((status == NodeStatus.RECOVERED)[..., None], 0, mask_picture(status)).astype(np.uint8)


def web(colour: Colour) -> str:
    """Return a colour as pages and drawings write it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def swatch(status: NodeStatus) -> "Patch":
    """Entry of a legend."""
    from matplotlib.patches import Patch

    return Patch(facecolor=web(COLOURS[status]), edgecolor="#d9dee8", label=MEANING[status])
