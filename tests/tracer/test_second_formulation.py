"""Very many random rays against a second formulation: roots of quadratics, normals, Snell's law at each surface.

It shares no formula with the kernels: spheres are met at the smaller root, in the order of these roots, their
cores likewise; it runs in float64 as well, so that agreement is asked for to what its own cancellations leave, and
not at all from rays that come within GRAZE of a rim or of total reflection, where either answer is right.
"""

from collections.abc import Callable

import numba
import numpy as np
import pytest

from tests.tracer.scenes import random_scene
from tests.tracer.second_formulation import numbered, second
from tracer.strategies.trace import RayStatus, trace

GRAZE = 1e-9  # of R^2


def compare(count: int, seed: int, of_a_scene: int, second: Callable[..., None]) -> tuple[int, float, int]:
    """Rays compared, largest difference of calm rays, rays on another way; every second scene has cores."""
    rng = np.random.default_rng(seed)
    compared, worst, wrong = 0, 0.0, 0
    while compared < count:
        where = random_scene(rng, most=8, cores=compared % (2 * of_a_scene) == 0)
        height, width = where.camera.shape
        pixels = rng.uniform((-0.5, -0.5), (width - 0.5, height - 0.5), (of_a_scene, 2))
        result = trace(where, pixels)
        rays = result.rays
        out = np.empty((of_a_scene, 6))
        second(np.array(where.camera.position_mm), where.camera.directions(pixels), where.sphere_table(), out)
        clear = (out[:, 3] > GRAZE) & (np.abs(out[:, 4]) > GRAZE)
        back = (out[:, 2] < 0) == (rays["status"] == RayStatus.TIR)
        events = (out[:, 2] < 0) | (out[:, 2] == numbered(where, result))
        wrong += int((clear & ~(back & events)).sum())
        calm = clear & back & events & (rays["status"] == RayStatus.RECOVERED)
        calm &= (out[:, 4] > 0.3) & (out[:, 5] < -0.2)
        apart = np.hypot(out[calm, 0] - rays["x_mm"][calm], out[calm, 1] - rays["y_mm"][calm])
        worst = max(worst, float(apart.max(initial=0.0)))
        compared += of_a_scene
    return compared, worst, wrong


def check(count: int, seed: int, of_a_scene: int, second: Callable[..., None] = second) -> None:
    compared, worst, wrong = compare(count, seed, of_a_scene, second)
    print(f"{compared} rays: {wrong} on another way, calm ones at most {worst:.1e} mm apart")
    assert compared >= count
    assert wrong == 0
    assert worst < 1e-6  # what a quadratic leaves of a far camera's digits


def test_some_thousand_rays() -> None:
    check(5_000, 0, 500)


@pytest.mark.slow
def test_a_hundred_million_rays() -> None:
    check(100_000_000, 1, 25_000, numba.njit(error_model="numpy")(second))
