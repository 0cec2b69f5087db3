"""A free round jet from a pipe: core, mixing layer and self-similar jet in one formula, free of divergence.

Momentum spreads like heat (Reichardt, VDI-Forschungsheft 414 (1942)): U^2 behind an opening of radius R with exit
speed U_0 is the top hat U_0^2 blurred by a Gaussian whose width grows with the distance s,

    U^2(r, s) = U_0^2 P(r/R, sigma(s)/R),   P(a, b) = chance that a Gaussian step of
    deviation b from a ends inside the unit circle,     sigma = sqrt((c_0 R)^2 + (c s)^2)

so the flux of momentum is the same at every s, the core is gone some five diameters from the exit, and far away
U -> U_0 (R / (sqrt(2) sigma)) exp(-r^2/(4 sigma^2)): half width sqrt(4 ln 2) c s, which is 0.094 s (Pope,
Turbulent Flows, ch. 5) for c = 0.0565, and decay as 1/s.  The radial velocity follows from mass: with H(r, s), the
mean of U over the disc of radius r,

    U = H + (r/2) dH/dr,    V_r = -(r/2) dH/ds

which has no divergence for ANY smooth H; H is tabulated once and interpolated with slopes that go on from cell
to cell.

Fluctuations, in the frame (along the axis s, radial r, around): e is their standard deviation along the axis,

    e^2 = (i U_c(s) g(s) exp(-r^2/(6 sigma^2)))^2 + (j sigma dU/dr)^2,    g = 1 - exp(-s / (4 D))
    R_ss = e^2,   R_rr = R_tt = (0.8 e)^2,   R_sr = 0.8 e^2 rho(r),   rho = 0.8 x/(1 + x^2),  x = r/(2 sigma)

so u'v' is zero on the axis and carries momentum outwards beside it.  The fluctuation itself goes on smoothly
there: its amplitude is a symmetric tensor across the axis, not one that turns with the outward direction alone.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from ground.rows import run_rows
from sim.flow.kernels.jet import jet_at
from tracer.camera import Vector3
from tracer.errors import SceneError

Float64 = NDArray[np.float64]

GROWTH = 0.0565  # c
EXIT_GROWTH = 0.08  # c_0: boundary layer of the pipe
ROWS, COLUMNS = 240, 1200
BLOCK_POINTS = 4096


@dataclass(frozen=True)
class Jet:
    """A round jet that rises along +y.

    Parameters
    ----------
    exit_mm : Vector3
        Middle of the pipe's end.
    diameter_mm : float
        Inner diameter of the pipe.
    exit_mm_s : float
        Speed at the exit.
    intensity : float
        i: standard deviation along the axis over the speed of the axis, far from the exit.
    layer_intensity : float
        j: what the mixing layer adds.
    reach_mm : float
        The flow is tabulated so far from the exit, along and across; nothing is asked beyond.
    """

    exit_mm: Vector3 = (0.0, -88.0, 0.0)
    diameter_mm: float = 5.0
    exit_mm_s: float = 1940.0
    intensity: float = 0.25
    layer_intensity: float = 0.2
    reach_mm: float = 260.0

    def __post_init__(self) -> None:
        if not (self.diameter_mm > 0.0 and self.reach_mm > self.diameter_mm):
            raise SceneError("diameter_mm of a jet must be positive and below reach_mm")

    def mean(self, points_mm: Float64) -> Float64:
        """U (N, 3) [mm/s]; below the exit the jet is that of the exit."""
        return self._at(points_mm, has_amplitude=False)[0]

    def amplitude(self, points_mm: Float64) -> Float64:
        """A (N, 3, 3) [mm/s], in the world's axes."""
        return self._at(points_mm, has_amplitude=True)[1]

    def holds(self, points_mm: Float64) -> NDArray[np.bool_]:
        """Everywhere: the seeded room is larger than the jet."""
        return np.ones(len(points_mm), np.bool_)

    @cached_property
    def _tables(self) -> tuple[Float64, Float64, Float64, Float64]:
        """H/U_0 and U/U_0 over (log sigma/R, log(1 + r/R)), first coordinates, steps.

        A cell more on either side: in r the flow is even, so the column before the axis mirrors the one behind.
        """
        ends = np.log(EXIT_GROWTH), np.log(2.0 * GROWTH * self.reach_mm / self.diameter_mm) + 0.05
        widths, step = np.linspace(*ends, ROWS, retstep=True)
        widths = np.concatenate(([widths[0] - step], widths, [widths[-1] + step]))
        places = np.linspace(0.0, np.log1p(2.0 * self.reach_mm / self.diameter_mm) + 0.02, COLUMNS)
        squared = np.square(np.expm1(places))
        disc, speed = np.empty((2, len(widths), len(places) + 1))
        for i, width in enumerate(np.exp(widths)):
            # Chance to end inside the unit circle: non-central chi-square with two degrees of freedom.
            speed[i, 1:] = np.sqrt(_inside(1.0 / width**2, squared / width**2))
            # Mean over the disc by Simpson's rule in r^2.
            middle = np.sqrt(_inside(1.0 / width**2, 0.5 * (squared[1:] + squared[:-1]) / width**2))
            parts = (speed[i, 2:] + 4.0 * middle + speed[i, 1:-1]) * np.diff(squared) / 6.0
            disc[i, 1] = speed[i, 1]
            disc[i, 2:] = np.cumsum(parts) / squared[1:]
        disc[:, 0], speed[:, 0] = disc[:, 2], speed[:, 2]
        return disc, speed, np.array([widths[0], -places[1]]), np.array([step, places[1]])

    def _at(self, points_mm: Float64, *, has_amplitude: bool) -> tuple[Float64, Float64]:
        points = np.ascontiguousarray(points_mm, np.float64)
        pipe = np.array(
            (
                *self.exit_mm,
                0.5 * self.diameter_mm,
                self.exit_mm_s,
                EXIT_GROWTH,
                GROWTH,
                self.intensity,
                self.layer_intensity,
            )
        )
        mean = np.empty((len(points), 3))
        amplitude = np.empty((len(points) if has_amplitude else 0, 3, 3))

        def block(first: int, last: int) -> None:
            part = slice(first, last)
            jet_at(points[part], pipe, *self._tables, mean[part], amplitude[part])

        run_rows(block, len(points), BLOCK_POINTS)
        return mean, amplitude


def _inside(x: float, off_centre: Float64) -> Float64:
    """Non-central chi-square distribution of two degrees of freedom; as by scipy.stats, which loads slowly."""
    central = scipy.special.chdtr(2, x)
    return np.asarray(np.where(off_centre == 0.0, central, scipy.special.chndtr(x, 2, off_centre)))
