"""Scenes as the kernels take them, with a grid of cells where spheres are many (``tracer.kernels.bed``)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracer.harmonics import largest_mm, row_of
from tracer.kernels.ball import SHAPE_NUMBERS
from tracer.kernels.bed import GROW
from tracer.kernels.rooms import ONE_ROOM, Rooms
from tracer.kernels.sphere import RADIUS
from tracer.kernels.world import World
from tracer.scene.scene import Scene

CELLS_PER_SPHERE = 4.0  # twice as many cells or half as many cost more
FEW = 8  # up to here it is quicker to ask every sphere

Cells = tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]
NO_CELLS: Cells = np.zeros(7), np.zeros(1, np.int32), np.empty(0, np.int32)


def world_of(scene: Scene) -> World:
    """Bodies of a scene as the kernels take them."""
    return world_from(scene.sphere_table(), scene.other_tables(), scene.rooms(), scene.shapes())


def world_from(
    spheres: NDArray[np.float64],
    others: tuple[Any, ...] = (),
    rooms: Rooms = ONE_ROOM,
    shapes: Mapping[int, NDArray[np.float64]] | None = None,
) -> World:
    """The same for bare tables; shapes (45,) [mm] by the spheres' numbers, as `Scene.shapes`."""
    if not shapes:
        return World(spheres, *cells_of(spheres), others, rooms)
    around, rows = np.array(spheres), np.zeros((len(spheres), SHAPE_NUMBERS))
    for number, shape in shapes.items():
        rows[number] = row_of(shape, float(spheres[number, RADIUS]))
        around[number, RADIUS] += largest_mm(shape)
    return World(around, *NO_CELLS, others, rooms, shapes=(rows,))


def cells_of(spheres: NDArray[np.float64]) -> Cells:
    """Grid for a sphere table (N, 6) of many, an empty one for few."""
    return sort_into_cells(spheres) if len(spheres) > FEW else NO_CELLS


def sort_into_cells(spheres: NDArray[np.float64]) -> Cells:
    """Grid for a sphere table (N, 6), N > 0: frame, begin, items."""
    centre, radius = spheres[:, :3], spheres[:, 3:4]
    low, high = (centre - radius).min(axis=0), (centre + radius).max(axis=0)
    extent = high - low
    side = float((extent.prod() / (CELLS_PER_SPHERE * len(spheres))) ** (1.0 / 3.0))
    side = max(side, float(extent.max()) / 256.0)
    low = low - GROW * side
    count = np.maximum(1, np.ceil((high + GROW * side - low) / side)).astype(np.int64)
    first = np.floor((centre - radius - low) / side - GROW).astype(np.int64).clip(0, count - 1)
    last = np.floor((centre + radius - low) / side + GROW).astype(np.int64).clip(0, count - 1)
    size = last - first + 1
    boxes = size.prod(axis=1)  # cells in the box around each sphere, of which those it reaches into are kept
    which = np.repeat(np.arange(len(spheres)), boxes)
    step = np.arange(len(which)) - np.repeat(np.cumsum(boxes) - boxes, boxes)
    across, up = size[which, 0], size[which, 1]
    place = first[which] + np.stack((step % across, step // across % up, step // (across * up)), axis=-1)
    away = np.abs(low + (place + 0.5) * side - centre[which]) - 0.5 * side
    near = np.linalg.norm(np.maximum(away, 0.0), axis=1) <= radius[which, 0] + GROW * side
    cell, item = place[near] @ np.array([1, count[0], count[0] * count[1]]), which[near]
    order = np.lexsort((item, cell))
    begin = np.searchsorted(cell[order], np.arange(count.prod() + 1)).astype(np.int32)
    return np.array([*low, side, *count], dtype=np.float64), begin, item[order].astype(np.int32)
