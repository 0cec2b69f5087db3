"""On which side of each window and tube every ball stands, and how far it is from crossing over."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import Body
from tracer.scene.scene import Scene

STEP = 1e-4  # mm or rad


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
        away = np.zeros(3)
        for axis in range(3):
            for by in (STEP, -STEP):
                moved = table.copy()
                moved[self.ball, axis] += by
                away[axis] += self.gap_mm(moved, walls) / (2.0 * by)
        return away


def sides_of(scene: Scene) -> tuple[Side, ...]:
    """Every pair of a ball and a wall of a scene."""
    walls, table = [body for body in scene.seen if body.room is not None], scene.sphere_table()
    pairs = [Side(wall, number, 0) for wall in walls for number in range(len(table))]
    return tuple(pair if pair.gap_mm(table, {}) >= 0.0 else pair._replace(side=1) for pair in pairs)
