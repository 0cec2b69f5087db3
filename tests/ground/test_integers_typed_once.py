"""A kernel is compiled once for an integer, whether its caller has written it down or counts it."""

from numba.core import types

from ground.jit import OVERLOADED, Kernel


def scaled(count, x):
    return count * x


def chosen(count, wide):
    return count + 1 if wide else count


inner, switched = Kernel(scaled, OVERLOADED), Kernel(chosen, OVERLOADED)  # kept in no cache: compiled each time


def outer(x):
    total, count = inner(0, x) + inner(-1, x) + inner(count=7, x=x), 0
    while count < 4:  # 0 alone, until the loop is read
        total += inner(count, x)
        count += 1
    return total


def both(x):
    return switched(2, True) + switched(x, False)


def test_an_integer_that_is_written_in_a_call_is_an_int64_as_any_other():
    caller = Kernel(outer, OVERLOADED)
    assert caller(0.5) == (0 - 1 + 7 + 0 + 1 + 2 + 3) * 0.5
    assert inner.signatures == [(types.int64, types.float64)]


def test_a_switch_is_still_compiled_away():
    assert Kernel(both, OVERLOADED)(5) == 8
    assert set(switched.signatures) == {(types.int64, kind) for kind in map(types.literal, (True, False))}
