"""Balls stay on their side of windows and tubes, as they stay out of each other (`contact`).

Which side that is the nominal scene says; how far a ball is from crossing over, the wall itself (`Room.gaps_mm`),
and differences of it say how that changes with the ball's place and the wall's numbers.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from correction.fit.contact import ROUNDS, pushed_apart
from correction.fit.unknowns import Unknowns
from tracer.bodies import CONTACT_TOL_MM, Body
from tracer.errors import SceneError
from tracer.sensitivity import SPHERE

STEP = 1e-4  # mm or rad
FAR_MM = 5.0  # a ball so far from a wall does not come to it in one step


class Side(NamedTuple):
    """A ball, by its number, that stands outside (0) or inside (1) of a wall."""

    wall: Body
    ball: int
    side: int

    def gap_mm(self, table: NDArray[np.float64], walls: Mapping[str, Body]) -> float:
        """How far the ball of a table (N, 4 or more) is from one of the walls; negative where it is cut."""
        room = walls.get(self.wall.name, self.wall).room
        assert room is not None
        row = table[self.ball]
        return float(room.gaps_mm(row[None, :3], float(row[3]))[self.side])

    def way_in(self, table: NDArray[np.float64], walls: Mapping[str, Body]) -> NDArray[np.float64]:
        """Derivative (3,) of the gap by the ball's centre."""
        ahead, back = (
            [self.gap_mm(table + by * _one(table.shape, (self.ball, axis)), walls) for axis in range(3)]
            for by in (STEP, -STEP)
        )
        return np.asarray((np.array(ahead) - np.array(back)) / (2.0 * STEP))


def sides_of(unknowns: Unknowns) -> list[Side]:
    """Every pair of a ball and a wall."""
    walls = [body for body in unknowns.scene.seen if body.room is not None]
    table = unknowns.scene.sphere_table()
    pairs = [Side(wall, number, 0) for wall in walls for number in range(len(table))]
    return [pair if pair.gap_mm(table, {}) >= 0.0 else pair._replace(side=1) for pair in pairs]


def room_depths(unknowns: Unknowns, full: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depth (K,) [mm] of each ball in each wall, negative for a gap, and derivatives (K, F) by the full vector."""
    sides = sides_of(unknowns)
    depth, rate = np.full(len(sides), -FAR_MM), np.zeros((len(sides), len(full)))
    try:
        walls = unknowns.other_bodies.moved(full[unknowns.others])
    except SceneError:
        return depth, rate
    table, first = unknowns.spheres(full), unknowns.others.start
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
                ahead, back = (_moved(unknowns, full, at, by) for by in (STEP, -STEP))
                rate[number, at] = (pair.gap_mm(table, back) - pair.gap_mm(table, ahead)) / (2.0 * STEP)
    return depth, rate


def pushed_clear(unknowns: Unknowns, full: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Sphere table (N, 6) with balls clear of each other, the plane and the walls, and the deepest cut."""
    sides, walls = sides_of(unknowns), unknowns.other_bodies.moved(full[unknowns.others])
    table = unknowns.spheres(full)
    deepest = max((-pair.gap_mm(table, walls) for pair in sides), default=0.0)
    for _ in range(ROUNDS):
        table, clean = pushed_apart(table), True
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
