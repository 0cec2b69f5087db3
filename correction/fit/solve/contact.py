"""Bodies may touch, not overlap: a stiff wall for the fit, and an exact push apart at its end.

During the fit an overlap of g > 0 costs (g / WALL_MM)^2, one-sided, so that spheres that really touch may
lean on each other; noise then leaves an overlap well below a micrometre.  A scene with any overlap is
refused, so the last of it is removed by moving each pair apart along its line of centres, and each sphere
up from the plane, until nothing overlaps.  A larger overlap is not removed but is a failed fit: the frames
contradict the scene.

What holds the balls goes where the balls go.

Frames of a target tell where the glass is; of rods and other opaque bodies they show a shadow at best, so
the fit has no numbers of theirs.  A support that stayed where the file has it while its ball moves would
stand in the ball, and no such scene can be.  So a body that stands within HELD_MM of a ball is taken for its
support and makes the same step (the nearest ball's, where it holds several); others stay.  What then still
overlaps, because a radius grew or another ball came near, is moved off along the shortest way, and up from
the plane: by a few hundredths of a millimetre, at the edge of a shadow.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import CONTACT_TOL_MM, Body, Sphere, translate_by
from tracer.bodies.shape import reach_mm
from tracer.harmonics import COUNT, values

HELD_MM = 5.0  # glue, cups and what a tape measure misses
SUPPORT_ROUNDS = 100
CLEARANCE_MM = 0.1 * CONTACT_TOL_MM
WALL_MM = 1e-3
CONTACT_ROUNDS = 500
DOWN = (0.0, 0.0, -1.0)
TOUCHING_MM = 0.05  # gap or overlap in the file up to which balls touch
Shapes = Mapping[int, NDArray[np.float64]]
NO_SHAPES: Shapes = {}


def carry_support(support: Body, before: Sequence[Sphere], after: Sequence[Sphere]) -> Body:
    """Return a support where it stands once the balls have moved.

    Parameters
    ----------
    support : Body
        A body that is no ball, where the file has it.
    before, after : sequence of Sphere
        The balls where the file has them, and where they are; in the same order.
    """
    gaps_mm = [support.distance_mm(np.array(ball.centre_mm)) - ball.radius_mm for ball in before]
    if gaps_mm and min(gaps_mm) <= HELD_MM:
        held = int(np.argmin(gaps_mm))
        step_mm = np.subtract(after[held].centre_mm, before[held].centre_mm)
        support = support.moved(translate_by(step_mm))
    return clear_of(support, after)


def clear_of(support: Body, balls: Sequence[Sphere]) -> Body:
    """Return a support that overlaps no ball and does not cross the plane."""
    for _ in range(SUPPORT_ROUNDS):
        steps_mm = [step for ball in balls if (step := _way_out_mm(support, ball)) is not None]
        if support.lowest_mm < -CONTACT_TOL_MM and support.highest_mm > CONTACT_TOL_MM:
            steps_mm.append(np.array([0.0, 0.0, -support.lowest_mm]))
        if not steps_mm:
            break
        support = support.moved(translate_by(np.mean(steps_mm, axis=0)))
    return support


def _way_out_mm(support: Body, ball: Sphere) -> NDArray[np.float64] | None:
    """Step (3,) [mm] that takes a support just off a ball; None if they do not overlap."""
    centre = np.array(ball.centre_mm)
    depth_mm = ball.radius_mm - support.distance_mm(centre)
    if depth_mm <= CONTACT_TOL_MM:
        return None
    start, end, _ = support.capsule
    axis = np.subtract(end, start)
    along = np.clip((centre - start) @ axis / max(float(axis @ axis), CONTACT_TOL_MM), 0.0, 1.0)
    away = np.asarray(start + along * axis - centre, dtype=np.float64)
    length = float(np.linalg.norm(away))
    direction = away / length if length > 0.0 else np.array([0.0, -1.0, 0.0])
    return np.asarray((depth_mm + CLEARANCE_MM) * direction)


def walls(
    spheres: NDArray[np.float64], shapes: Shapes = NO_SHAPES
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
    """Lowest point of a sphere of the table, or ball out of round, below its centre."""
    if number not in shapes:
        return float(sphere[3])
    return reach_mm(float(sphere[3]), tuple((1e3 * shapes[number]).tolist()), -1.0)


def touching_pairs(spheres: NDArray[np.float64]) -> dict[int, tuple[int, int]]:
    """Pairs of spheres of a table (N, 6) that touch, by their row among the `walls`."""
    pairs = combinations(range(len(spheres)), 2)
    gaps_mm = (
        (row, i, j, np.linalg.norm(spheres[j, :3] - spheres[i, :3]) - spheres[i, 3] - spheres[j, 3])
        for row, (i, j) in enumerate(pairs, start=len(spheres))
    )
    return {row: (i, j) for row, i, j, gap in gaps_mm if abs(gap) <= TOUCHING_MM}


def largest_overlap_mm(spheres: NDArray[np.float64], shapes: Shapes = NO_SHAPES) -> float:
    """Deepest overlap of two spheres, or of one with the plane [mm]; 0 if there is none."""
    return float(walls(spheres, shapes)[0].max(initial=0.0))


def push_apart(
    spheres: NDArray[np.float64], clearance_mm: float = 0.1 * CONTACT_TOL_MM, shapes: Shapes = NO_SHAPES
) -> NDArray[np.float64]:
    """Return the sphere table with overlapping spheres moved apart, and up from the plane, just enough.

    Each pair shares its correction; rounds go on until no overlap is left, as a pile may pass it on.
    """
    moved = np.array(spheres)
    reach = [reach_down_mm(number, sphere, shapes) for number, sphere in enumerate(moved)]
    for _ in range(CONTACT_ROUNDS):
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
