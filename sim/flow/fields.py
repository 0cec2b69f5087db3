"""Prescribed velocity fields: a mean that is free of divergence, and fluctuations whose stresses are known.

A flow is  u(x, t) = U(x) + A(x) q(x, t)  with a steady mean U, an amplitude matrix A, and unit turbulence q
(`sim.flow.modes`).  Because <q> = 0 and <q q^T> = I exactly,

    <u> = U        <u' u'^T> = A A^T

everywhere.  q is free of divergence; A q is where A is uniform, and has div(A q) = (div A).q otherwise: of the
order of A over the length on which A changes, and zero on average, so the mean flow conserves mass in any case.
Lower triangular A in the frame of the flow gives any stress wanted: A_11 = sqrt(R_11), A_21 = R_21 / A_11, ...

Points are (N, 3) in mm in the world (x right, y up, z towards the camera), velocities (N, 3) in mm/s.

**Channels** between two walls x = +-h flow along +y: laminar, or with the mean and stresses of turbulence.

Laminar:  U = U_max (1 - (x/h)^2), no fluctuations.

Turbulent-like:  U = u_tau u+(y+), y+ = (h - |x|) u_tau / nu, by Reichardt's law of the wall (ZAMM 31, 208 (1951))

    u+ = ln(1 + 0.4 y+)/0.4 + 7.8 (1 - exp(-y+/11) - (y+/11) exp(-y+/3))

and the shear stress that this mean needs, exactly:  -<u'v'> = u_tau^2 (1 - y/h) - nu dU/dy.  Where the law of the
wall asks for less than nothing (4 % of u_tau^2 below y+ = 3, a thousandth in the middle) it is zero.  The other
stresses are shaped like measured ones (Moser, Kim and Mansour, Phys. Fluids 11, 943 (1999)):  <v'v'>+ along the
flow peaks near y+ = 15 with about 7, <u'u'>+ across reaches 0.8 and <w'w'>+ 1.6, all zero at the wall.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from sim.flow.modes import RandomModes
from tracer.camera import Vector3
from tracer.errors import SceneError

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]


@runtime_checkable
class MeanFlow(Protocol):
    """A steady flow with the strength of its fluctuations."""

    def mean(self, points_mm: Float64) -> Float64:
        """U (N, 3) [mm/s]."""

    def amplitude(self, points_mm: Float64) -> Float64:
        """A (N, 3, 3) [mm/s]; A A^T are the Reynolds stresses."""

    def holds(self, points_mm: Float64) -> Bool:
        """Return whether there is fluid (N,): behind walls there are no particles."""


@dataclass(frozen=True)
class Flow:
    """A flow in time: what particles move in.

    Parameters
    ----------
    base : MeanFlow
        Mean and amplitude.
    modes : RandomModes, optional
        Unit turbulence; None for a steady flow.
    """

    base: MeanFlow
    modes: RandomModes | None = None

    def velocity(self, points_mm: Float64, time_s: float) -> Float64:
        """U (N, 3) [mm/s] at points (N, 3) [mm]."""
        points = np.asarray(points_mm, np.float64)
        velocity = self.base.mean(points)
        amplitude = self.base.amplitude(points) if self.modes is not None else np.empty(0)
        if self.modes is not None and amplitude.any():
            velocity = velocity + np.einsum("nij,nj->ni", amplitude, self.modes.at(points, time_s))
        return velocity

    def mean(self, points_mm: Float64) -> Float64:
        """<u> (N, 3) [mm/s]."""
        return self.base.mean(np.asarray(points_mm, np.float64))

    def stresses(self, points_mm: Float64) -> Float64:
        """<u' u'^T> (N, 3, 3) [mm^2/s^2]."""
        points = np.asarray(points_mm, np.float64)
        if self.modes is None:
            return np.zeros((len(points), 3, 3))
        amplitude = self.base.amplitude(points)
        return np.asarray(amplitude @ np.swapaxes(amplitude, 1, 2))

    def holds(self, points_mm: Float64) -> Bool:
        """Return whether there is fluid (N,)."""
        return self.base.holds(np.asarray(points_mm, np.float64))


@dataclass(frozen=True)
class Uniform:
    """The same velocity everywhere, with isotropic fluctuations.

    Parameters
    ----------
    velocity_mm_s : Vector3
        U.
    stresses_mm2_s2 : tuple of six floats
        <u'u'>, <v'v'>, <w'w'>, <u'v'>, <u'w'>, <v'w'>, everywhere the same.
    """

    velocity_mm_s: Vector3 = (0.0, 0.0, 0.0)
    stresses_mm2_s2: tuple[float, float, float, float, float, float] = (0.0,) * 6

    def __post_init__(self) -> None:
        cholesky_of(self.stresses_mm2_s2)

    def mean(self, points_mm: Float64) -> Float64:
        """U (N, 3)."""
        return np.asarray(np.zeros((len(points_mm), 3)) + np.array(self.velocity_mm_s))

    def amplitude(self, points_mm: Float64) -> Float64:
        """A (N, 3, 3)."""
        return np.broadcast_to(cholesky_of(self.stresses_mm2_s2), (len(points_mm), 3, 3))

    def holds(self, points_mm: Float64) -> Bool:
        """Everywhere."""
        return np.ones(len(points_mm), np.bool_)


@dataclass(frozen=True)
class Shear(Uniform):
    """Uniform velocity plus a linear one: U = U_0 + G (p - p_0), G free of trace.

    Parameters
    ----------
    gradient_per_s : 3 x 3 tuple
        G: rows are components of the velocity, columns directions; the sum of its diagonal is zero.
    about_mm : Vector3
        p_0.
    """

    gradient_per_s: tuple[Vector3, Vector3, Vector3] = ((0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    about_mm: Vector3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if abs(np.trace(np.array(self.gradient_per_s))) > 1e-9 * np.abs(self.gradient_per_s).max():
            raise SceneError("the diagonal of gradient_per_s must add up to zero: a gas is not made on the way")

    def mean(self, points_mm: Float64) -> Float64:
        """U (N, 3)."""
        turned = (points_mm - np.array(self.about_mm)) @ np.array(self.gradient_per_s).T
        return np.asarray(super().mean(points_mm) + turned)


@dataclass(frozen=True)
class Vortex(Uniform):
    """A Lamb-Oseen vortex whose axis is parallel to z, in a uniform flow.

    u_theta = v_max (1 + 1/(2 a)) (r_c/r) (1 - exp(-a r^2/r_c^2)) with a = 1.25643: v_max at r = r_c
    (Devenport et al., J. Fluid Mech. 312, 67 (1996)).

    Parameters
    ----------
    core_mm : float
        r_c.
    fastest_mm_s : float
        v_max; positive turns from x to y.
    about_mm : Vector3
        A point of the axis.
    """

    core_mm: float = 10.0
    fastest_mm_s: float = 300.0
    about_mm: Vector3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.core_mm > 0.0:
            raise SceneError("core_mm of a vortex must be positive")

    def mean(self, points_mm: Float64) -> Float64:
        """U (N, 3)."""
        alpha = 1.2564312086261697
        x, y = points_mm[:, 0] - self.about_mm[0], points_mm[:, 1] - self.about_mm[1]
        s = np.square(np.hypot(x, y) / self.core_mm)
        # (1 - exp(-a s))/s goes to a at the axis.
        turn = np.where(s > 1e-12, -np.expm1(-alpha * s) / np.maximum(s, 1e-12), alpha)
        turn = turn * self.fastest_mm_s * (1.0 + 0.5 / alpha) / self.core_mm
        velocity = super().mean(points_mm)
        velocity[:, 0] -= turn * y
        velocity[:, 1] += turn * x
        return velocity


def cholesky_of(stresses: tuple[float, float, float, float, float, float]) -> Float64:
    """Lower triangular A (3, 3) with A A^T of the six stresses; a direction without any may be left out.

    Raises
    ------
    SceneError
        No fluctuation has these stresses: a correlation lies beyond 1.
    """
    uu, vv, ww, uv, uw, vw = stresses
    wanted = np.array([[uu, uv, uw], [uv, vv, vw], [uw, vw, ww]])
    out = np.zeros((3, 3))
    for i in range(3):
        for j in range(i + 1):
            rest = wanted[i, j] - out[i, :j] @ out[j, :j]
            if i == j:
                if rest < -1e-9 * max(wanted.max(), 0.0):
                    raise SceneError("no fluctuation has these stresses: a correlation lies beyond 1")
                out[i, i] = np.sqrt(max(rest, 0.0))
            elif out[j, j] > 0.0:
                out[i, j] = rest / out[j, j]
            elif abs(rest) > 1e-9 * max(wanted.max(), 0.0):
                raise SceneError("a component that does not fluctuate cannot be correlated with another")
    return out


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
