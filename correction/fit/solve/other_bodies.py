"""Numbers of bodies that are no spheres, as a fit moves them: windows, tubes, whatever has `Body.numbers`.

The fit's numbers are those that people know (a tilt, a radius); landing points depend on the kernels' rows
(`tracer.strategies.sensitivity`), which hold a direction in three parts and an index relative to what is around.
Between them stands T = d rows / d numbers, by differences of the closed form in which a body makes its row.

Every ball stands on one side of each window and tube (`sides_of`), and may come no nearer than to touch it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import Body, Number
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene

SIDE_STEP = 1e-4  # mm or rad
NUMBER_STEP = 1e-5  # mm or rad: rows bend over metres and radians, and are rounded at 1e-13


class Side(NamedTuple):
    """A ball, by its number, that stands outside (0) or inside (1) of a wall."""

    wall: Body
    ball: int
    side: int

    def gap_mm(self, table: NDArray[np.float64], walls: Mapping[str, Body]) -> float:
        """Distance of the ball of a table (N, 4 or more) from one of the walls; negative where it is cut."""
        room = walls.get(self.wall.name, self.wall).room
        assert room is not None
        row = table[self.ball]
        return float(room.gaps_mm(row[None, :3], float(row[3]))[self.side])

    def way_in(self, table: NDArray[np.float64], walls: Mapping[str, Body]) -> NDArray[np.float64]:
        """Derivative (3,) of the gap by the ball's centre."""
        away = np.zeros(3)
        for axis in range(3):
            for by in (SIDE_STEP, -SIDE_STEP):
                moved = table.copy()
                moved[self.ball, axis] += by
                away[axis] += self.gap_mm(moved, walls) / (2.0 * by)
        return away


def sides_of(scene: Scene) -> tuple[Side, ...]:
    """Every pair of a ball and a wall of a scene."""
    walls, table = [body for body in scene.seen if body.room is not None], scene.sphere_table()
    pairs = [Side(wall, number, 0) for wall in walls for number in range(len(table))]
    return tuple(pair if pair.gap_mm(table, {}) >= 0.0 else pair._replace(side=1) for pair in pairs)


@dataclass(frozen=True)
class OtherBodies:
    """Bodies of a nominal scene that are no spheres, and numbers of theirs.

    Parameters
    ----------
    scene : Scene
        The nominal scene.
    """

    scene: Scene

    @cached_property
    def bodies(self) -> tuple[tuple[Body, tuple[Number, ...]], ...]:
        """Those with numbers, in the order of the kernels' tables."""
        every = ((body, body.numbers(self.scene.wavelength_nm)) for body in self.scene.others)
        return tuple((body, numbers) for body, numbers in every if numbers)

    @cached_property
    def sides(self) -> tuple[Side, ...]:
        """Pairs of a ball and a wall, with the side on which it stands."""
        return sides_of(self.scene)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all their numbers (K,)."""
        return tuple(f"{body.name}.{number.name}" for body, numbers in self.bodies for number in numbers)

    @property
    def start(self) -> list[float]:
        """Nominal values (K,)."""
        return [number.value for _, numbers in self.bodies for number in numbers]

    def spread(self, priors: FitTable) -> list[float]:
        """Prior sigmas (K,)."""
        return [_sigma(body, number, priors) for body, numbers in self.bodies for number in numbers]

    def bodies_at(self, values: NDArray[np.float64]) -> dict[str, Body]:
        """Name -> body with the values (K,) of its numbers.

        Raises
        ------
        SceneError
            There is no such body.
        """
        return {body.name: body.with_numbers(own.tolist(), self._nm) for body, _, own in self._each(values)}

    def row_rates(self, values: NDArray[np.float64], glass: bool) -> NDArray[np.float64]:
        """T (R, K): rows of those that stand there, with the glass or without, by the numbers of all."""
        parts, first = [np.zeros((0, len(values)))], 0
        for body, numbers, own in self._each(values):
            if glass or body.stays:
                rate = np.zeros((len(self.scene.row_of(body)), len(values)))
                for place in range(len(numbers)):
                    move = NUMBER_STEP * np.eye(len(numbers))[place]
                    ahead, back = (
                        self.scene.row_of(body.with_numbers((own + by).tolist(), self._nm)) for by in (move, -move)
                    )
                    rate[:, first + place] = (ahead - back) / (2.0 * NUMBER_STEP)
                parts.append(rate)
            first += len(numbers)
        return np.concatenate(parts)

    @property
    def _nm(self) -> float:
        return self.scene.wavelength_nm

    def _each(self, values: NDArray[np.float64]) -> Iterator[tuple[Body, tuple[Number, ...], NDArray[np.float64]]]:
        """Each body with its numbers and their values."""
        first = 0
        for body, numbers in self.bodies:
            yield body, numbers, values[first : first + len(numbers)]
            first += len(numbers)


def _sigma(body: Body, number: Number, priors: FitTable) -> float:
    """Prior sigma of one number, in its own unit."""
    if number.known == "n":
        return priors.index(body.media[0][1].name)
    sigma = float(getattr(priors.wall(body.name), number.known))
    return float(np.deg2rad(sigma)) if number.known == "tilt_deg" else sigma
