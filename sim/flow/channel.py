"""Channels between two walls x = +-h, flowing along +y: laminar, or with the mean and stresses of turbulence.

Laminar:  U = U_max (1 - (x/h)^2), no fluctuations.

Turbulent-like:  U = u_tau u+(y+), y+ = (h - |x|) u_tau / nu, by Reichardt's law of the wall (ZAMM 31, 208 (1951))

    u+ = ln(1 + 0.4 y+)/0.4 + 7.8 (1 - exp(-y+/11) - (y+/11) exp(-y+/3))

and the shear stress that this mean needs, exactly:  -<u'v'> = u_tau^2 (1 - y/h) - nu dU/dy.  Where the law of the
wall asks for less than nothing (4 % of u_tau^2 below y+ = 3, a thousandth in the middle) it is zero.  The other
stresses are shaped like measured ones (Moser, Kim and Mansour, Phys. Fluids 11, 943 (1999)):  <v'v'>+ along the
flow peaks near y+ = 15 with about 7, <u'u'>+ across reaches 0.8 and <w'w'>+ 1.6, all zero at the wall.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracer.errors import SceneError

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class LaminarChannel:
    """Poiseuille flow.

    Parameters
    ----------
    half_width_mm : float
        h.
    fastest_mm_s : float
        U_max, in the middle.
    middle_mm : float
        x of the middle.
    """

    half_width_mm: float = 20.0
    fastest_mm_s: float = 600.0
    middle_mm: float = 0.0

    def __post_init__(self) -> None:
        if not self.half_width_mm > 0.0:
            raise SceneError("half_width_mm of a channel must be positive")

    def mean(self, points_mm: Float64) -> Float64:
        """U (N, 3) [mm/s]; nothing moves in the walls."""
        velocity = np.zeros((len(points_mm), 3))
        place = (points_mm[:, 0] - self.middle_mm) / self.half_width_mm
        velocity[:, 1] = self.fastest_mm_s * np.maximum(1.0 - place * place, 0.0)
        return velocity

    def amplitude(self, points_mm: Float64) -> Float64:
        """Zero (N, 3, 3)."""
        return np.zeros((len(points_mm), 3, 3))

    def holds(self, points_mm: Float64) -> NDArray[np.bool_]:
        """Between the walls."""
        return np.asarray(np.abs(points_mm[:, 0] - self.middle_mm) < self.half_width_mm)


@dataclass(frozen=True)
class TurbulentChannel:
    """Mean and stresses of a turbulent channel.

    Parameters
    ----------
    half_width_mm : float
        h.
    friction_mm_s : float
        u_tau.
    viscosity_mm2_s : float
        nu; 15 for air.
    middle_mm : float
        x of the middle.
    """

    half_width_mm: float = 20.0
    friction_mm_s: float = 40.0
    viscosity_mm2_s: float = 4.0
    middle_mm: float = 0.0

    def __post_init__(self) -> None:
        if not min(self.half_width_mm, self.friction_mm_s, self.viscosity_mm2_s) > 0.0:
            raise SceneError("half_width_mm, friction_mm_s and viscosity_mm2_s of a channel must be positive")

    def mean(self, points_mm: Float64) -> Float64:
        """U (N, 3) [mm/s]."""
        velocity = np.zeros((len(points_mm), 3))
        plus = self._wall_distance(points_mm)
        law = np.log1p(0.4 * plus) / 0.4
        law += 7.8 * (-np.expm1(-plus / 11.0) - plus / 11.0 * np.exp(-plus / 3.0))
        velocity[:, 1] = self.friction_mm_s * law
        return velocity

    def amplitude(self, points_mm: Float64) -> Float64:
        """A (N, 3, 3) [mm/s]: columns are along the flow, across, along z."""
        plus = self._wall_distance(points_mm)
        full = self.half_width_mm * self.friction_mm_s / self.viscosity_mm2_s
        slope = 1.0 / (1.0 + 0.4 * plus)
        slope += 7.8 / 11.0 * (np.exp(-plus / 11.0) - (1.0 - plus / 3.0) * np.exp(-plus / 3.0))
        shear = np.clip(1.0 - plus / full - slope, 0.0, None)  # -<u'v'> / u_tau^2, towards the wall
        decay = 1.0 - 0.75 * plus / full
        along = (0.42 * plus * np.exp(-plus / 15.0) + 2.0 * -np.expm1(-plus / 20.0)) ** 2 * 0.36 * decay + 1e-30
        across = 0.8 * np.square(-np.expm1(-plus / 25.0)) * decay
        out = np.zeros((len(points_mm), 3, 3))
        strength = self.friction_mm_s
        # Momentum goes to the nearer wall: u' is directed outwards where v' is fast.
        side = np.sign(points_mm[:, 0] - self.middle_mm)
        a = np.sqrt(along)
        b = np.minimum(shear / a, 0.95 * np.sqrt(across))
        out[:, 1, 0] = strength * a
        out[:, 0, 0] = strength * side * b
        out[:, 0, 1] = strength * np.sqrt(np.maximum(across - b * b, 0.0))
        out[:, 2, 2] = strength * np.sqrt(1.6 * decay) * -np.expm1(-plus / 20.0)
        out[~self.holds(points_mm)] = 0.0
        return out

    def holds(self, points_mm: Float64) -> NDArray[np.bool_]:
        """Between the walls."""
        return np.asarray(np.abs(points_mm[:, 0] - self.middle_mm) < self.half_width_mm)

    def _wall_distance(self, points_mm: Float64) -> Float64:
        """y+ (N,), zero in the walls."""
        distance = self.half_width_mm - np.abs(points_mm[:, 0] - self.middle_mm)
        return np.maximum(distance, 0.0) * self.friction_mm_s / self.viscosity_mm2_s
