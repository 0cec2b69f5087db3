"""Fields in whole steps and back, see `correction.maps.packed`."""

import numpy as np

from ground.jit import Array, kernel

NO_NUMBER, MOST = -(2**31), 2**31 - 1


@kernel
def to_steps(values: Array, shown: Array, step: float, whole: Array) -> None:
    """Write fields (N,) in steps to whole (N,) int32: NO_NUMBER where not finite, 0 where not shown (N,).

    They are divided in their own precision.
    """
    kind = values.dtype.type
    size, least, most, nothing = kind(step), kind(NO_NUMBER + 1), kind(MOST), kind(0.0)
    for i in range(values.shape[0]):
        steps = np.rint((values[i] if shown[i] else nothing) / size)
        known = steps - steps == nothing
        number = np.int64(min(max(steps if known else nothing, least), most))
        whole[i] = number if known & (number <= MOST) else NO_NUMBER


@kernel
def to_fields(whole: Array, shown: Array, step: float, hidden: float, fields: Array) -> None:
    """Write whole steps (N,) as fields (N,): NaN for NO_NUMBER, `hidden` where not shown (N,)."""
    for i in range(whole.shape[0]):
        value = whole[i] * step if whole[i] != NO_NUMBER else np.nan
        fields[i] = value if shown[i] else hidden
