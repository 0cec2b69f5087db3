"""Rays that rounding calls a hit and the corrected foot point a miss: they pass, with derivatives as well."""

import mpmath
import numpy as np
from mpmath import mpf

from tracer.kernels.landing import STATE, trace_states
from tracer.kernels.rays import MAX_EVENTS
from tracer.kernels.world import RECOVERED, World
from tracer.strategies.trace import NO_CELLS

N = 1.5


def grazing(rng: np.random.Generator) -> tuple[list[float], np.ndarray]:
    """Numbers of a ray that touches a sphere to rounding, and the sphere."""
    radius = float(10.0 ** rng.uniform(-1.0, 2.0))
    away = radius * float(10.0 ** rng.uniform(0.5, 5.0))
    d, side, centre = rng.normal(size=(3, 3))
    d /= np.linalg.norm(d)
    side = np.cross(d, side)
    side /= np.linalg.norm(side)
    centre *= radius
    p = centre + radius * side * (1.0 + rng.uniform(-1.0, 1.0) * 1e-16 * away / radius) - away * d
    return [*p.tolist(), *d.tolist()], np.array([[*centre, radius, N, 0.0]])


def test_tangents_pass() -> None:
    """At 50 digits they miss, or bring less than 1e-11 of their light through; none is totally reflected."""
    trail, state = np.empty(MAX_EVENTS, np.int32), np.empty((MAX_EVENTS, STATE))
    rng, found, missed = np.random.default_rng(0), 0, 0
    with mpmath.workdps(50):
        while found < 60:
            numbers, table = grazing(rng)
            radius = float(table[0, 3])
            status, _, d_behind, _, events = trace_states(
                tuple(numbers[:3]), tuple(numbers[3:]), World(table, *NO_CELLS), trail, state
            )
            if events == 0 or state[0, 7] < radius * radius:
                continue
            found += 1
            assert status == RECOVERED
            assert list(d_behind) == numbers[3:]
            w = [mpf(x) - mpf(float(c)) for x, c in zip(numbers[:3], table[0, :3], strict=True)]
            d = list(map(mpf, numbers[3:]))
            along = sum(a * b for a, b in zip(w, d, strict=True))
            cosine2 = 1 - (sum(a * a for a in w) - along**2 / sum(b * b for b in d)) / mpf(radius) ** 2
            missed += cosine2 <= 0
            assert cosine2 <= 0 or (4 * mpmath.sqrt(cosine2)) ** 2 < 1e-11  # T < 4 cos i at each surface
    assert missed > 5
