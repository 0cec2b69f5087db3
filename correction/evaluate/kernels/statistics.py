"""Covariance sums of the correlation asymmetry, for the uncertainty from correlation statistics.

See `correction.evaluate.uncertainty` for the method; here are its sums for one window.
"""

import numpy as np

from ground.jit import Array, kernel

REACH = 4  # px; covariances are looked for within +-4
FALLEN = 0.05  # of the variance: the ring at which the covariance has died out


@kernel
def window_sum(product: Array) -> float:
    """Sum of product (w,) float32 in float64."""
    total = 0.0
    for k in range(product.size):
        total += product[k]
    return total


@kernel
def asymmetry(a: Array, b: Array, sums: Array, raw: Array, out: Array) -> tuple[float, float, float]:
    """Correlations C0, C+, C- along the rows of windows a, b (w, w), and the smoothed asymmetry in `out`.

    out (w + 2 REACH, w + 2 REACH) float32 gets (a b+ - a+ b) smoothed by (1, 2, 1)/4 along the row, minus its
    mean, with zeros around.  raw (w + 2,) and sums (3, w) float32 are scratch.
    """
    size = a.shape[0]
    zero, quarter = np.float32(0.0), np.float32(0.25)
    s0, sp, sm = sums[0], sums[1], sums[2]
    for k in range(size):
        s0[k] = zero
        sp[k] = zero
        sm[k] = zero
    for j in range(size):
        la, lb = a[j], b[j]
        line = out[j + REACH, REACH:]
        raw[0] = zero
        raw[size] = zero
        raw[size + 1] = zero
        for k in range(size):
            s0[k] += la[k] * lb[k]
        for k in range(size - 1):
            forward, backward = la[k] * lb[k + 1], la[k + 1] * lb[k]
            sp[k] += forward
            sm[k] += backward
            raw[k + 1] = forward - backward
        for k in range(size):
            line[k] = quarter * (raw[k] + raw[k + 1] + raw[k + 1] + raw[k + 2])
    c0, cp, cm = window_sum(s0), window_sum(sp), window_sum(sm)
    for k in range(size):
        s0[k] = zero
    for j in range(size):
        line = out[j + REACH, REACH:]
        for k in range(size):
            s0[k] += line[k]
    mean = np.float32(window_sum(s0) / (size * size))
    for j in range(size):
        line = out[j + REACH, REACH:]
        for k in range(size):
            line[k] -= mean
    return c0, cp, cm


@kernel
def covariance(field: Array, dx: int, dy: int, sums: Array) -> float:
    """Sum of field(x) field(x + d) over a window (w + 2 REACH)^2 with zeros around, dy >= 0."""
    size = field.shape[0] - 2 * REACH
    for k in range(size):
        sums[k] = np.float32(0.0)
    for j in range(size):
        here = field[j + REACH, REACH : REACH + size]
        there = field[j + REACH + dy, REACH + dx : REACH + dx + size]
        for k in range(size):
            sums[k] += here[k] * there[k]
    return window_sum(sums)


@kernel
def variance_of_sum(field: Array, sums: Array) -> float:
    """Variance of the sum over a window: covariances added ring by ring until a ring has fallen."""
    zero = covariance(field, 0, 0, sums)
    total = zero
    for ring in range(1, REACH + 1):
        top = 0.0
        for dy in range(ring + 1):
            step = 1 if dy == ring else 2 * ring
            for dx in range(-ring, ring + 1, step):
                if dy == 0 and dx < 0:
                    continue
                value = covariance(field, dx, dy, sums)
                total += 2.0 * value
                top = max(top, value)
        if top < FALLEN * zero:
            break
    return total


@kernel
def gauss_sigma(c0: float, cp: float, cm: float, variance: float) -> float:
    """Standard deviation of the 3-point Gaussian peak position, driven by the random asymmetry."""
    c = 0.5 * (cp + cm)
    half = 0.5 * np.sqrt(variance) if variance > 0.0 else np.nan
    if not (c0 > 0.0 and c > half):
        return np.nan
    high, low = np.log(c + half), np.log(c - half)
    bottom = 4.0 * np.log(c0) - 2.0 * high - 2.0 * low
    return (high - low) / bottom if bottom > 0.0 else np.nan


@kernel
def window_sigma(a: Array, b: Array, energy: Array, sums: Array, raw: Array, field: Array, out: Array) -> None:
    """Sigma of the displacement along rows for windows a, b (N, w, w) float32, to out (N,); scratch as above."""
    for n in range(a.shape[0]):
        out[n] = np.nan
        if energy[n] > 0.0:
            c0, cp, cm = asymmetry(a[n], b[n], sums, raw, field)
            # Per shared pixel, as the peak fit sees them: one column fewer overlaps at one pixel's distance.
            fewer = a.shape[1] / (a.shape[1] - 1.0)
            variance = fewer * fewer * variance_of_sum(field, sums[0])
            out[n] = gauss_sigma(c0, fewer * cp, fewer * cm, variance)
