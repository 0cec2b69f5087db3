"""Vectors of three numbers, as kernels pass them: tuples, compiled into their callers, of which nothing is left.

Sums are taken from left to right, as written: bits do not depend on the caller.
"""

from ground.jit import Array, kernel_inlined

Vector = tuple[float, float, float]


@kernel_inlined
def vector_at(row: Array, at: int) -> Vector:
    """Three numbers of a row that begin at a place."""
    return row[at], row[at + 1], row[at + 2]


@kernel_inlined
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel_inlined
def add_dot(start: float, a: Vector, b: Vector) -> float:
    """Sum of a number and a scalar product, from left to right."""
    return start + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel_inlined
def cross_product(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel_inlined
def add(a: Vector, b: Vector) -> Vector:
    """Sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel_inlined
def subtract(a: Vector, b: Vector) -> Vector:
    """Difference of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel_inlined
def scale(factor: float, a: Vector) -> Vector:
    """Multiple of a vector."""
    return factor * a[0], factor * a[1], factor * a[2]


@kernel_inlined
def divide(a: Vector, number: float) -> Vector:
    """Vector divided by a number, component by component."""
    return a[0] / number, a[1] / number, a[2] / number


@kernel_inlined
def move(p: Vector, t: float, d: Vector) -> Vector:
    """Point p + t d of a line."""
    return p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]


@kernel_inlined
def combine(s: float, a: Vector, t: float, b: Vector) -> Vector:
    """Linear combination s a + t b."""
    return s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]


@kernel_inlined
def with_component(a: Vector, k: int, value: float) -> Vector:
    """Vector with component k replaced."""
    return value if k == 0 else a[0], value if k == 1 else a[1], value if k == 2 else a[2]
