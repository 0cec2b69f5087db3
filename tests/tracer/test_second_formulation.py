"""Very many random rays against a second formulation: roots of quadratics, normals, Snell's law at each surface.

It shares no formula with the kernels: spheres are met at the smaller root, in the order of these roots; it runs in
float64 as well, so that agreement is asked for to what its own cancellations leave, and not at all from rays that
come within GRAZE of a rim, where either answer is right.
"""

import math

import numba
import numpy as np
import pytest

from tests.tracer.scenes import random_scene
from tracer.status import RayStatus
from tracer.trace import trace

GRAZE = 1e-9  # of R^2
CHUNK = 500_000


@numba.njit(error_model="numpy")
def second(eye: np.ndarray, ways: np.ndarray, spheres: np.ndarray, out: np.ndarray) -> None:
    """Per ray (N, 6): plane point x, y, spheres crossed (-1: turned back), distance from a rim, steepest, down."""
    for ray in range(ways.shape[0]):
        x, y, z = eye
        u, v, w = ways[ray]
        last, crossed, near, steep = -1, 0, math.inf, 1.0
        while True:
            best, first = -1, math.inf
            for k in range(spheres.shape[0]):
                if k == last:
                    continue
                a, b, c, r2 = x - spheres[k, 0], y - spheres[k, 1], z - spheres[k, 2], spheres[k, 3] ** 2
                half = a * u + b * v + c * w
                if half < 0.0:
                    root = half * half - (a * a + b * b + c * c - r2)
                    near = min(near, abs(root) / r2)
                    if root > 0.0 and -half - math.sqrt(root) < first:
                        best, first = k, -half - math.sqrt(root)
            if best < 0:
                break
            n, radius = spheres[best, 4], spheres[best, 3]
            for leaving in (False, True):
                x, y, z = x + first * u, y + first * v, z + first * w
                a, b, c = x - spheres[best, 0], y - spheres[best, 1], z - spheres[best, 2]
                sign, eta = (-1.0, n) if leaving else (1.0, 1.0 / n)
                a, b, c = sign * a / radius, sign * b / radius, sign * c / radius
                cosine = -(a * u + b * v + c * w)
                steep = min(steep, cosine)
                rest = 1.0 - eta * eta * (1.0 - cosine * cosine)
                if rest < 0.0:
                    crossed = -1
                    break
                bend = eta * cosine - math.sqrt(rest)
                u, v, w = eta * u + bend * a, eta * v + bend * b, eta * w + bend * c
                length = math.sqrt(u * u + v * v + w * w)
                u, v, w = u / length, v / length, w / length
                first = -2.0 * radius * (a * u + b * v + c * w)  # the chord, from the normal outwards
            if crossed < 0:
                break
            crossed, last = crossed + 1, best
        out[ray, 0], out[ray, 1], out[ray, 2] = x - z / w * u, y - z / w * v, crossed
        out[ray, 3], out[ray, 4], out[ray, 5] = near, steep, w


def compare(count: int, seed: int) -> tuple[int, float, int]:
    """Rays compared, largest difference of calm rays, rays on another way."""
    rng = np.random.default_rng(seed)
    compared, worst, wrong = 0, 0.0, 0
    while compared < count:
        where = random_scene(rng, most=8)
        height, width = where.camera.shape
        pixels = rng.uniform((-0.5, -0.5), (width - 0.5, height - 0.5), (CHUNK, 2))
        rays = trace(where, pixels).rays
        out = np.empty((CHUNK, 6))
        second(np.array(where.camera.position_mm), where.camera.directions(pixels), where.sphere_table(), out)
        clear = (out[:, 3] > GRAZE) & (np.abs(out[:, 4]) > GRAZE)
        back = (out[:, 2] < 0) == (rays["status"] == RayStatus.TIR)
        events = (out[:, 2] < 0) | (out[:, 2] == rays["events"])
        wrong += int((clear & ~(back & events)).sum())
        calm = clear & back & events & (rays["status"] == RayStatus.RECOVERED)
        calm &= (out[:, 4] > 0.3) & (out[:, 5] < -0.2)
        apart = np.hypot(out[calm, 0] - rays["x_mm"][calm], out[calm, 1] - rays["y_mm"][calm])
        worst = max(worst, float(apart.max(initial=0.0)))
        compared += CHUNK
    return compared, worst, wrong


def check(count: int, seed: int) -> None:
    compared, worst, wrong = compare(count, seed)
    print(f"{compared} rays: {wrong} on another way, calm ones at most {worst:.1e} mm apart")
    assert compared >= count
    assert wrong == 0
    assert worst < 1e-6  # what a quadratic leaves of a far camera's digits


def test_two_million_rays() -> None:
    check(2_000_000, 0)


@pytest.mark.slow
def test_a_hundred_million_rays() -> None:
    check(100_000_000, 1)
