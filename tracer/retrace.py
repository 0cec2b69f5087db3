"""Re-trace only what a moved body touches.

An earlier map serves again wherever no moved sphere, from its old place or in its new one, can have met the ray:

* the sphere is in the pixel's old branch: traced again;
* its silhouette in the new place holds the pixel: traced again;
* the old ray went through other glass.  Its straight pieces between two spheres lie in the capsule around their
  centres, the last one in the capsule from the last centre to the plane point, as thick as the larger sphere; if
  the sphere in its new place keeps out of all of these, it was not touched.

Every other pixel keeps its number.  What is traced again goes through the kernels of the whole map, so the result
has the bits of a map traced anew.  The investigation plane is no body: what moves on it re-traces nothing.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tracer.kernels.part import retrace_rows
from tracer.lockstep import (
    chain_branches,
    find_mirrors,
    fits_lockstep,
    name_unknown,
    pack_chain,
    row_scratch,
)
from tracer.ray_map import RayMap, build_ray_map
from tracer.rows import run_rows
from tracer.scene import Scene
from tracer.trace import pack_camera

CLEAR, TOUCHED, LOOK = 0.0, 1.0, 2.0
SAFE = 1.0 + 1e-7  # far more than rounding, far less than anybody would mind


def retrace(earlier: RayMap, before: Scene, scene: Scene) -> RayMap:
    """Ray map of a scene from the map of another that differs in some spheres.

    Parameters
    ----------
    earlier : RayMap
        Map of `before`; its arrays are written again, so that it is worth nothing afterwards.
    before, scene : Scene
        The scene it was traced from, and the one wanted.

    Returns
    -------
    RayMap
        Bit for bit what `build_ray_map` gives; traced anew as a whole where more than spheres differ, where they
        change their order from the camera down, or where the scene is none for lockstep.

    Raises
    ------
    StaleMap
        `earlier` is not the map of `before`.
    """
    earlier.check(before)
    if not _comparable(before, scene):
        return build_ray_map(scene, earlier)
    old, balls = pack_chain(before), pack_chain(scene)
    moved = np.nonzero((old != balls).any(axis=1))[0]
    branches = list(earlier.branches)
    if len(moved):
        branches = chain_branches(scene)
        unknown = _trace_again(scene, earlier, old, balls, moved)
        lines = np.nonzero(unknown)[0]
        name_unknown(scene, lines, branches, earlier.plane_mm, earlier.status, earlier.branch)
    return replace(earlier, branches=tuple(branches), scene_hash=scene.content_hash())


def _comparable(before: Scene, scene: Scene) -> bool:
    """Whether only spheres differ, and each is known by its number."""
    return (
        fits_lockstep(before)
        and fits_lockstep(scene)
        and before.camera == scene.camera
        and chain_branches(before) == chain_branches(scene)
        and _pairs(before) == _pairs(scene)
    )


def _pairs(scene: Scene) -> bool:
    mirrors = find_mirrors(scene)
    return len(mirrors.swap_x) + len(mirrors.swap_y) > 0


def _trace_again(
    scene: Scene,
    earlier: RayMap,
    old: NDArray[np.float64],
    balls: NDArray[np.float64],
    moved: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Trace what was touched; the number of pixels a row (H,) without a branch number."""
    height, width = earlier.status.shape
    camera, flat, paired = pack_camera(scene.camera), scene.camera.lens.is_ideal, _pairs(scene)
    legs = np.array([_leg(number, old, balls, moved) for number in range(len(earlier.branches))])
    point, unknown = earlier.plane_mm.reshape(height, 2 * width), np.empty(height, np.int64)

    def work(first: int, last: int) -> None:
        scratch = [np.empty(width, np.uint8), *row_scratch(width, len(balls))]
        arrays = [*scratch, unknown, point, earlier.status, earlier.branch]
        retrace_rows(camera, old, balls, flat, paired, moved, legs, first, last, *arrays)

    run_rows(work, height)
    return unknown


def _leg(
    number: int, old: NDArray[np.float64], balls: NDArray[np.float64], moved: NDArray[np.int64]
) -> tuple[float, ...]:
    """What is known of a branch of the old map, for ``mark_touched``."""
    crossed = [k for k in range(len(old)) if number >> k & 1]
    if number == 0:
        return CLEAR, 0.0, 0.0, 0.0, 0.0
    if number >= 1 << len(old) or np.isin(crossed, moved).any():
        return TOUCHED, 0.0, 0.0, 0.0, 0.0
    for one, other in pairwise(crossed):
        (a, b), thick = old[[one, other], :3], np.sqrt(old[[one, other], 3]).max()
        for k in moved:
            share = np.clip((balls[k, :3] - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            away = np.linalg.norm(balls[k, :3] - a - share * (b - a))
            if away <= SAFE * (thick + np.sqrt(balls[k, 3])):
                return TOUCHED, 0.0, 0.0, 0.0, 0.0
    return LOOK, *old[crossed[-1], :3], float(np.sqrt(old[crossed[-1], 3]))
