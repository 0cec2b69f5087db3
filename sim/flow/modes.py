"""Turbulence of unit strength: divergence-free random Fourier modes of a known spectrum and a known memory.

    q(x, t) = sum_m  a_m cos(k_m.x + w_m t + p_m) + b_m sin(k_m.x + w_m t + p_m)

with a_m and b_m at right angles to k_m and to each other, of equal length: every mode is free of divergence
(Kraichnan, Phys. Fluids 13, 22 (1970)).  Wave vectors come in threes at right angles to each other, of equal
length and strength, so that the sum of a a^T + b b^T over all modes is exactly 2 I: averaged over phases or a long
time <q_i q_j> = delta_ij everywhere, without the scatter of a finite number of modes.  Other averages follow by
the same sum and are exact for THIS set of modes: `covariance`, `autocorrelation`.

Strengths follow von Karman's spectrum  E(k) ~ k^4 / (1 + (k/k_e)^2)^(17/6)  between the longest and the shortest
wave, with k_e = 0.746834 / L of the longitudinal integral length L (Hinze, Turbulence, 1975).  Frequencies are
drawn from a Gaussian of standard deviation 1/tau, so memory fades like  rho(s) = exp(-s^2 / (2 tau^2)), smoothly
at s = 0 as in a real flow; pairs taken 3 tau apart know nothing of each other (rho = 0.011).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from sim.flow.kernels.modes import add_modes
from tracer.errors import SceneError

Float64 = NDArray[np.float64]

THREES = 24  # sets of three modes; 72 modes scatter the autocorrelation by 0.1
PEAK = 0.746834  # k_e times the integral length
MODE_BLOCK_POINTS = 1024  # stays in the first cache with its three components


@dataclass(frozen=True)
class RandomModes:
    """Unit turbulence, see above.

    Parameters
    ----------
    length_mm : float
        Longitudinal integral length.
    memory_s : float
        tau; infinite freezes the turbulence.
    seed : int
        Of wave vectors, phases and frequencies.
    shortest_mm, longest_mm : float, optional
        Wave lengths at the ends of the spectrum; by default a third of the length, and ten lengths.
    threes : int
        Sets of three modes.
    """

    length_mm: float
    memory_s: float = 0.02
    seed: int = 0
    shortest_mm: float | None = None
    longest_mm: float | None = None
    threes: int = THREES

    def __post_init__(self) -> None:
        if not self.length_mm > 0.0 or not self.memory_s > 0.0 or self.threes < 1:
            raise SceneError("length_mm, memory_s and threes of a turbulence must be positive")
        if not 0.0 < self._ends_mm[0] < self._ends_mm[1]:
            raise SceneError("the shortest wave of a turbulence must be shorter than its longest")

    @property
    def _ends_mm(self) -> tuple[float, float]:
        shortest = self.length_mm / 3.0 if self.shortest_mm is None else self.shortest_mm
        return shortest, 10.0 * self.length_mm if self.longest_mm is None else self.longest_mm

    @cached_property
    def _modes(self) -> tuple[Float64, Float64, Float64, Float64, Float64]:
        """Wave vectors (M, 3) [1/mm], frequencies (M,) [rad/s], phases (M,), cosine and sine amplitudes (M, 3)."""
        rng = np.random.default_rng(self.seed)
        edges = np.geomspace(2.0 * np.pi / self._ends_mm[1], 2.0 * np.pi / self._ends_mm[0], self.threes + 1)
        k = np.sqrt(edges[:-1] * edges[1:])
        energy = k**4 / (1.0 + np.square(k * self.length_mm / PEAK)) ** (17.0 / 6.0) * np.diff(edges)
        energy /= energy.sum()
        count = 3 * self.threes
        waves, cosine, sine = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
        for i in range(self.threes):
            axes, _ = np.linalg.qr(rng.standard_normal((3, 3)))
            for j in range(3):
                turn = rng.uniform(0.0, 2.0 * np.pi)
                one, other = axes[:, (j + 1) % 3], axes[:, (j + 2) % 3]
                waves[3 * i + j] = k[i] * axes[:, j]
                cosine[3 * i + j] = np.sqrt(energy[i]) * (np.cos(turn) * one + np.sin(turn) * other)
                sine[3 * i + j] = np.sqrt(energy[i]) * (np.cos(turn) * other - np.sin(turn) * one)
        frequencies = rng.standard_normal(count) / self.memory_s
        return waves, frequencies, rng.uniform(0.0, 2.0 * np.pi, count), cosine, sine

    def at(self, points_mm: Float64, time_s: float) -> Float64:
        """Q (N, 3) at points (N, 3)."""
        waves, frequencies, phases, cosine, sine = self._modes
        points = np.ascontiguousarray(np.asarray(points_mm, np.float64).T)
        offset = np.mod((frequencies * time_s + phases) / (2.0 * np.pi), 1.0)
        out = np.empty_like(points)

        def block(first: int, last: int) -> None:
            part = np.empty((3, last - first))
            add_modes(
                np.ascontiguousarray(points[:, first:last]), waves / (2.0 * np.pi), offset, cosine, sine, part
            )
            out[:, first:last] = part

        run_rows(block, points.shape[1], MODE_BLOCK_POINTS)
        return np.ascontiguousarray(out.T)

    def covariance(self, apart_mm: Float64, lag_s: float = 0.0) -> Float64:
        """<q_i(x, t) q_j(x + r, t + s)> (..., 3, 3) of this set of modes, for separations r (..., 3)."""
        waves, frequencies, _, a, b = self._modes
        angle = np.asarray(apart_mm, np.float64) @ waves.T + frequencies * lag_s
        even = 0.5 * (np.einsum("mi,mj->mij", a, a) + np.einsum("mi,mj->mij", b, b))
        odd = 0.5 * (np.einsum("mi,mj->mij", a, b) - np.einsum("mi,mj->mij", b, a))
        return np.asarray(np.tensordot(np.cos(angle), even, 1) + np.tensordot(np.sin(angle), odd, 1))

    def autocorrelation(self, lag_s: float) -> float:
        """Return rho at one point after a lag: a third of the trace of `covariance`."""
        return float(np.trace(self.covariance(np.zeros(3), lag_s)) / 3.0)

    def spectrum(self) -> tuple[Float64, Float64]:
        """Wave numbers (threes,) [rad/mm] and the share of <q.q>/2 = 3/2 that each holds."""
        waves, _, _, a, _ = self._modes
        energy = np.sum(np.square(a), axis=1).reshape(-1, 3).sum(axis=1)
        return np.linalg.norm(waves[::3], axis=1), energy / energy.sum() * 1.5
