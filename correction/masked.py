"""Leave out what the calibration could not confirm: `tracer.masked`, said by the scene, node by node of a map."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from correction.correction_map import CorrectionMap
from correction.node_status import NodeStatus
from tracer.masked import UNCONFIRMED, UNLISTED, MaskedPart
from tracer.ray_map import RayMap
from tracer.scene import Scene

STATUS = {UNLISTED: NodeStatus.UNLISTED, UNCONFIRMED: NodeStatus.UNCONFIRMED}


def without_masked(found: CorrectionMap, scene: Scene, times: int = 1) -> CorrectionMap:
    """Return the map without its nodes in masked parts of the scene's view; the same map where there are none.

    Parameters
    ----------
    found : CorrectionMap
        A node is left out if any view of it that is used lies in a masked part.
    scene : Scene
        As seen by the map.
    times : int
        The map's camera is so many times coarser than that of the masked parts.
    """
    if not scene.masked:
        return found
    status = found.status.copy()
    width, height = found.sensor_px
    used = found.weight > 0.0
    u, v = np.moveaxis(np.rint(np.where(used[..., None], found.pixel, 0.0)).astype(np.int64), -1, 0)
    for part in scene.masked:
        if part.through:
            numbers = [number for number, names in enumerate(found.branches) if _is(names, part)]
            hit = np.isin(found.branch, numbers)
        else:
            hit = part.within((height, width), times)[v, u]
        status[(hit & used).any(axis=0) & (status == NodeStatus.RECOVERED)] = STATUS[part.why]
    left_out = found.recovered & (status != NodeStatus.RECOVERED)
    return replace(
        found,
        status=status,
        pixel=np.where(left_out[..., None], np.nan, found.pixel),
        weight=np.where(left_out, np.float32(0.0), found.weight),
    )


def masked_pixels(ray_map: RayMap, scene: Scene) -> NDArray[np.bool_]:
    """Pixels (H, W) of a ray map in masked parts of the scene's view."""
    height, width = ray_map.status.shape
    masked = np.zeros((height, width), np.bool_)
    for part in scene.masked:
        numbers = [number for number, names in enumerate(ray_map.branches) if _is(names, part)]
        masked |= np.isin(ray_map.branch, numbers) if part.through else part.within((height, width))
    return masked


def _is(names: tuple[str, ...], part: MaskedPart) -> bool:
    return tuple(names) == part.through
