"""Rays through a scene, each by itself, with everything that is known about it.

The scene goes to the kernels as numbers: its camera (`pack_camera`) and its bodies (`world_of`), with a grid of
cells where spheres are many (``tracer.kernels.world``).  What comes back names the branch of a ray by a key, a
hash of what it met; one ray of each key is traced once more to find the names (`name_keys`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ground.rows import run_rows
from ground.short_repr import short_repr
from tracer.bodies.rod import Rods
from tracer.camera import Camera
from tracer.harmonics import largest_mm, row_of
from tracer.kernels.ball import SHAPE_NUMBERS
from tracer.kernels.branches import DIRECT
from tracer.kernels.rays import MAX_EVENTS, trace_rays, trace_trails
from tracer.kernels.rooms import ONE_ROOM, Rooms
from tracer.kernels.sphere import RADIUS
from tracer.kernels.world import GROW, World
from tracer.scene.scene import Scene
from tracer.strategies.branches import SHORT_NUMBERS, Branch, Numbers

CELLS_PER_SPHERE = 4.0  # twice as many cells or half as many cost more
FEW = 8  # up to here it is quicker to ask every sphere
Cells = tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]
NO_CELLS: Cells = np.zeros(7), np.zeros(1, np.int32), np.empty(0, np.int32)
# Of spheres alone: kernels are compiled once for balls that stand on rods and for those that do not
NO_RODS = (Rods(np.empty((0, 7))),)
RAY = np.dtype(
    [
        ("status", np.uint8),  # RayStatus
        ("events", np.int32),  # spheres crossed
        ("key", np.int64),  # hash of the sequence of spheres crossed, and of the ways through their cores
        ("x_mm", np.float64),  # plane point
        ("y_mm", np.float64),
        ("path_mm", np.float64),  # optical path from the start to the plane
        ("transmittance", np.float64),  # Fresnel, unpolarised
        ("direction", np.float64, (3,)),  # unit direction of the last straight piece
    ],
    align=True,
)


class RayStatus(IntEnum):
    """Fate of a ray; coordinates are NaN unless it is RECOVERED."""

    RECOVERED = 0  # reached the investigation plane
    BLOCKED = 1  # stopped by an opaque body
    TIR = 2  # totally reflected at a body of lower index
    MISSED_PLANE = 3  # left the bodies level or away from the plane
    TOO_MANY_EVENTS = 4  # met more bodies than tracer.kernels.rays.MAX_EVENTS
    IN_GLASS = 5  # was inside a body where it reached the investigation plane
    EDGE = 8  # met an edge between flat faces


def world_of(scene: Scene) -> World:
    """Bodies of a scene as the kernels take them; rays end at the investigation plane."""
    world = world_from(scene.sphere_table(), scene.other_tables(), scene.rooms(), scene.shapes())
    return world._replace(is_crossed=bool(scene.spheres_in_plane))


def world_from(
    spheres: NDArray[np.float64],
    others: tuple[Any, ...] = (),
    rooms: Rooms = ONE_ROOM,
    shapes: Mapping[int, NDArray[np.float64]] | None = None,
) -> World:
    """The same for bare tables, and rays end behind all bodies; shapes (45,) [mm] by number, as `Scene.shapes`."""
    others = others or NO_RODS
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
    centre = spheres[:, :3]
    radius = np.abs(spheres[:, 3:4])  # a fit on its way may try a negative one, of which rays see the square
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


@short_repr
@dataclass(frozen=True)
class TraceResult:
    """Rays traced to the investigation plane.

    Parameters
    ----------
    rays : structured array of dtype RAY
        One record a ray, in the shape asked for; coordinates are NaN unless the status is RECOVERED.
    branches : dict
        Branch key -> names of the spheres crossed, in order, with the way through those that have a core
        (`Sphere.event_name`); () is the direct view.
    """

    rays: NDArray[np.void]
    branches: dict[int, Branch]

    @property
    def plane_mm(self) -> NDArray[np.float64]:
        """Plane points (..., 2) [mm]."""
        return np.stack((self.rays["x_mm"], self.rays["y_mm"]), axis=-1)

    @property
    def recovered(self) -> NDArray[np.bool_]:
        """Rays that reached the plane."""
        return np.asarray(self.rays["status"] == RayStatus.RECOVERED)


def pack_camera(camera: Camera) -> NDArray[np.float64]:
    """Pack a camera for the kernels (20,), see ``tracer.kernels.camera``."""
    return np.array(
        [
            *camera.position_mm,
            *np.ravel(camera.rotation),
            camera.focal_px,
            *camera.principal_px,
            *camera.lens.terms(),
        ]
    )


def trace(scene: Scene, pixels: ArrayLike) -> TraceResult:
    """Trace the rays of acquired pixels to the investigation plane.

    Parameters
    ----------
    scene : Scene
        The scene.
    pixels : array_like (..., 2) float
        Acquired pixels u, v; fractions and pixels off the sensor are allowed.

    Returns
    -------
    TraceResult
        Records of shape (...).
    """
    directions = scene.camera.directions(pixels)
    origins = np.broadcast_to(np.array(scene.camera.position_mm), directions.shape)
    return trace_from(scene, origins, directions)


def trace_from(scene: Scene, origins_mm: ArrayLike, directions: ArrayLike) -> TraceResult:
    """Trace rays from any points outside the bodies.

    Parameters
    ----------
    scene : Scene
        The scene; its camera does not matter here.
    origins_mm : array_like (..., 3)
        Where the rays start.
    directions : array_like (..., 3)
        Unit directions.
    """
    directions = np.asarray(directions, dtype=np.float64)
    shape = directions.shape[:-1]
    starts, rays_along = _rows_of(origins_mm, directions.shape), _rows_of(directions, directions.shape)
    rays = np.zeros(len(rays_along), RAY)
    world = world_of(scene)

    def work(first: int, last: int) -> None:
        trace_rays(starts, rays_along, world, first, last, rays)

    run_rows(work, len(rays), block=16384)
    rays["path_mm"] *= scene.n_ambient
    keys, firsts = np.unique(rays["key"], return_index=True)
    return TraceResult(rays.reshape(shape), name_keys(scene, starts[firsts], rays_along[firsts], keys))


def _rows_of(points: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Points (N, 3) for the kernels, broadcast to a shape, in memory that may be written.

    Numba compiles a kernel once more for arrays that may not, as a broadcast one of a single ray is. Nothing is
    copied that can be passed on.
    """
    given = np.asarray(points, dtype=np.float64)
    wide = given if given.shape == shape else np.broadcast_to(given, shape)
    return np.require(wide, requirements=("C", "W")).reshape(-1, 3)


def name_keys(
    scene: Scene, origins_mm: NDArray[np.float64], directions: NDArray[np.float64], keys: NDArray[np.int64]
) -> dict[int, Branch]:
    """Branches behind keys (N,), from one ray of each: where it starts (N, 3) and its direction (N, 3)."""
    trails = np.full((len(keys), MAX_EVENTS), -1, np.int32)
    trace_trails(origins_mm, directions, world_of(scene), trails)
    names, lengths = scene.event_names(), np.count_nonzero(trails >= 0, axis=1)
    known = trails[:, : lengths.max(initial=0)].tolist()
    return {
        key: tuple(name for event in trail[:length] if (name := scene.event_name(event, names)))
        for key, trail, length in zip(keys.tolist(), known, lengths.tolist(), strict=True)
    }


def number_keys(scene: Scene, key: NDArray[np.int64]) -> tuple[Numbers, tuple[Branch, ...]]:
    """Branch numbers (H, W) of the keys (H, W) of all pixels of a sensor, and the branches they number."""
    fresh = np.ones(key.shape, dtype=bool)  # keys come in long runs: look only where one begins
    fresh[:, 1:] = key[:, 1:] != key[:, :-1]
    rows, columns = np.nonzero(fresh)
    keys, firsts = np.unique(key[rows, columns], return_index=True)
    directions = scene.camera.directions(np.stack((columns[firsts], rows[firsts]), axis=-1))
    origins = _rows_of(scene.camera.position_mm, directions.shape)
    branches = name_keys(scene, origins, directions, keys)
    branches[DIRECT] = ()
    order = sorted(branches, key=lambda k: (len(branches[k]), branches[k]))
    kind = np.uint16 if len(order) <= SHORT_NUMBERS else np.uint32
    lookup = {k: number for number, k in enumerate(order)}
    runs = np.array([lookup[int(k)] for k in key[rows, columns]], dtype=kind)
    return runs[np.cumsum(fresh.ravel()) - 1].reshape(key.shape), tuple(branches[k] for k in order)
