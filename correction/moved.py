"""Invert again only what a moved sphere touches.

Two ray maps, before and after, say which pixels' rays changed.  A node is asked again if

* the sphere's shadow, in its old or its new place, falls on it: it is seen directly, or no longer;
* a pixel that has changed, or whose neighbours' neighbours have, gave it a start before or gives it one now.

Every other node has the same starts on the same rays, hence the same views, and keeps its numbers.  Those asked
go through the inversion of the whole map, which meets the others as nodes that nothing can improve.

Limit: a sphere that shows less than two pixels wide, where it stands or through other glass, can hide between
pixel centres; then only the rays of pixels, not those between them, are known to miss it.  And where two pieces
of one sheet code show the same node and the change joins them elsewhere, a map made anew may keep another of the
two views than this one, both valid.
"""

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from correction.correction_map import (
    MAX_MAGNIFICATION,
    MIN_MAGNIFICATION,
    CorrectionMap,
    build_correction_map,
)
from correction.inversion import Inversion
from correction.kernels.moved import changed_rows, mark_footprints, mark_shadows, take_nodes, widen_rows
from tracer.lockstep import sphere_discs
from tracer.ray_map import RayMap
from tracer.rows import run_rows
from tracer.scene import Scene
from tracer.trace import Branch, pack_camera

Numbered = TypeVar("Numbered", RayMap, CorrectionMap)


def invert_again(
    earlier: CorrectionMap,
    before: Scene,
    rays_before: RayMap,
    scene: Scene,
    rays: RayMap,
    *,
    min_magnification: float = MIN_MAGNIFICATION,
    max_magnification: float = MAX_MAGNIFICATION,
    spare: CorrectionMap | None = None,
) -> CorrectionMap:
    """Correction map of a scene from the map of another that differs in some spheres.

    Parameters
    ----------
    earlier : CorrectionMap
        Map of `before`; its arrays are written again, so that it is worth nothing afterwards.
    before, scene : Scene
        The scene it was made for, and the one wanted.
    rays_before, rays : RayMap
        Their ray maps, in arrays of their own (copy the earlier one before ``tracer.retrace`` writes on it).
    min_magnification, max_magnification : float
        Limits of the local magnification with which `earlier` was made.
    spare : CorrectionMap, optional
        A map of the same size whose arrays serve on the way: memory that needs not be found.

    Returns
    -------
    CorrectionMap
        As `build_correction_map` gives; made anew as a whole where more than spheres differ.

    Raises
    ------
    StaleMap
        A map belongs to another scene.
    """
    earlier.check(before)
    rays_before.check(before)
    rays.check(scene)
    limits = (min_magnification, max_magnification)
    same = rays.branch.dtype == rays_before.branch.dtype == earlier.branch.dtype
    if not (same and scene.camera == before.camera and np.array_equal(scene.rod_table(), before.rod_table())):
        return build_correction_map(
            scene,
            rays,
            earlier.grid,
            layers=earlier.layers,
            min_magnification=min_magnification,
            max_magnification=max_magnification,
            out=earlier,
        )
    arrays = None if spare is None else spare.arrays()
    work = Inversion(scene, rays, earlier.grid, earlier.layers, limits, arrays, skip=True)
    rays_before, earlier = _renumbered(rays_before, rays.branches), _renumbered(earlier, rays.branches)
    asked = _touched(work, before, rays_before) > 0
    work.ask(asked)
    work.direct()
    work.glass()
    work.join()
    fresh, kept = work.maps, tuple(earlier.arrays().values())
    run_rows(lambda first, last: take_nodes(asked, first, last, fresh, kept), len(asked))
    return replace(earlier, branches=rays.branches, scene_hash=rays.scene_hash)


def _renumbered(made: Numbered, branches: tuple[Branch, ...]) -> Numbered:
    """The map with the numbers of other branches; one that is not among them gets a number that no pixel has."""
    if made.branches == branches:
        return made
    numbers = {names: number for number, names in enumerate(branches)}
    nobody = np.iinfo(made.branch.dtype).max
    lookup = np.array([numbers.get(names, nobody) for names in made.branches], made.branch.dtype)
    return replace(made, branch=lookup[made.branch], branches=branches)


def _touched(work: Inversion, before: Scene, rays_before: RayMap) -> NDArray[np.uint8]:
    """Nodes (h, w) to ask again: 1."""
    old, rays, scene = rays_before, work.ray_map, work.scene
    height, width = rays.status.shape
    dirty = np.zeros(work.grid.shape, np.uint8)
    gone, come = _differing(before.sphere_table(), scene.sphere_table())
    discs, place = sphere_discs(np.concatenate((gone, come))), work.node_camera()
    columns = (np.arange(work.grid.shape[1], dtype=np.float64) - place[13]) / place[12]

    def shade(first: int, last: int) -> None:
        mark_shadows(place, discs, first, last, columns.copy(), np.empty(len(columns)), dirty)

    run_rows(shade, len(dirty))
    point, point_2 = (plane.reshape(height, 2 * width) for plane in (old.plane_mm, rays.plane_mm))
    bits, bits_2 = point.view(np.int64), point_2.view(np.int64)
    changed, near = np.empty((height, width), np.uint8), np.empty((height, width), np.uint8)

    def compare(first: int, last: int) -> None:
        numbers = (old.branch, rays.branch, old.status, rays.status)
        changed_rows(bits, bits_2, *numbers, first, last, changed)

    run_rows(compare, height)
    run_rows(lambda first, last: widen_rows(changed, first, last, near), height)
    for where, seen in ((before, old), (scene, rays)):
        _mark(work, where, seen, near, dirty)
    return dirty


def _mark(work: Inversion, scene: Scene, rays: RayMap, near: NDArray[np.uint8], dirty: NDArray[np.uint8]) -> None:
    """Mark the nodes to which the pixels of `near` (H, W) can give a start in one of the maps."""
    height, width = near.shape
    plane, limit, grid = rays.plane_mm.reshape(height, 2 * width), work.longest, work.grid_numbers
    tables = (pack_camera(scene.camera), scene.sphere_table(), scene.rod_table())

    def mark(first: int, last: int) -> None:
        mark_footprints(near, plane, rays.branch, rays.status, tables, limit, grid, first, last, dirty)

    run_rows(mark, height)


def _differing(one: NDArray[np.float64], other: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Rows of each table that the other lacks."""
    known = [{row.tobytes() for row in table} for table in (one, other)]
    return tuple(
        np.ascontiguousarray([row for row in table if row.tobytes() not in lacks]).reshape(-1, table.shape[1])
        for table, lacks in ((one, known[1]), (other, known[0]))
    )
