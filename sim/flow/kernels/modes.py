"""Sum of Fourier modes at many points: the loop that costs most of a simulated pair of a turbulent flow.

The sine and cosine of a turn are polynomials of the fraction of a turn, because a loop over particles without a
call is vectorised; they are right to 1e-9, far below what a velocity means.
"""

import numpy as np

from ground.jit import Array, kernel, kernel_inlined


@kernel_inlined
def sine_of_turn(turn: float) -> float:
    """Sine of a number of turns, right to 1e-9."""
    x = turn - np.floor(turn + 0.5)  # -1/2 .. 1/2
    x = 0.25 - abs(x - 0.25) if x > 0.0 else abs(x + 0.25) - 0.25  # folded to a quarter: -1/4 .. 1/4
    a = 6.283185307179586 * x
    b = a * a
    series = 1.0 + b * (
        -1.6666666666666666e-1
        + b
        * (
            8.333333333333333e-3
            + b
            * (-1.984126984126984e-4 + b * (2.7557319223985893e-6 + b * (-2.505210838544172e-8 + b * 1.6059e-10)))
        )
    )
    return float(a * series)


@kernel
def add_modes(points: Array, turns: Array, offset: Array, cosine: Array, sine: Array, out: Array) -> None:
    """Sum up cosine[m] cos(2 pi t) + sine[m] sin(2 pi t) with t = turns[m].p + offset[m] into `out` (3, N).

    `points` (3, N) [mm], `turns` (M, 3) wave numbers in turns per mm, `offset` (M,) in turns.
    """
    count = points.shape[1]
    for axis in range(3):
        for i in range(count):
            out[axis, i] = 0.0
    for m in range(turns.shape[0]):
        kx, ky, kz, start = turns[m, 0], turns[m, 1], turns[m, 2], offset[m]
        cx, cy, cz = cosine[m, 0], cosine[m, 1], cosine[m, 2]
        sx, sy, sz = sine[m, 0], sine[m, 1], sine[m, 2]
        for i in range(count):
            t = kx * points[0, i] + ky * points[1, i] + kz * points[2, i] + start
            s, c = sine_of_turn(t), sine_of_turn(t + 0.25)
            out[0, i] += cx * c + sx * s
            out[1, i] += cy * c + sy * s
            out[2, i] += cz * c + sz * s
