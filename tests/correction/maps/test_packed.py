"""Stored fields: rounding by kernels, against the same in NumPy's words."""

import numpy as np
import pytest

from correction.maps.kernels import steps as kernels
from correction.maps.packed import pack, round_to_step, unpack

ODD = [
    np.nan,
    np.inf,
    -np.inf,
    0.0,
    -0.0,
    0.5,
    -0.5,
    1.5,
    2.5,
    1e30,
    -1e30,
    1e-40,
    2.0**29,
    -(2.0**29),
    2.0**29 - 16,
]
LEAST, MOST = -(2**31) + 1, 2**31 - 1


def rounded(values, shown, step, hidden):
    """Fields as `round_to_step` says them, in whole arrays."""
    whole = np.rint(np.where(shown, values, 0.0) / step)
    known = np.isfinite(whole)
    whole = np.clip(np.where(known, whole, 0.0), LEAST, MOST).astype(np.int64)
    known &= np.abs(whole) <= MOST  # single precision has no such numbers: these are clipped to 2^31
    return np.where(shown, np.where(known, whole * step, np.nan), hidden).astype(values.dtype)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("step", [0.25, 0.1, 2.0**-14])
def test_rounding_is_that_of_whole_arrays(kind, step):
    rng = np.random.default_rng(3)
    values = (rng.normal(size=(19, 23, 4)) * 10.0 ** rng.integers(-6, 9, (19, 23, 4))).astype(kind)
    odd = rng.random(values.shape) < 0.3
    values[odd] = rng.choice(np.array(ODD, kind), odd.sum())
    shown, found = rng.random((19, 23)) < 0.8, np.empty_like(values)
    round_to_step(values, shown, step, 7.0, found)
    expected = rounded(values, shown[..., None], step, 7.0)
    np.testing.assert_array_equal(found, expected)
    # The same comes back from a file.
    first, every = np.moveaxis(values, -1, 0), np.broadcast_to(shown, (4, 19, 23))
    back = unpack(pack(first, every, step), every, step, 7.0).astype(kind)
    np.testing.assert_array_equal(np.moveaxis(back, 0, -1), expected)


def test_plain_python_rounds_alike():
    values, shown = np.array(ODD), np.arange(len(ODD)) % 4 != 3
    made = [np.empty(len(ODD), np.int32) for _ in range(2)]
    fields = [np.empty(len(ODD)) for _ in range(2)]
    for by, out, last in ((kernels.to_steps, made[0], fields[0]), (kernels.to_steps.py_func, made[1], fields[1])):
        with np.errstate(invalid="ignore"):  # of NaN and infinity, which compiled code does not mention
            by(values, shown, 0.25, out)
            kernels.to_fields.py_func(out, shown, 0.25, 7.0, last)
    np.testing.assert_array_equal(*made)
    np.testing.assert_array_equal(*fields)
