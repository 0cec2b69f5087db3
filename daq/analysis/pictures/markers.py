"""A chessboard with coloured markers along the south-east diagonal, as in Fig. 4 of Martins et al. (2018).

Behind a lens one sees at a glance which part of the plane is magnified, turned over, or shown twice.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Shape = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]


def _cross(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (np.minimum(abs(x), abs(y)) < 0.28) & (np.maximum(abs(x), abs(y)) < 1.0)


def _circle(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.hypot(x, y) < 0.9


def _square(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.maximum(abs(x), abs(y)) < 0.8


def _diamond(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    return abs(x) + abs(y) < 1.0


def _triangle(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (y > -0.7) & (2.0 * abs(x) + y < 1.0)


SHAPES: tuple[Shape, ...] = (_cross, _circle, _square, _diamond, _triangle)
COLOURS = ("#ffffff", "#d62728", "#1f77b4", "#e377c2", "#ffd92f", "#ff7f0e", "#7f7f7f", "#8c564b", "#2ca02c")
SPACING_MM = 5.0 / 2**0.5 * 1.2  # between markers along each axis
SIZE_MM = 1.9


def markers(
    square_mm: float = 2.5, reach_mm: float = 70.0
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Pattern of the board with markers.

    Parameters
    ----------
    square_mm : float
        Side of the squares.
    reach_mm : float
        Markers go as far along x and -y.

    Returns
    -------
    callable
        Plane points (..., 2) [mm] -> RGB (..., 3) in 0..1.
    """
    count = int(reach_mm / SPACING_MM) + 1

    def pattern(plane_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = plane_mm[..., 0], plane_mm[..., 1]
        bright = (np.floor(x / square_mm) + np.floor(y / square_mm)) % 2.0
        rgb = np.repeat((0.12 + 0.76 * bright)[..., None], 3, axis=-1)
        along = np.rint((x - y) / (2.0 * SPACING_MM))
        number = np.clip(along, 0, count - 1).astype(int)
        local_x, local_y = (x - number * SPACING_MM) / SIZE_MM, (y + number * SPACING_MM) / SIZE_MM
        near = (np.maximum(abs(local_x), abs(local_y)) < 1.0) & (along >= 0)
        for k in range(count):
            inside = near & (number == k)
            inside[inside] = SHAPES[k % len(SHAPES)](local_x[inside], local_y[inside])
            rgb[inside] = _rgb(COLOURS[k % len(COLOURS)])
        return rgb

    return pattern


def _rgb(colour: str) -> tuple[float, float, float]:
    return (int(colour[1:3], 16) / 255.0, int(colour[3:5], 16) / 255.0, int(colour[5:7], 16) / 255.0)
