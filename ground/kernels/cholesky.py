"""Cholesky factor of a small symmetric matrix, and the solution by it, without a call to LAPACK."""

from math import sqrt

from ground.jit import Array, kernel


@kernel
def factorise(normal: Array, damping: float, lower: Array) -> bool:
    """Cholesky factor of normal + damping diag(normal) into lower; False if it is not positive definite."""
    for i in range(len(lower)):
        for j in range(i + 1):
            value = normal[i, j]
            if i == j:
                value *= 1.0 + damping
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if i == j:
                if not value > 1e-14 * normal[i, i]:
                    return False
                lower[i, i] = sqrt(value)
            else:
                lower[i, j] = value / lower[j, j]
    return True


@kernel
def solve(lower: Array, right: Array, out: Array) -> None:
    """Solve lower lower^T out = right."""
    for i in range(len(lower)):
        value = right[i]
        for k in range(i):
            value -= lower[i, k] * out[k]
        out[i] = value / lower[i, i]
    for i in range(len(lower) - 1, -1, -1):
        value = out[i]
        for k in range(i + 1, len(lower)):
            value -= lower[k, i] * out[k]
        out[i] = value / lower[i, i]
