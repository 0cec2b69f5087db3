"""Copies of finished pixels for scenes that are their own mirror image.

If nothing changes under x -> -x, pixel W - 1 - u sees (-x, y) where pixel u sees (x, y): rounding is the same for
both signs, so the bits are those of tracing it.  Then half of the columns are traced and copied; the same for
y -> -y and rows.  Bodies may change places: ``swap`` (2^N + 1,) int64 says which branch number becomes which, the
last one for UNKNOWN; empty: all stay.
"""

from typing import NamedTuple

from ground.jit import Array, kernel


class Mirrors(NamedTuple):
    """Mirror images that a scene is of itself, and which branch number becomes which."""

    in_x: bool
    in_y: bool
    swap_x: Array
    swap_y: Array


@kernel
def mirror_left_right(
    count: int, swap: Array, p: Array, s: Array, b: Array, point: Array, status: Array, branch: Array
) -> None:
    """Write what p (2 n,), s, b (n,) hold mirrored in x: the last pixel comes first."""
    last, most = count - 1, swap.shape[0] - 1
    for i in range(count):
        point[2 * i], point[2 * i + 1] = 0.0 - p[2 * (last - i)], p[2 * (last - i) + 1]
    for i in range(count):
        status[i] = s[last - i]
    if most < 0:
        for i in range(count):
            branch[i] = b[last - i]
    else:
        for i in range(count):
            branch[i] = swap[min(b[last - i], most)]


@kernel
def mirror_up_down(
    count: int, swap: Array, p: Array, s: Array, b: Array, point: Array, status: Array, branch: Array
) -> None:
    """Write what p (2 n,), s, b (n,) hold mirrored in y."""
    most = swap.shape[0] - 1
    for i in range(count):
        point[2 * i], point[2 * i + 1] = p[2 * i], 0.0 - p[2 * i + 1]
    for i in range(count):
        status[i] = s[i]
    if most < 0:
        for i in range(count):
            branch[i] = b[i]
    else:
        for i in range(count):
            branch[i] = swap[min(b[i], most)]
