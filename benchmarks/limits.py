"""What the machine allows: throughput of square roots and divisions, bandwidth of filling fresh-written arrays."""

import time
from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

REPEATS = 15
OPTIONS = {"nogil": True, "error_model": "numpy"}


@numba.njit(**OPTIONS)
def roots(x: NDArray[np.float64], y: NDArray[np.float64], rounds: int) -> None:
    """Square roots of what fits the first-level cache."""
    for _ in range(rounds):
        for i in range(x.shape[0]):
            y[i] = np.sqrt(x[i])


@numba.njit(**OPTIONS)
def quotients(x: NDArray[np.float64], y: NDArray[np.float64], rounds: int) -> None:
    """Divisions of what fits the first-level cache."""
    for _ in range(rounds):
        for i in range(x.shape[0]):
            y[i] = 1.0 / x[i]


@numba.njit(**OPTIONS)
def fill(first: int, last: int, out: NDArray[np.float64]) -> None:
    """Write rows."""
    for row in range(first, last):
        line = out[row]
        for i in range(line.shape[0]):
            line[i] = 1.0


def fill_map(shape: tuple[int, int]) -> Callable[[], NDArray[np.float64]]:
    """Task that fills plane points, status and branch numbers of a map of this shape."""
    point, status, branch = np.empty((*shape, 2)), np.empty(shape, np.uint8), np.empty(shape, np.uint16)
    lines = point.reshape(shape[0], -1)

    def work(first: int, last: int) -> None:
        for array in (lines, status, branch):
            fill(first, last, array)

    def task() -> NDArray[np.float64]:
        run_rows(work, shape[0])
        return point

    return task


def limits_of(scene: Scene, measured: dict[str, float]) -> dict[str, float]:
    """What a ray map must take at least [ms]: 2 roots a sphere met and 2 divisions a traced ray; writing it.

    "arithmetic" is processor time, "writing" wall clock, whatever the number of threads.
    """
    made = build_ray_map(scene)
    met = np.array([len(names) for names in made.branches])[made.branch]
    traced = float(np.count_nonzero(met))
    nanoseconds = 2.0 * float(met.sum()) * measured["sqrt_ns"] + 2.0 * traced * measured["div_ns"]
    stored = made.plane_mm.nbytes + made.status.nbytes + made.branch.nbytes
    return {"arithmetic": 1e-6 * nanoseconds, "writing": stored / measured["fill_gb_s"] * 1e-6}


def limits() -> dict[str, float]:
    """Nanoseconds of one core a root and a division; gigabytes a second of all threads filling 64 MB."""
    x, y = np.linspace(1.0, 2.0, 1024), np.empty(1024)
    result = {}
    for name, kernel in (("sqrt_ns", roots), ("div_ns", quotients)):
        kernel(x, y, 1)
        best = np.inf
        for _ in range(REPEATS):
            start = time.thread_time()
            kernel(x, y, 2000)
            best = min(best, time.thread_time() - start)
        result[name] = best / (2000 * 1024) * 1e9
    out = np.ones((2016, 4032))
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        run_rows(lambda first, last: fill(first, last, out), 2016)
        times.append(time.perf_counter() - start)
    result["fill_gb_s"] = out.nbytes / min(times) / 1e9
    return result
