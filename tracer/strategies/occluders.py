"""Lockstep beside opaque rods: spheres are traced as if no rod stood there, and rays that may meet one anew.

Two bounds say which these are; both are wide, and cost time where they are wide, never a ray.

* Of the direct view: the shadow that a rod throws from the pinhole.  Points less than r apart, at least h below
  the pinhole at H and at most w beside it, are seen less than (H/h) sqrt(1 + w^2/h^2) r apart on the plane.
* Behind spheres: a plane that touches the rod.  A straight piece of the way whose ends both lie in the half-space
  on the plane's other side stays in it, as that is convex, and does not meet the rod.
"""

from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from tracer.bodies.rod import Rods
from tracer.kernels.occluders import retrace_shadows
from tracer.scene.scene import Scene
from tracer.strategies.branches import Branch, Numbers, chain, chain_branches, event_numbers, key_of
from tracer.strategies.lockstep import name_unknown, trace_lockstep
from tracer.strategies.trace import pack_camera, world_of

TINY = float(np.finfo(float).tiny)
ROOM_MM = 1e-3  # of both bounds: what is stored as float32 is rounded


def trace_with_occluders(
    scene: Scene, rods: Rods, plane: NDArray[np.float64 | np.float32], status: NDArray[np.uint8], branch: Numbers
) -> tuple[Branch, ...]:
    """Trace every pixel, as `trace_lockstep`; branches are numbered as those of `trace_ray`."""
    branches, events = list(trace_lockstep(scene, plane, status, branch)), event_numbers(scene)
    keys = np.array([key_of(np.array([events[name] for name in way], np.int64)) for way in chain_branches(scene)])
    tables, out = (pack_camera(scene.camera), world_of(scene)), (plane, status, branch)
    shadows, sides = shadows_of(scene, rods.rows), sides_of(scene, rods.rows)
    run_rows(lambda first, last: retrace_shadows(tables, shadows, sides, keys, first, last, out), len(branch))
    name_unknown(scene, np.arange(len(branch)), branches, plane, status, branch)
    order = sorted(
        {0, *np.flatnonzero(np.bincount(branch.ravel()))}, key=lambda n: (len(branches[n]), branches[n])
    )
    lookup = np.zeros(len(branches), branch.dtype)
    lookup[order] = np.arange(len(order))
    np.take(lookup, branch, out=branch)
    return tuple(branches[number] for number in order)


def shadows_of(scene: Scene, rods: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shadows (K, 6) of rods (K, 7) for `march_doubted`; of one as high as the pinhole the whole plane."""
    eye, radius = np.array(scene.camera.position_mm), rods[:, 6]
    ends = rods[:, :6].reshape(-1, 2, 3)
    low = np.maximum(eye[2] - ends[..., 2].max(axis=1) - radius, 0.0)
    beside = np.linalg.norm(ends[..., :2] - eye[:2], axis=-1).max(axis=1) + radius
    with np.errstate(divide="ignore", invalid="ignore"):
        start, end = np.moveaxis(eye[:2] + (ends[..., :2] - eye[:2]) * (eye[2] / (eye[2] - ends[..., 2:])), 1, 0)
        width = radius * eye[2] / low * np.hypot(1.0, beside / low) + ROOM_MM
    axis = end - start
    one = 1.0 / np.maximum((axis**2).sum(axis=1), TINY)
    return np.where(
        low[:, None] > 0.0, np.column_stack((start, axis, one, width**2)), (0.0, 0.0, 0.0, 0.0, 0.0, np.inf)
    )


def sides_of(scene: Scene, rods: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sides (2^N, K, 3) of rods (K, 7) for `march_doubted`, (0, 0, inf) where no plane parts them from the way."""
    balls = [(np.array(ball.centre_mm), ball.radius_mm) for ball in chain(scene)]
    eye = (np.array(scene.camera.position_mm), 0.0)
    above = (
        np.minimum(rods[:, 2], rods[:, 5]) >= rods[:, 6]
    )  # else `trace_ray` stops a ray behind the plane as well
    begins = [separating_plane(rods, eye, ball)[0] for ball in balls]
    legs = {(i, j): separating_plane(rods, balls[i], balls[j])[0] for i, j in combinations(range(len(balls)), 2)}
    sides = np.full((1 << len(balls), len(rods), 3), (0.0, 0.0, np.inf))
    for last, (centre, radius) in enumerate(balls):
        clear, normal, reach = separating_plane(rods, (centre, radius), (centre * (1.0, 1.0, 0.0), -np.inf))
        lands = np.column_stack((normal[:, :2], reach + ROOM_MM))
        for number in range(1 << last, 2 << last):
            way = [ball for ball in range(last + 1) if number >> ball & 1]
            past = np.all([above, clear, begins[way[0]], *(legs[leg] for leg in pairwise(way))], axis=0)
            sides[number, past] = lands[past]
    return sides


def separating_plane(
    rods: NDArray[np.float64], one: tuple[NDArray[np.float64], float], other: tuple[NDArray[np.float64], float]
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
    """Return whether a plane parts each rod from two balls, its normal (K, 3), and the rod's reach along that.

    Tried are planes across the nearest way from a rod to either centre, or its part across the line of both.
    """
    ends = rods[:, :6].reshape(-1, 2, 3)
    axis, line = ends[:, 1] - ends[:, 0], other[0] - one[0]
    done, found, far = np.zeros(len(rods), bool), np.zeros((len(rods), 3)), np.zeros(len(rods))
    for centre, _ in (one, other):
        along = ((centre - ends[:, 0]) * axis).sum(axis=1) / np.maximum((axis**2).sum(axis=1), TINY)
        way = centre - ends[:, 0] - np.clip(along, 0.0, 1.0)[:, None] * axis
        for normal in (way - (way @ line)[:, None] * line / max(line @ line, TINY), way):
            normal = normal / np.maximum(np.linalg.norm(normal, axis=1), TINY)[:, None]
            reach = (ends @ normal[..., None]).max(axis=1)[:, 0] + rods[:, 6]
            parts = ~done & (normal @ one[0] - one[1] >= reach) & (normal @ other[0] - other[1] >= reach)
            done, found[parts], far[parts] = done | parts, normal[parts], reach[parts]
    return done, found, far
