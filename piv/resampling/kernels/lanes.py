"""Two steps written in vector registers by hand, because the compiler cannot find them in the scalar form.

Interpolation gathers: where a sample lies is known only from data, so the compiler can neither prove that what is
read and what is written are apart, nor may it reorder a sum.  Both steps below touch neighbouring memory, though:

* `footprint_sum`, the 6 x 6 products of the quintic spline: a row of the footprint is one load of eight lanes (the
  last two weigh nothing), so six rows are six multiply-adds; the six weights along a row are one polynomial of
  fifth degree whose coefficients differ by lane.  3 ns a sample instead of 20.
* `copy_pair`, two neighbouring pixels as one integer of twice the width, whatever their type.

Each is an ordinary Python function, the definition, which compiled code replaces by the vectors (`lane_code`);
the sums differ by the order of their terms and nothing else.
"""

from fractions import Fraction
from math import comb
from typing import Any

import numpy as np

from ground.jit import Array, overload

Code = Any  # a type of numba, or who writes for it

TAPS = 6
WIDE = 8  # lanes read a row of the footprint: the coefficients must reach that far, and be finite


def _tap_polynomials() -> list[list[float]]:
    """Coefficients [power][lane] of the taps beta5(s + 2 - lane), 0 <= s <= 1, exact before rounding.

    beta5(x) = sum_k (-1)^k C(6, k) max(x + 3 - k, 0)^5 / 120; the lanes beyond the taps are zero.
    """
    table = [[Fraction(0)] * WIDE for _ in range(TAPS)]
    for lane in range(TAPS):
        for k in range(TAPS - lane):
            shift = 5 - lane - k
            for power in range(6):
                table[power][lane] += Fraction((-1) ** k * comb(6, k) * comb(5, power) * shift ** (5 - power), 120)
    return [[float(np.float32(float(value))) for value in row] for row in table]


TAP_POLYNOMIALS = _tap_polynomials()


def footprint_sum(
    flat: Array, first: int, stride: int, s: np.float32, weights: tuple[np.float32, ...]
) -> np.float32:
    """Weighted sum over a 6 x 6 footprint of flat float32 coefficients.

    ``first`` is the index of its top-left coefficient, ``stride`` the length of a row; ``s`` the fraction along
    a row (its weights are computed here), `weights` those of the six rows.  `WIDE` coefficients a row are read.
    """
    x = [sum(TAP_POLYNOMIALS[power][lane] * s**power for power in range(TAPS)) for lane in range(TAPS)]
    total = 0.0
    for row, weight in enumerate(weights):
        begin = first + row * stride
        total += weight * sum(x[lane] * flat[begin + lane] for lane in range(TAPS))
    return np.float32(total)


def copy_pair(flat: Array, first: int, out: Array, place: int) -> None:
    """Copy flat[first], flat[first + 1] to out[place], out[place + 1]; both of one dtype."""
    out[place], out[place + 1] = flat[first], flat[first + 1]


@overload(footprint_sum, jit_options={"forceinline": True}, strict=False)
def _in_lanes(*_: Code) -> Code:
    from piv.resampling.kernels.lane_code import footprint_sum_code

    def compiled(flat, first, stride, s, weights):  # type: ignore[no-untyped-def]  # noqa
        return footprint_sum_code(flat, first, stride, s, weights)  # type: ignore[call-arg]

    return compiled


@overload(copy_pair, jit_options={"forceinline": True}, strict=False)
def _as_one(*_: Code) -> Code:
    from piv.resampling.kernels.lane_code import copy_pair_code

    def compiled(flat, first, out, place):  # type: ignore[no-untyped-def]  # noqa
        copy_pair_code(flat, first, out, place)  # type: ignore[call-arg]

    return compiled
