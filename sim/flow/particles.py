"""Particles of a seeded gas between two pulses of a light sheet: where they are, and how brightly they shine.

Every pair has particles of its own, as in a flow that has gone by since the last one.  They lie evenly in a slab
that is thicker than the sheet at pulse A, and are carried on to pulse B by the flow (Runge-Kutta, fourth order) in
three dimensions: what moves along z leaves the light, or comes into it, and is seen once only.  A flow without
divergence keeps them even; where fluctuations have some (`sim.flow.fields`), the mean displacement is biased by
dt^2/2 times their stress gradient, 0.003 px in the jet.

The sheet is Gaussian across its plane,  I = E exp(-8 d^2 / w^2)  with the full thickness w at e^-2, as laser
optics counts it.  The two pulses may differ in energy and place: two cavities never overlap perfectly.  Light
scattered by a particle of diameter d goes like d^2, and droplets of a nebuliser are spread log-normally.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.flow.fields import Flow
from tracer.bodies import Sphere
from tracer.errors import SceneError

Float64 = NDArray[np.float64]

FAINTEST = 5e-3  # of the sheet's middle: a third of a count is not drawn
SORTED_ROW_MM = 0.5  # particles lie in this order in memory, so that neighbours are looked up together


@dataclass(frozen=True)
class LightSheet:
    """A light sheet about the plane z = offset + slope_x x + slope_y y.

    Parameters
    ----------
    thickness_mm : float
        Full width at e^-2.
    offset_mm : float
        Height of its middle above the origin.
    slope_x, slope_y : float
        Tilt.
    energies : (float, float)
        Of pulses A and B.
    apart_mm : float
        How much higher the sheet of B lies than that of A.
    """

    thickness_mm: float = 1.0
    offset_mm: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0
    energies: tuple[float, float] = (1.0, 1.0)
    apart_mm: float = 0.0

    def __post_init__(self) -> None:
        if not self.thickness_mm > 0.0:
            raise SceneError("thickness_mm of a light sheet must be positive")
        if min(self.energies) < 0.0:
            raise SceneError("energies of a light sheet must not be negative")

    @property
    def reach_mm(self) -> float:
        """Distance from the middle at which light is as faint as `FAINTEST`."""
        return float(self.thickness_mm * np.sqrt(-np.log(FAINTEST) / 8.0) + 0.5 * abs(self.apart_mm))

    def middle_mm(self, x_mm: Float64, y_mm: Float64) -> Float64:
        """Height (N,) of the middle between the sheets of A and B."""
        return self.offset_mm + self.slope_x * x_mm + self.slope_y * y_mm + np.zeros_like(x_mm)

    def light(self, points_mm: Float64, pulse: int) -> Float64:
        """Light (N,) of pulse 0 (A) or 1 (B) at points (N, 3), 1 in the middle of a pulse of energy 1."""
        x, y, z = points_mm.T
        off = z - self.middle_mm(x, y) + (0.5 if pulse == 0 else -0.5) * self.apart_mm
        off /= np.sqrt(1.0 + self.slope_x**2 + self.slope_y**2)
        return np.asarray(self.energies[pulse] * np.exp(-8.0 * np.square(off / self.thickness_mm)))


@dataclass(frozen=True)
class Seeding:
    """Density and unevenness of the seeding.

    Parameters
    ----------
    per_px : float
        Particles within the sheet's thickness, on the area that a pixel sees without glass; of several cameras a
        pixel of the one with the largest.
    spread : float
        Standard deviation of the logarithm of a particle's light, cut at two of them.
    """

    per_px: float = 0.03
    spread: float = 0.35

    def __post_init__(self) -> None:
        if not (0.0 <= self.per_px <= 10.0 and 0.0 <= self.spread <= 3.0):
            raise SceneError("per_px must be 0 to 10, spread 0 to 3")


@dataclass(frozen=True)
class SeededArea:
    """Area in which particles are seeded, and how densely.

    Parameters
    ----------
    corners_mm : ndarray
        Low and high corner (2, 2), x and y.
    px_mm : float
        Width that a pixel sees without glass.
    """

    corners_mm: Float64
    px_mm: float

    @classmethod
    def around(cls, areas: Sequence["SeededArea"]) -> "SeededArea":
        """Return the area that holds all of some, whatever their order, as dense as the least dense."""
        corners_mm = np.array([area.corners_mm for area in areas])
        extent_mm = np.array([corners_mm[:, 0].min(axis=0), corners_mm[:, 1].max(axis=0)])
        return cls(extent_mm, max(area.px_mm for area in areas))


@dataclass(frozen=True)
class ParticlePair:
    """The particles of one pair: places (N, 3) [mm] and light (N,) at pulses A and B."""

    places_mm: tuple[Float64, Float64]
    light: tuple[Float64, Float64]


def outside(balls: Sequence[Sphere], points_mm: Float64) -> NDArray[np.bool_]:
    """Points (N, 3) in none of some balls, which count as round."""
    free = np.ones(len(points_mm), np.bool_)
    for ball in balls:
        free &= np.square(points_mm - ball.centre_mm).sum(axis=1) > ball.radius_mm**2
    return free


def advect(flow: Flow, points_mm: Float64, time_s: float, dt_s: float) -> Float64:
    """Carry points (N, 3) for a time, which may be negative: Runge-Kutta, fourth order."""
    k1 = flow.velocity(points_mm, time_s)
    k2 = flow.velocity(points_mm + 0.5 * dt_s * k1, time_s + 0.5 * dt_s)
    k3 = flow.velocity(points_mm + 0.5 * dt_s * k2, time_s + 0.5 * dt_s)
    k4 = flow.velocity(points_mm + dt_s * k3, time_s + dt_s)
    return np.asarray(points_mm + dt_s / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))


def particle_pair(
    flow: Flow,
    sheet: LightSheet,
    seeding: Seeding,
    *,
    area: SeededArea,
    time_s: float,
    dt_s: float,
    rng: np.random.Generator,
) -> ParticlePair:
    """Seed a slab at pulse A and carry its particles to pulse B.

    Parameters
    ----------
    area : SeededArea
        Where particles are seeded.
    time_s : float
        Of pulse A.
    dt_s : float
        From A to B.
    rng : Generator
        Of places and sizes.
    """
    low, high = area.corners_mm
    thick = 2.0 * sheet.reach_mm
    area_px = float(np.prod(high - low)) / area.px_mm**2
    count = int(rng.poisson(seeding.per_px * area_px * thick / sheet.thickness_mm))
    points = rng.random((count, 3)) * (*(high - low), thick) + (*low, 0.0)
    order = np.lexsort((points[:, 0], np.floor(points[:, 1] / SORTED_ROW_MM)))
    points = points[order]
    points[:, 2] += sheet.middle_mm(points[:, 0], points[:, 1]) - 0.5 * thick
    points = points[flow.holds(points)]
    places = (points, advect(flow, points, time_s, dt_s) if dt_s else points)
    size = np.exp(seeding.spread * np.clip(rng.standard_normal(len(points)), -2.0, 2.0))
    lights = [size * sheet.light(place, pulse) * flow.holds(place) for pulse, place in enumerate(places)]
    return ParticlePair(places, (lights[0], lights[1]))
