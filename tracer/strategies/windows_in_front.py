"""When and how a whole sensor is traced through windows in front of everything (``tracer.kernels.windowed``).

It serves what `lockstep` does, a few solid transparent spheres, with windows between them and the camera: spheres
in a furnace, a bed in a tank of liquid.  More of them, opaque or thinner ones go in bundles
(``tracer.strategies.beds``), and everything else with walls goes through ``march``, pixel by pixel.  All give the
same map to rounding; tests hold them together.
"""

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from tracer.bodies.window import ROW, Windows
from tracer.kernels.apparent import FACE
from tracer.kernels.chain import LANES, VECTOR
from tracer.kernels.rooms import OUTERMOST
from tracer.kernels.sphere import SOLID
from tracer.kernels.windowed import WindowScratch, windowed_rows
from tracer.scene.scene import Scene
from tracer.strategies.branches import Branch, Numbers, chain_branches
from tracer.strategies.lockstep import (
    ALL_SKIPS,
    MAX_CHAIN,
    NO_MIRRORS,
    SKIP_MIRRORED,
    find_mirrors,
    name_unknown,
    pack_chain,
    row_scratch,
)
from tracer.strategies.trace import pack_camera

NO_WINDOWS = np.empty((0, len(ROW)))
STEEPEST = 0.12  # square of the cosine in a medium, and cosine before, of a ray that is called usual


def windows_before(scene: Scene) -> NDArray[np.float64] | None:
    """Rows (K, 10) of the windows from the camera on, if all spheres stand behind all of them; else None."""
    tables = scene.other_tables()
    if not tables:
        return NO_WINDOWS
    if len(tables) != 1 or not isinstance(tables[0], Windows):
        return None
    spheres = len(scene.sphere_table())
    rooms, rows = scene.rooms(), tables[0].rows
    room, order, homes = rooms.first, [], rooms.home[spheres:]
    while len(here := np.flatnonzero(homes == room)) == 1:
        order.append(int(here[0]))
        room = int(rooms.inside[here[0]])
    if rooms.first != OUTERMOST or len(order) != len(rows) or (rooms.home[:spheres] != room).any():
        return None
    return np.asarray(rows[order])


def usual_windows(scene: Scene) -> NDArray[np.float64] | None:
    """Rows (K, 10) as `windows_before`, none without walls; None unless every ray enters each above the plane.

    Asked of a grid of pixels, each for itself and a bit more.
    """
    if scene.arrangement.is_one_room:
        return NO_WINDOWS
    windows = windows_before(scene)
    if windows is None:
        return None
    width, height = scene.camera.sensor_px
    pixels = np.stack(np.meshgrid(np.linspace(0, width - 1, 65), np.linspace(0, height - 1, 65)), axis=-1)
    ray, place = scene.camera.directions(pixels), np.array(scene.camera.position_mm)
    for row in windows:
        normal, n, behind = row[3:6], row[7], row[8]
        slope = -(ray @ normal)
        entry = place + (((place - row[:3]) @ normal) / slope)[..., None] * ray
        room = 1.0 - (1.0 - slope**2) / np.array((n, behind))[:, None, None] ** 2
        if not (slope.min() > STEEPEST and room.min() > STEEPEST and entry[..., 2].min() > 3.0 * row[6]):
            return None
        ray = (ray + (slope - np.sqrt(behind**2 - 1.0 + slope**2))[..., None] * normal) / behind
        place = entry - row[6] * normal
    return windows


def windows_in_front(scene: Scene) -> NDArray[np.float64] | None:
    """Rows of the windows from the camera on, if there are any and a scene can be traced so; else None."""
    table, windows = scene.sphere_table(), windows_before(scene)
    if windows is None or not len(windows) or scene.shapes() or len(table) > MAX_CHAIN:
        return None
    if table.shape[1] != SOLID or table[:, 5].any() or (table[:, 4] < 1.0).any():
        return None
    return windows


def trace_windows(
    scene: Scene,
    windows: NDArray[np.float64],
    plane: NDArray[np.float64 | np.float32],
    status: NDArray[np.uint8],
    branch: Numbers,
    skips: int = ALL_SKIPS,
) -> tuple[Branch, ...]:
    """Trace every pixel into plane (H, W, 2), status (H, W) and branch (H, W); return the branches.

    `skips` says what may be passed over without a look: the result is the same to rounding for any.
    """
    height, width = status.shape
    camera, balls, flat = pack_camera(scene.camera), pack_chain(scene), scene.camera.lens.is_ideal
    mirrors = find_mirrors(scene, windows)
    paired = len(mirrors.swap_x) + len(mirrors.swap_y) > 0
    if not skips & SKIP_MIRRORED:
        mirrors = NO_MIRRORS
    point, unknown = plane.reshape(height, 2 * width), np.zeros(height, np.int64)

    def work(first: int, last: int) -> None:
        beside = WindowScratch(
            np.empty(LANES + VECTOR, np.int64),
            np.empty(4),
            np.empty((2 * len(windows), FACE)),
            np.empty((len(balls), 4)),
        )
        scratch = row_scratch(width, len(balls))
        windowed_rows(
            camera, balls, windows, flat, paired, skips, mirrors, first, last, scratch, beside,
            unknown, point, status, branch,
        )  # fmt: skip

    run_rows(work, (height + 1) // 2 if mirrors.in_y else height)
    branches = chain_branches(scene)
    name_unknown(scene, np.nonzero(unknown)[0], branches, plane, status, branch)
    return tuple(branches)
