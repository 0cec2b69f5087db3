"""Bodies may touch, not overlap: a stiff wall for the fit, and an exact push apart at its end.

During the fit an overlap of g > 0 costs (g / WALL_MM)^2, one-sided, so that spheres that really touch may
lean on each other; noise then leaves an overlap well below a micrometre.  A scene with any overlap is
refused, so the last of it is removed by moving each pair apart along its line of centres, and each sphere
up from the plane, until nothing overlaps.  A larger overlap is not removed but is a failed fit: the frames
contradict the scene.
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import CONTACT_TOL_MM

WALL_MM = 1e-3
ROUNDS = 500


def walls(spheres: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Overlap of every sphere with the plane and of every pair (K,) [mm], negative for a gap.

    Parameters
    ----------
    spheres : (N, 6) float64
        Sphere table.

    Returns
    -------
    depth_mm : (K,) float64
    rate : (K, N, 5) float64
        Derivatives by x, y, z, radius, n.
    """
    count = len(spheres)
    pairs = list(combinations(range(count), 2))
    depth, rate = np.zeros(count + len(pairs)), np.zeros((count + len(pairs), count, 5))
    for i, sphere in enumerate(spheres):
        depth[i] = sphere[3] - sphere[2]
        rate[i, i, 2], rate[i, i, 3] = -1.0, 1.0
    for k, (i, j) in enumerate(pairs, start=count):
        apart = spheres[j, :3] - spheres[i, :3]
        distance = max(float(np.linalg.norm(apart)), 1e-9)
        depth[k] = spheres[i, 3] + spheres[j, 3] - distance
        rate[k, i, :3], rate[k, j, :3] = apart / distance, -apart / distance
        rate[k, i, 3] = rate[k, j, 3] = 1.0
    return depth, rate


def largest_overlap_mm(spheres: NDArray[np.float64]) -> float:
    """Deepest overlap of two spheres, or of one with the plane [mm]; 0 if there is none."""
    return float(walls(spheres)[0].max(initial=0.0))


def pushed_apart(spheres: NDArray[np.float64], clearance_mm: float = 0.1 * CONTACT_TOL_MM) -> NDArray[np.float64]:
    """Return the sphere table with overlapping spheres moved apart, and up from the plane, just enough.

    Each pair shares its correction; rounds go on until no overlap is left, as a pile may pass it on.
    """
    moved = np.array(spheres)
    for _ in range(ROUNDS):
        clean = True
        for i, sphere in enumerate(moved):
            if sphere[3] > sphere[2]:
                moved[i, 2], clean = sphere[3] + clearance_mm, False
        for i, j in combinations(range(len(moved)), 2):
            apart = moved[j, :3] - moved[i, :3]
            distance = float(np.linalg.norm(apart))
            depth = moved[i, 3] + moved[j, 3] - distance
            if depth > 0.0:
                step = 0.5 * (depth + clearance_mm) * (apart / distance if distance > 0.0 else np.eye(3)[2])
                moved[i, :3] -= step
                moved[j, :3] += step
                clean = False
        if clean:
            break
    return moved
