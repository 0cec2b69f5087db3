"""Two steps written in vector registers by hand, because the compiler cannot find them in the scalar form.

Interpolation gathers: where a sample lies is known only from data, so the compiler can neither prove that what is
read and what is written are apart, nor may it reorder a sum.  Both steps below touch neighbouring memory, though:

* `footprint_sum`, the 6 x 6 products of the quintic spline: a row of the footprint is one load of eight lanes (the
  last two weigh nothing), so six rows are six multiply-adds; the six weights along a row are one polynomial of
  fifth degree whose coefficients differ by lane.  3 ns a sample instead of 20.
* `copy_pair`, two neighbouring pixels as one integer of twice the width, whatever their type.

Each is an ordinary Python function, the definition, which compiled code replaces by the vectors; the sums differ
by the order of their terms and nothing else.
"""

from fractions import Fraction
from math import comb
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, overload

from ground.jit import Array

Code = Any  # a type of numba, a value of LLVM, or who writes them

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
    flat: Array,
    first: int,
    stride: int,
    s: np.float32,
    y0: np.float32,
    y1: np.float32,
    y2: np.float32,
    y3: np.float32,
    y4: np.float32,
    y5: np.float32,
) -> np.float32:
    """Weighted sum over a 6 x 6 footprint of flat float32 coefficients.

    ``first`` is the index of its top-left coefficient, ``stride`` the length of a row; ``s`` the fraction along
    a row (its weights are computed here), ``y0`` ... ``y5`` the weights of the rows.  `WIDE` coefficients a row
    are read.
    """
    x = [sum(TAP_POLYNOMIALS[power][lane] * s**power for power in range(TAPS)) for lane in range(TAPS)]
    total = 0.0
    for row, weight in enumerate((y0, y1, y2, y3, y4, y5)):
        begin = first + row * stride
        total += weight * sum(x[lane] * flat[begin + lane] for lane in range(TAPS))
    return np.float32(total)


def copy_pair(flat: Array, first: int, out: Array, place: int) -> None:
    """Copy flat[first], flat[first + 1] to out[place], out[place + 1]; both of one dtype."""
    out[place], out[place + 1] = flat[first], flat[first + 1]


_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_EIGHT, _FOUR = ir.VectorType(_FLOAT, 8), ir.VectorType(_FLOAT, 4)


def _pick(builder: Code, vector: Code, lanes: list[int]) -> Code:
    """Lanes of a vector as a new vector."""
    mask = ir.Constant(ir.VectorType(_INT, len(lanes)), lanes)
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), mask)


def _everywhere(builder: Code, number: Code) -> Code:
    """Eight lanes of one number."""
    return _pick(builder, builder.insert_element(ir.Constant(_EIGHT, ir.Undefined), number, _INT(0)), [0] * 8)


@intrinsic
def _footprint_sum(
    typing_context: Code,
    flat: Code,
    first: Code,
    stride: Code,
    s: Code,
    y0: Code,
    y1: Code,
    y2: Code,
    y3: Code,
    y4: Code,
    y5: Code,
) -> tuple[Code, Code]:
    """`footprint_sum` in vectors: 6 loads, 12 multiply-adds for rows and weights, one sum across lanes."""
    signature = types.float32(flat, types.intp, types.intp, *[types.float32] * 7)

    def emit(context: Code, builder: Code, signature: Code, arguments: Code) -> Code:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        first, stride, s, *rows = arguments[1:]
        kind = ir.FunctionType(_EIGHT, [_EIGHT] * 3)
        multiply_add = cgutils.get_or_insert_function(builder.module, kind, "llvm.fmuladd.v8f32")  # type: ignore[no-untyped-call]

        def fma(a: Code, b: Code, c: Code) -> Code:
            return builder.call(multiply_add, [a, b, c])

        c = [ir.Constant(_EIGHT, [ir.Constant(_FLOAT, value) for value in row]) for row in TAP_POLYNOMIALS]
        s = _everywhere(builder, s)
        s2 = builder.fmul(s, s)
        pairs = [fma(s, c[power + 1], c[power]) for power in (0, 2, 4)]  # by twos: a shorter chain than Horner's
        x = fma(builder.fmul(s2, s2), pairs[2], fma(s2, pairs[1], pairs[0]))
        place, sums = builder.gep(data, [first]), []
        for row, weight in enumerate(rows):
            lanes = builder.load(builder.bitcast(place, _EIGHT.as_pointer()), align=4)
            weight = _everywhere(builder, weight)
            if row < 2:
                sums.append(builder.fmul(weight, lanes))
            else:
                sums[row % 2] = fma(weight, lanes, sums[row % 2])
            place = builder.gep(place, [stride])
        total = builder.fmul(builder.fadd(*sums), x)
        total = builder.fadd(_pick(builder, total, [0, 1, 2, 3]), _pick(builder, total, [4, 5, 6, 7]))
        total = builder.fadd(total, _pick(builder, total, [2, 3, 0, 1]))
        return builder.fadd(builder.extract_element(total, _INT(0)), builder.extract_element(total, _INT(1)))

    return signature, emit


@intrinsic
def _copy_pair(typing_context: Code, flat: Code, first: Code, out: Code, place: Code) -> tuple[Code, Code]:
    """`copy_pair` as one load and one store."""
    signature = types.void(flat, types.intp, out, types.intp)

    def emit(context: Code, builder: Code, signature: Code, arguments: Code) -> Code:
        source = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        target = context.make_array(signature.args[2])(context, builder, arguments[2]).data
        size = context.get_abi_sizeof(context.get_data_type(signature.args[0].dtype))
        both = ir.IntType(16 * size).as_pointer()
        pair = builder.load(builder.bitcast(builder.gep(source, [arguments[1]]), both), align=size)
        builder.store(pair, builder.bitcast(builder.gep(target, [arguments[3]]), both), align=size)
        return context.get_dummy_value()

    return signature, emit


@overload(footprint_sum, jit_options={"forceinline": True}, strict=False)
def _in_lanes(*_: Code) -> Code:
    def compiled(flat, first, stride, s, y0, y1, y2, y3, y4, y5):  # type: ignore[no-untyped-def]  # noqa
        return _footprint_sum(flat, first, stride, s, y0, y1, y2, y3, y4, y5)  # type: ignore[call-arg]

    return compiled


@overload(copy_pair, jit_options={"forceinline": True}, strict=False)
def _as_one(*_: Code) -> Code:
    def compiled(flat, first, out, place):  # type: ignore[no-untyped-def]  # noqa
        _copy_pair(flat, first, out, place)  # type: ignore[call-arg]

    return compiled
