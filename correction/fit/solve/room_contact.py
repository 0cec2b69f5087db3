"""Balls stay on their side of windows and tubes, as they stay out of each other (`contact`).

Which side that is the nominal scene says; how far a ball is from crossing over, the wall itself (`Room.gaps_mm`),
and differences of it say how that changes with the ball's place and the wall's numbers.
"""

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.contact import ROUNDS, pushed_apart
from correction.fit.solve.other_bodies import STEP
from correction.fit.solve.unknowns import Unknowns
from tracer.bodies import CONTACT_TOL_MM, Body
from tracer.errors import SceneError
from tracer.strategies.sensitivity import SPHERE

FAR_MM = 5.0  # a ball so far from a wall does not come to it in one step


def room_depths(unknowns: Unknowns, full: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depth (K,) [mm] of each ball in each wall, negative for a gap, and derivatives (K, F) by the full vector."""
    sides = unknowns.other_bodies.sides
    depth, rate = np.full(len(sides), -FAR_MM), np.zeros((len(sides), len(full)))
    if not sides:
        return depth, rate
    try:
        walls = unknowns.other_bodies.moved(full[unknowns.others])
    except SceneError:
        return depth, rate
    table, first = unknowns.spheres(full), unknowns.others.start
    moved: dict[int, tuple[dict[str, Body], dict[str, Body]]] = {}
    for number, pair in enumerate(sides):
        gap = pair.gap_mm(table, walls)
        if gap > FAR_MM:
            continue
        depth[number] = -gap
        place = unknowns.glass.start + len(SPHERE) * pair.ball
        rate[number, place : place + 3] = -pair.way_in(table, walls)
        rate[number, place + 3] = 1.0
        for at, name in enumerate(unknowns.other_bodies.names, start=first):
            if name.startswith(f"{pair.wall.name}."):
                if at not in moved:
                    moved[at] = _moved(unknowns, full, at, STEP), _moved(unknowns, full, at, -STEP)
                ahead, back = moved[at]
                rate[number, at] = (pair.gap_mm(table, back) - pair.gap_mm(table, ahead)) / (2.0 * STEP)
    return depth, rate


def pushed_clear(unknowns: Unknowns, full: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Sphere table (N, 6) with balls clear of each other, the plane and the walls, and the deepest cut."""
    sides, walls = unknowns.other_bodies.sides, unknowns.other_bodies.moved(full[unknowns.others])
    table, shapes = unknowns.spheres(full), unknowns.shapes(full)
    deepest = max((-pair.gap_mm(table, walls) for pair in sides), default=0.0)
    for _ in range(ROUNDS):
        table, clean = pushed_apart(table, shapes=shapes), True
        for pair in sides:
            gap = pair.gap_mm(table, walls)
            if gap < 0.0:
                way = pair.way_in(table, walls)
                table[pair.ball, :3] += (0.1 * CONTACT_TOL_MM - gap) * way / max(float(np.linalg.norm(way)), 1e-9)
                clean = False
        if clean:
            break
    return table, max(deepest, 0.0)


def _moved(unknowns: Unknowns, full: NDArray[np.float64], at: int, by: float) -> dict[str, Body]:
    """Walls with one number of the full vector changed."""
    return unknowns.other_bodies.moved((full + by * _one(full.shape, (at,)))[unknowns.others])


def _one(shape: tuple[int, ...], place: tuple[int, ...]) -> NDArray[np.float64]:
    """Zeros with a single one."""
    one = np.zeros(shape)
    one[place] = 1.0
    return one
