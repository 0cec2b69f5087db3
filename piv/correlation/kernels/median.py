"""The normalised median of a vector's neighbourhood, for the universal outlier detection."""

import numpy as np

from ground.jit import Array, kernel


@kernel
def sort(values: Array, count: int) -> None:
    """Sort values[:count] in place by insertion: for short lists."""
    for k in range(1, count):
        value = values[k]
        j = k - 1
        while j >= 0 and values[j] > value:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = value


@kernel
def median_deviation(values: Array, count: int) -> tuple[float, float]:
    """Median of the sorted values[:count], and the median distance from it.

    Distances grow outwards from the median, so walking out on both sides meets them in order.
    """
    upper = count // 2
    median = values[upper] if count % 2 else 0.5 * (values[upper - 1] + values[upper])
    low, high = upper - 1, upper
    near = far = 0.0
    for _ in range(upper + 1):
        below = median - values[low] if low >= 0 else np.inf
        above = values[high] - median if high < count else np.inf
        near = far
        if below < above:
            far = below
            low -= 1
        else:
            far = above
            high += 1
    return median, far if count % 2 else 0.5 * (near + far)


@kernel
def farthest(field: Array, usable: Array, radius: int, j: int, i: int) -> float:
    """Largest squared distance of a vector of field (ny, nx, 2) from its usable neighbours."""
    ny, nx, _ = field.shape
    u, v = field[j, i, 0], field[j, i, 1]
    largest = 0.0
    for y in range(max(0, j - radius), min(ny, j + radius + 1)):
        for x in range(max(0, i - radius), min(nx, i + radius + 1)):
            if usable[y, x]:
                off_u, off_v = field[y, x, 0] - u, field[y, x, 1] - v
                largest = max(largest, off_u * off_u + off_v * off_v)
    return largest


@kernel
def median_residual(
    field: Array,
    usable: Array,
    judged: Array,
    radius: int,
    epsilon: float,
    near: float,
    least: int,
    first: int,
    last: int,
    work: Array,
    out: Array,
) -> None:
    """Residual of field (ny, nx, 2) against the median of its usable neighbours, rows first..last-1.

    out (ny, nx) is hypot over both components of |u - med| / (med |u_i - med| + epsilon); NaN where fewer than
    `least` neighbours within `radius` are usable; untouched where not judged.  work is ((2 radius + 1)^2,).

    Where no neighbour is farther from the vector than `near`, out is 0: their median is not farther either, so the
    residual is at most near/epsilon, and nothing need be sorted.
    """
    ny, nx, _ = field.shape
    for j in range(first, last):
        for i in range(nx):
            if not judged[j, i]:
                continue
            if farthest(field, usable, radius, j, i) <= near * near:
                out[j, i] = 0.0
                continue
            total = 0.0
            for axis in range(2):
                count = 0
                for y in range(max(0, j - radius), min(ny, j + radius + 1)):
                    for x in range(max(0, i - radius), min(nx, i + radius + 1)):
                        if usable[y, x] and (y != j or x != i):
                            work[count] = field[y, x, axis]
                            count += 1
                if count < least:
                    total = np.nan
                    break
                sort(work, count)
                median, deviation = median_deviation(work, count)
                residual = abs(field[j, i, axis] - median) / (deviation + epsilon)
                total += residual * residual
            out[j, i] = np.sqrt(total)
