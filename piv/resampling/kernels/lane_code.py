"""The two steps of `lanes` as instructions; imported when they are first compiled."""

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from piv.resampling.kernels.lanes import TAP_POLYNOMIALS

Code = Any  # a type of numba, a value of LLVM, or who writes them

_FLOAT, _INT = ir.FloatType(), ir.IntType(32)
_EIGHT = ir.VectorType(_FLOAT, 8)


def _pick(builder: Code, vector: Code, lanes: list[int]) -> Code:
    """Lanes of a vector as a new vector."""
    mask = ir.Constant(ir.VectorType(_INT, len(lanes)), lanes)
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), mask)


def _everywhere(builder: Code, number: Code) -> Code:
    """Eight lanes of one number."""
    return _pick(builder, builder.insert_element(ir.Constant(_EIGHT, ir.Undefined), number, _INT(0)), [0] * 8)


@intrinsic
def footprint_sum_code(
    typing_context: Code, flat: Code, first: Code, stride: Code, s: Code, weights: Code
) -> tuple[Code, Code]:
    """`footprint_sum` in vectors: 6 loads, 12 multiply-adds for rows and weights, one sum across lanes."""
    six = types.UniTuple(types.float32, 6)  # type: ignore[no-untyped-call]
    signature = types.float32(flat, types.intp, types.intp, types.float32, six)

    def emit(context: Code, builder: Code, signature: Code, arguments: Code) -> Code:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        first, stride, s, weights = arguments[1:]
        rows = cgutils.unpack_tuple(builder, weights, 6)  # type: ignore[no-untyped-call]
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
def copy_pair_code(typing_context: Code, flat: Code, first: Code, out: Code, place: Code) -> tuple[Code, Code]:
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
