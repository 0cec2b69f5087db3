"""What the machine allows: bandwidth of filling arrays."""

from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows

OPTIONS = {"nogil": True, "error_model": "numpy"}


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
