"""Kriging of single missing pixels from the valid ones around them; see `piv.correlation.fill`."""

import numpy as np

from ground.jit import Array, kernel


@kernel
def factorise(matrix: Array, n: int) -> None:
    """Cholesky factor of matrix[:n, :n], in its lower triangle."""
    for p in range(n):
        for q in range(p + 1):
            total = matrix[p, q]
            for k in range(q):
                total -= matrix[p, k] * matrix[q, k]
            matrix[p, q] = np.sqrt(max(total, 1e-12)) if p == q else total / matrix[q, q]


@kernel
def solve(matrix: Array, n: int, right: Array) -> float:
    """Solve for right[:n] in place with the factor of `factorise`; returns the sum of right * solution."""
    explained = 0.0
    for p in range(n):
        for k in range(p):
            right[p] -= matrix[p, k] * right[k]
        right[p] /= matrix[p, p]
        explained += right[p] * right[p]
    for p in range(n - 1, -1, -1):
        for k in range(p + 1, n):
            right[p] -= matrix[k, p] * right[k]
        right[p] /= matrix[p, p]
    return explained


@kernel
def krige(
    a: Array,
    b: Array,
    seen: Array,
    holes: Array,
    near: Array,
    alike: Array,
    noise: float,
    at: Array,
    matrix: Array,
    right: Array,
    first: int,
    last: int,
    out: Array,
) -> None:
    """Best linear guess of both frames at some pixels, and the variance of its error.

    a, b (H, W) float32; seen (H, W) bool, pixels to learn from; holes (N, 2) int64, rows and columns to guess,
    first..last-1 of them; near (M, 2) int64, offsets of neighbours; alike (L,) float64, correlation of pixels k
    apart along one axis (it is the product over both), L above twice the largest offset; noise, variance of a
    pixel's noise over that of the picture. at (M, 2) int64, matrix (M, M) and right (M,) float64 are scratch.
    out (N, 3) float64: a, b, variance in units of the picture's.
    """
    height, width = a.shape
    for number in range(first, last):
        y, x = holes[number, 0], holes[number, 1]
        n = 0
        for k in range(near.shape[0]):
            j, i = y + near[k, 0], x + near[k, 1]
            if j < 0 or i < 0 or j >= height or i >= width or not seen[j, i]:
                continue
            at[n, 0], at[n, 1] = j, i
            for q in range(n):
                matrix[n, q] = alike[abs(j - at[q, 0])] * alike[abs(i - at[q, 1])]
            matrix[n, n] = 1.0 + noise
            right[n] = alike[abs(j - y)] * alike[abs(i - x)]
            n += 1
        factorise(matrix, n)
        out[number, 2] = 1.0 - solve(matrix, n, right)
        total_a = total_b = 0.0
        for k in range(n):
            total_a += right[k] * a[at[k, 0], at[k, 1]]
            total_b += right[k] * b[at[k, 0], at[k, 1]]
        out[number, 0], out[number, 1] = total_a, total_b
