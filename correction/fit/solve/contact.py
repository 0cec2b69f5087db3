"""Bodies may touch, not overlap: a stiff wall for the fit, and an exact push apart at its end.

During the fit an overlap of g > 0 costs (g / WALL_MM)^2, one-sided, so that spheres that really touch may
lean on each other; noise then leaves an overlap well below a micrometre.  A scene with any overlap is
refused, so the last of it is removed by moving each pair apart along its line of centres, and each sphere
up from the plane, until nothing overlaps.  A larger overlap is not removed but is a failed fit: the frames
contradict the scene.
"""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import CONTACT_TOL_MM
from tracer.bodies.shape import reach_mm
from tracer.harmonics import COUNT, values

WALL_MM = 1e-3
ROUNDS = 500
DOWN = (0.0, 0.0, -1.0)


Shapes = Mapping[int, NDArray[np.float64]]
ROUND: Shapes = {}


def walls(
    spheres: NDArray[np.float64], shapes: Shapes = ROUND
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Overlap of every sphere with the plane and of every pair (K,) [mm], negative for a gap.

    Parameters
    ----------
    spheres : (N, 6) float64
        Sphere table.
    shapes : mapping
        Number -> harmonics (45,) [mm] of those U that are out of round: a pair's overlap is that along the line of
        their centres.

    Returns
    -------
    depth_mm : (K,) float64
    rate : (K, N, 5) float64
        Derivatives by x, y, z, radius, n.
    by_shape : (K, 45 U) float64
        Derivatives by the harmonics.
    """
    count = len(spheres)
    pairs = list(combinations(range(count), 2))
    depth, rate = np.zeros(count + len(pairs)), np.zeros((count + len(pairs), count, 5))
    by_shape = np.zeros((len(depth), len(shapes), COUNT))
    place = {number: k for k, number in enumerate(shapes)}
    for i, sphere in enumerate(spheres):
        depth[i] = reach_down_mm(i, sphere, shapes) - sphere[2]
        rate[i, i, 2], rate[i, i, 3] = -1.0, 1.0
        if i in shapes:
            by_shape[i, place[i]] = values(DOWN)
    for k, (i, j) in enumerate(pairs, start=count):
        apart = spheres[j, :3] - spheres[i, :3]
        distance = max(float(np.linalg.norm(apart)), 1e-9)
        depth[k] = spheres[i, 3] + spheres[j, 3] - distance
        rate[k, i, :3], rate[k, j, :3] = apart / distance, -apart / distance
        rate[k, i, 3] = rate[k, j, 3] = 1.0
        for one, towards in ((i, apart / distance), (j, -apart / distance)):
            if one in shapes:
                by_shape[k, place[one]] = values(towards)
                depth[k] += float(by_shape[k, place[one]] @ shapes[one])
    return depth, rate, by_shape.reshape(len(depth), len(shapes) * COUNT)


def reach_down_mm(number: int, sphere: NDArray[np.float64], shapes: Shapes) -> float:
    """How far a sphere of the table, or ball out of round, reaches down from its centre."""
    if number not in shapes:
        return float(sphere[3])
    return reach_mm(float(sphere[3]), tuple((1e3 * shapes[number]).tolist()), -1.0)


def largest_overlap_mm(spheres: NDArray[np.float64], shapes: Shapes = ROUND) -> float:
    """Deepest overlap of two spheres, or of one with the plane [mm]; 0 if there is none."""
    return float(walls(spheres, shapes)[0].max(initial=0.0))


def pushed_apart(
    spheres: NDArray[np.float64], clearance_mm: float = 0.1 * CONTACT_TOL_MM, shapes: Shapes = ROUND
) -> NDArray[np.float64]:
    """Return the sphere table with overlapping spheres moved apart, and up from the plane, just enough.

    Each pair shares its correction; rounds go on until no overlap is left, as a pile may pass it on.
    """
    moved = np.array(spheres)
    reach = [reach_down_mm(number, sphere, shapes) for number, sphere in enumerate(moved)]
    for _ in range(ROUNDS):
        clean = True
        for i, sphere in enumerate(moved):
            if reach[i] > sphere[2]:
                moved[i, 2], clean = reach[i] + clearance_mm, False
        for i, j in combinations(range(len(moved)), 2):
            apart = moved[j, :3] - moved[i, :3]
            distance = float(np.linalg.norm(apart))
            away = apart / distance if distance > 0.0 else np.eye(3)[2]
            depth = moved[i, 3] + moved[j, 3] - distance
            for one, towards in ((i, away), (j, -away)):
                if one in shapes:
                    depth += float(values(towards) @ shapes[one])
            if depth > 0.0:
                step = 0.5 * (depth + clearance_mm) * away
                moved[i, :3] -= step
                moved[j, :3] += step
                clean = False
        if clean:
            break
    return moved
