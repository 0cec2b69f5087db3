"""A steady flow between balls: free of divergence, and at rest on their surfaces.

The velocity is the curl of a vector potential that is damped towards every ball,

    u = curl(F B) = F curl B + grad F x B,     F = product of 1 - exp(-(d_i / wall_mm)^2),

with d_i the distance from the surface of ball i and B a sum of waves.  A curl has no divergence; F and its
gradient vanish on every surface, also where balls touch, and so does u (a potential damped at walls: Bridson et
al., ACM Trans. Graph. 26(3), 46 (2007)).  Near a surface F grows as the square of the distance, u in proportion.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import Sphere
from tracer.errors import SceneError
from tracer.scene.scene import Scene

Float64 = NDArray[np.float64]

FAR = 4.0  # wall_mm from a surface at which it is not felt: exp(-16)


@dataclass(frozen=True)
class BetweenBalls:
    """Flow between balls, without fluctuations.

    Parameters
    ----------
    speed_mm_s : float
        Root mean square of the velocity far from all balls.
    wall_mm : float
        Distance from a surface in which the flow reaches 63 % of that.
    wave_mm : float
        Shortest wavelength of the potential; the longest is twice that.
    through : float
        Share of the potential that drives flow along z; 0: the flow stays in planes of constant z.
    waves, seed : int
        How many waves, and which.
    balls_mm : tuple of (float, float, float, float)
        Centres and radii; empty: those of the scene.
    """

    speed_mm_s: float = 500.0
    wall_mm: float = 6.0
    wave_mm: float = 40.0
    through: float = 0.0
    waves: int = 12
    seed: int = 0
    balls_mm: tuple[tuple[float, float, float, float], ...] = ()

    def __post_init__(self) -> None:
        if not min(self.wall_mm, self.wave_mm, self.waves) > 0:
            raise SceneError("wall_mm, wave_mm and waves of a flow between balls must be positive")

    def around(self, scene: Scene) -> "BetweenBalls":
        """Return the same flow around the balls of a scene, if it has none yet."""
        balls = [(*ball.centre_mm, ball.radius_mm) for ball in Sphere.among(scene.bodies)]
        numbers = {**vars(self), "balls_mm": self.balls_mm or tuple(balls)}
        return BetweenBalls(**{name: numbers[name] for name in self.__dataclass_fields__})

    def mean(self, points_mm: Float64) -> Float64:
        """U (N, 3) [mm/s]; nothing moves in the balls."""
        wave, strength, phase = self._potential
        angle = points_mm @ wave.T + phase
        potential = np.cos(angle) @ strength
        curl = -np.sin(angle) @ np.cross(wave, strength)
        share, slope = self._damping(points_mm)
        return np.asarray(share[:, None] * curl + np.cross(slope, potential))

    def amplitude(self, points_mm: Float64) -> Float64:
        """Zero (N, 3, 3)."""
        return np.zeros((len(points_mm), 3, 3))

    def holds(self, points_mm: Float64) -> NDArray[np.bool_]:
        """Outside the balls."""
        free = np.ones(len(points_mm), np.bool_)
        for *centre, radius in self.balls_mm:
            free &= np.square(points_mm - centre).sum(axis=1) > radius**2
        return free

    @cached_property
    def _potential(self) -> tuple[Float64, Float64, Float64]:
        """Wave vectors [rad/mm], amplitudes [mm^2/s] (K, 3) and phases (K,)."""
        rng = np.random.default_rng(self.seed)
        wave = rng.normal(size=(self.waves, 3))
        length = self.wave_mm * (1.0 + rng.random(self.waves))
        wave *= (2.0 * np.pi / length / np.linalg.norm(wave, axis=1))[:, None]
        strength = rng.normal(size=(self.waves, 3)) * (self.through, self.through, 1.0)
        rms = np.sqrt(0.5 * np.square(np.cross(wave, strength)).sum())
        return wave, strength * self.speed_mm_s / rms, 2.0 * np.pi * rng.random(self.waves)

    def _damping(self, points_mm: Float64) -> tuple[Float64, Float64]:
        """F (N,) and its gradient (N, 3)."""
        share, slope = np.ones(len(points_mm)), np.zeros((len(points_mm), 3))
        for *centre, radius in self.balls_mm:
            away = points_mm - centre
            far = np.linalg.norm(away, axis=1)
            near = np.flatnonzero(far < radius + FAR * self.wall_mm)
            gap = np.maximum(far[near] - radius, 0.0) / self.wall_mm
            lost = np.exp(-gap * gap)
            rise = (2.0 / self.wall_mm * gap * lost / far[near])[:, None] * away[near]
            slope[near] = slope[near] * (1.0 - lost)[:, None] + share[near, None] * rise
            share[near] *= 1.0 - lost
        return share, slope
