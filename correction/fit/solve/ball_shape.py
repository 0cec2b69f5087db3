"""Shift of a landing point by a ball on its way that is not round.

A ball of radius R + h(e) in direction e, h = e.S e with S symmetric and traceless (five numbers, an ellipsoid to
first order), meets a ray that would meet the sphere at R e, with direction d, at a path longer by

    dt = h / (d . e)            with the normal        e' - (2 / R) (S e' - h e'),        e' there.

Nothing but these two changes at each of the two surfaces.  A ray is followed to the plane once, and what a landing
coordinate s gains by position and direction (f, g) back through the surfaces: with r the ratio of the indices,
c = d . n, t the cosine behind, n the normal against d, refraction d' = r d - (r c + t) n hands on

    g_d = r g - q (g . n) n,        g_n = -q (g . n) d - (r c + t) g,        q = r + r^2 c / t,

and each surface adds (f + g_n/R across e) . d dt - g_n . (2 / R) (S e - h e) to ds.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.camera import Camera
from tracer.strategies.branches import branch_of
from tracer.strategies.sensitivity import TargetPose

Points = NDArray[np.float64]
SHAPES = tuple(
    np.array(rows, dtype=np.float64)
    for rows in (
        ((1, 0, 0), (0, -1, 0), (0, 0, 0)),
        ((1, 0, 0), (0, 1, 0), (0, 0, -2)),
        ((0, 1, 0), (1, 0, 0), (0, 0, 0)),
        ((0, 0, 1), (0, 0, 0), (1, 0, 0)),
        ((0, 0, 0), (0, 0, 1), (0, 1, 0)),
    )
)  # the five traceless S, of which every other is a sum
NOTHING = -1


def balls_crossed(ways: NDArray[np.str_], names: Sequence[str]) -> NDArray[np.int64]:
    """Rows (N, K) of the spheres that rays cross whole and in order, filled up with NOTHING.

    Parameters
    ----------
    ways : (N,) str
        Spheres crossed, as text; ways through anything but whole spheres cross NOTHING here.
    names : sequence of str
        Of the spheres in the table.
    """
    place = {name: number for number, name in enumerate(names)}
    kinds, which = np.unique(ways, return_inverse=True)
    rows = [[place.get(event, NOTHING) for event in branch_of(str(way))] for way in kinds]
    whole = [row if NOTHING not in row else [] for row in rows]
    table = np.full((len(kinds), max(map(len, whole), default=0)), NOTHING)
    for number, row in enumerate(whole):
        table[number, : len(row)] = row
    return table[which]


@dataclass(frozen=True)
class ShapeRates:
    """Derivatives of N landing points by the shapes of the balls on their ways, K at most.

    Parameters
    ----------
    row : (N, K) int64
        Balls, as `balls_crossed`.
    rate : (N, 2, K, 5) float64
        By the numbers of `SHAPES` of each; 0 where there is none, and where the ray is lost.
    """

    row: NDArray[np.int64]
    rate: Points

    def by(self, ball: int) -> tuple[NDArray[np.bool_], Points]:
        """Rays (N,) that cross a ball, as a mask, and their derivatives (M, 2, 5) by its shape."""
        mine = self.row == ball
        here = mine.any(axis=1)
        return here, np.asarray((self.rate[here] * mine[here][:, None, :, None]).sum(axis=2))

    def by_each(self, balls: Sequence[int]) -> Points:
        """Derivatives (N, 2, 5 B) by the shapes of B balls."""
        dense = np.zeros((len(self.row), 2, len(balls), len(SHAPES)))
        for place, ball in enumerate(balls):
            here, rate = self.by(ball)
            dense[here, :, place] = rate
        return dense.reshape(len(self.row), 2, len(balls) * len(SHAPES))


def shape_rates(
    camera: Camera,
    spheres: Points,
    crossed: NDArray[np.int64],
    pixels: Points,
    pose: TargetPose,
    depth_mm: NDArray[np.float64] | float = 0.0,
) -> ShapeRates:
    """Follow rays to a plane, and what shapes do to them back.

    Parameters
    ----------
    camera : Camera
    spheres : (B, 6) float64
        Sphere table; n is against the room.
    crossed : (N, K) int64
        Rows of the spheres that the rays cross, as `balls_crossed`.
    pixels : (N, 2) float64
    pose : TargetPose
        Of the target.
    depth_mm : (N,) float64 or float
        How far behind its plane rays land.
    """
    way = camera.directions(pixels)
    at = np.tile(np.array(camera.position_mm), (len(way), 1))
    rates = np.zeros((len(pixels), 2, crossed.shape[1], len(SHAPES)))
    surfaces: list[_Surface] = []
    with np.errstate(invalid="ignore", divide="ignore"):
        for turn in range(crossed.shape[1]):
            here = np.flatnonzero(crossed[:, turn] != NOTHING)
            row = spheres[crossed[here, turn]]
            for entering in (True, False):
                surface = _Surface.meet(at[here], way[here], row, entering)
                at[here], way[here] = row[:, :3] + row[:, 3:4] * surface.out, surface.way_behind()
                surfaces.append(surface)
        axes = np.array(pose.axes)
        origin = np.array(pose.origin_mm) - np.multiply.outer(depth_mm, axes[2])
        fall = -((at - origin) @ axes[2]) / (way @ axes[2])
        for axis in range(2):
            by_place = axes[axis] - axes[2] * (way @ axes[axis] / (way @ axes[2]))[:, None]
            by_way = fall[:, None] * by_place
            for number in reversed(range(len(surfaces))):
                turn = number // 2
                here = np.flatnonzero(crossed[:, turn] != NOTHING)
                gained, by_place[here], by_way[here] = surfaces[number].back(by_place[here], by_way[here])
                rates[here, axis, turn] += gained
    return ShapeRates(crossed, np.nan_to_num(rates, nan=0.0, posinf=0.0, neginf=0.0))


@dataclass(frozen=True)
class _Surface:
    """A surface met by M rays: directions (M, 3) before, paths (M,) to it, outward normals (M, 3), radii (M,).

    `ratio` (M,) is that of the indices before and after, `side` 1 where the outward normal is against the rays.
    """

    way: Points
    path: Points
    out: Points
    radius: Points
    ratio: Points
    side: float

    @classmethod
    def meet(cls, at: Points, way: Points, row: Points, entering: bool) -> "_Surface":
        """Meet spheres (M, 6) from positions and in directions (M, 3)."""
        away = at - row[:, :3]
        along = np.sum(away * way, axis=1)
        root = np.sqrt(along**2 - np.sum(away**2, axis=1) + row[:, 3] ** 2)
        path = -along - root if entering else -along + root
        out = (away + path[:, None] * way) / row[:, 3:4]
        return cls(
            way, path, out, row[:, 3], 1.0 / row[:, 4] if entering else row[:, 4], 1.0 if entering else -1.0
        )

    def _angles(self) -> tuple[Points, Points, Points]:
        """Normals (M, 3) against the rays, cosines (M,) before and behind."""
        normal = self.side * self.out
        before = np.sum(self.way * normal, axis=1)
        return normal, before, np.sqrt(1.0 - self.ratio**2 * (1.0 - before**2))

    def way_behind(self) -> Points:
        """Directions (M, 3) behind, by Snell's law."""
        normal, before, behind = self._angles()
        return np.asarray(self.ratio[:, None] * self.way - (self.ratio * before + behind)[:, None] * normal)

    def back(self, f: Points, g: Points) -> tuple[Points, Points, Points]:
        """Gain (M, 5) by the shapes, and f, g (M, 3) before, from those behind."""
        normal, before, behind = self._angles()
        along = (self.ratio + self.ratio**2 * before / behind) * np.sum(g * normal, axis=1)
        by_out = -self.side * (along[:, None] * self.way + (self.ratio * before + behind)[:, None] * g)
        across = by_out - np.sum(by_out * self.out, axis=1)[:, None] * self.out
        f = f + across / self.radius[:, None]
        steep = np.sum(f * self.way, axis=1) / np.sum(self.out * self.way, axis=1)
        gained = []
        for shape in SHAPES:
            turned = self.out @ shape
            height = np.sum(self.out * turned, axis=1)
            gained.append(steep * height - 2.0 / self.radius * np.sum(across * turned, axis=1))
        f = f - steep[:, None] * self.out
        g = self.path[:, None] * f + self.ratio[:, None] * g - along[:, None] * normal
        return np.stack(gained, axis=1), f, g
