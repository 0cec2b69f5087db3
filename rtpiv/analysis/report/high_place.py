"""The place that stands for the highest speed of a field at the head of a page."""

import numpy as np
from numpy.typing import NDArray

HIGH = 0.99  # of all speeds
LEAST_AROUND = 5  # of eight neighbours that are valid


def high_place(speed: NDArray[np.float64], where: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the place whose speed 1 % of others exceed, one at least, of those with most neighbours valid.

    Parameters
    ----------
    speed : ndarray (ny, nx)
        Speeds.
    where : ndarray of bool (ny, nx)
        Places that count, one at least.
    """
    padded = np.pad(where, 1).astype(int)
    rows, columns = where.shape
    around = sum(padded[i : i + rows, k : k + columns] for i in range(3) for k in range(3)) - where
    for least in (LEAST_AROUND, 1, 0):
        usable = where & (around >= least)
        if usable.any():
            break
    level = np.quantile(speed[usable], HIGH, method="lower")
    row, column = np.argwhere(usable & (speed == level))[0]
    return int(row), int(column)
