"""What is masked of a scene (`tracer.masked`), by pixels, branches and nodes.

Every correction map is made without them (`correction.inversion`); outlines in the plane are taken off a map that
is made (`correction.maps`).  Who looks at raw pixels asks `masked_pixels`.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from correction.node_status import NodeStatus
from tracer.masked import LEFT_OUT, UNCONFIRMED, UNLISTED
from tracer.scene.scene import Scene
from tracer.strategies.branches import Branch
from tracer.strategies.ray_map import RayMap

STATUS = {
    UNLISTED: NodeStatus.UNLISTED,
    UNCONFIRMED: NodeStatus.UNCONFIRMED,
    LEFT_OUT: NodeStatus.LEFT_OUT,
}


def masked_pixels(scene: Scene, ray_map: RayMap | None = None) -> NDArray[np.uint8]:
    """Why pixels (H, W) of a scene's camera are masked: a NodeStatus, 0 where they are not.

    Parameters
    ----------
    scene : Scene
        The scene.
    ray_map : RayMap, optional
        Its ray map; without it only outlines are drawn.
    """
    why = np.zeros(scene.camera.shape, np.uint8)
    if ray_map is not None and scene.masked:
        why[:] = masked_branches(scene, ray_map.branches)[ray_map.branch]
    for part in scene.masked:
        why[part.within(why.shape)] = STATUS[part.why]
    return why


def masked_branches(scene: Scene, branches: Sequence[Branch]) -> NDArray[np.uint8]:
    """The same of branches (B,), which are masked as a whole."""
    of_way = {part.through: STATUS[part.why] for part in scene.masked if part.through}
    return np.array([of_way.get(tuple(names), NodeStatus.RECOVERED) for names in branches], np.uint8)
