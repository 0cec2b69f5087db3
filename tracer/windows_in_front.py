"""When and how a whole sensor is traced through windows in front of everything (``tracer.kernels.windowed``).

It serves what `lockstep` does, a few solid transparent spheres, with windows between them and the camera: spheres
in a furnace, a bed in a tank of liquid.  Everything else with walls goes through ``march``, pixel by pixel.  Both
give the same map to rounding; a test holds them together.
"""

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from tracer.bodies.window import Windows
from tracer.branches import Branch, Numbers, chain_branches
from tracer.kernels.chain import LANES, VECTOR
from tracer.kernels.rooms import OUTERMOST
from tracer.kernels.sphere import SOLID
from tracer.kernels.windowed import windowed_rows
from tracer.lockstep import MAX_CHAIN, name_unknown, pack_chain, row_scratch
from tracer.scene import Scene
from tracer.trace import pack_camera


def windows_in_front(scene: Scene) -> NDArray[np.float64] | None:
    """Rows of the windows from the camera on, if a scene can be traced so; else None."""
    tables, table = scene.other_tables(), scene.sphere_table()
    if len(tables) != 1 or not isinstance(tables[0], Windows) or scene.shapes():
        return None
    if (
        not 1 <= len(table) <= MAX_CHAIN
        or table.shape[1] != SOLID
        or table[:, 5].any()
        or (table[:, 4] < 1.0).any()
    ):
        return None
    rooms, rows = scene.rooms(), tables[0].rows
    room, order, homes = rooms.first, [], rooms.home[len(table) :]
    while len(here := np.flatnonzero(homes == room)) == 1:
        order.append(int(here[0]))
        room = int(rooms.inside[here[0]])
    if rooms.first != OUTERMOST or len(order) != len(rows) or (rooms.home[: len(table)] != room).any():
        return None
    return np.asarray(rows[order])


def trace_windows(
    scene: Scene,
    windows: NDArray[np.float64],
    plane: NDArray[np.float64 | np.float32],
    status: NDArray[np.uint8],
    branch: Numbers,
) -> tuple[Branch, ...]:
    """Trace every pixel into plane (H, W, 2), status (H, W) and branch (H, W); return the branches."""
    height, width = status.shape
    camera, balls, flat = pack_camera(scene.camera), pack_chain(scene), scene.camera.lens.is_ideal
    point, unknown = plane.reshape(height, 2 * width), np.zeros(height, np.int64)

    def work(first: int, last: int) -> None:
        scratch, fates = row_scratch(width, len(balls)), np.empty(LANES + VECTOR, np.int64)
        windowed_rows(camera, balls, windows, flat, first, last, scratch, fates, unknown, point, status, branch)

    run_rows(work, height)
    branches = chain_branches(scene)
    name_unknown(scene, np.nonzero(unknown)[0], branches, plane, status, branch)
    return tuple(branches)
