"""The normalised median of a vector's neighbourhood, for the universal outlier detection."""

import numpy as np

from tracer.kernels._jit import Array, kernel


@kernel
def median_of(values: Array, count: int) -> float:
    """Median of values[:count] (count >= 1), sorted in place by insertion: short lists only."""
    for k in range(1, count):
        value = values[k]
        j = k - 1
        while j >= 0 and values[j] > value:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = value
    middle = count // 2
    return values[middle] if count % 2 else 0.5 * (values[middle - 1] + values[middle])  # type: ignore[no-any-return]


@kernel
def normalised_residual(
    field: Array,
    usable: Array,
    radius: int,
    epsilon: float,
    least: int,
    first: int,
    last: int,
    work: Array,
    out: Array,
) -> None:
    """Residual of field (ny, nx, 2) against the median of its usable neighbours, rows first..last-1.

    out (ny, nx) is hypot over both components of |u - med| / (med |u_i - med| + epsilon); NaN where fewer than
    `least` neighbours within `radius` are usable.  work holds (2 radius + 1)^2 float64.
    """
    ny, nx, _ = field.shape
    for j in range(first, last):
        for i in range(nx):
            total = 0.0
            count = 0
            for axis in range(2):
                count = 0
                for y in range(max(0, j - radius), min(ny, j + radius + 1)):
                    for x in range(max(0, i - radius), min(nx, i + radius + 1)):
                        if usable[y, x] and (y != j or x != i):
                            work[count] = field[y, x, axis]
                            count += 1
                if count < least:
                    break
                centre = median_of(work, count)
                for k in range(count):
                    work[k] = abs(work[k] - centre)
                residual = abs(field[j, i, axis] - centre) / (median_of(work, count) + epsilon)
                total += residual * residual
            out[j, i] = np.sqrt(total) if count >= least else np.nan
