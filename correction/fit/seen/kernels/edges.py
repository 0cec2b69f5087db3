"""Shades around the edges of a drawn board, see `correction.fit.seen.bent_view`."""

import math

import numpy as np

from ground.jit import Array, kernel

FAR = 6.0  # erf of more is 1 to the last bit


@kernel
def shade_edges(field: Array, finer: int, width: float, whole: bool, shade: Array) -> None:
    """Multiply a shade (M, M) by that of the edges of a field (M, M), drawn `finer` points a pixel.

    Edges are where the field is 0, or with `whole` a whole number, dark and bright in turn, as wide as an error
    function of `width` pixels.  Slopes are central differences, one-sided at the border, as of `numpy.gradient`.
    """
    rows, columns = field.shape
    for i in range(rows):
        above, below = max(i - 1, 0), min(i + 1, rows - 1)
        for j in range(columns):
            left, right = max(j - 1, 0), min(j + 1, columns - 1)
            along_v = (field[below, j] - field[above, j]) * finer / (below - above)
            along_u = (field[i, right] - field[i, left]) * finer / (right - left)
            level = np.rint(field[i, j]) if whole else 0.0
            slope = max(math.sqrt(along_v * along_v + along_u * along_u), 1e-12)
            off = (field[i, j] - level) / (slope * width)
            edge = math.copysign(1.0, off) if abs(off) >= FAR else math.erf(off)
            odd = level - 2.0 * math.floor(0.5 * level)
            shade[i, j] *= (1.0 - 2.0 * odd) * edge
