"""Real spherical harmonics of degree 2 to 6: how far a ball is out of round.

The surface of a ball is r(u) = R + sum of c_lm Y_lm(u) over the directions u from its centre, with Y_lm real and
normalised as in geodesy,

    Cl0: sqrt(2 l + 1) P_l(sin latitude),       Clm, Slm: N_lm P_lm(sin latitude) cos m lambda, sin m lambda,

such that the mean of Y^2 over the sphere is 1: a coefficient is the rms height of its part. Latitude and
longitude lambda are about the world's z and x. Degree 0 is the radius and degree 1, to first order, a
displacement of the centre: both are numbers that a sphere has already. Of degree 2 five numbers make an
ellipsoid, its orientation included: there is no rotation beside them.

By the addition theorem the sum of Y_lm^2 over m is 2 l + 1 in every direction, so the part of degree l is
nowhere higher than A_l = sqrt((2 l + 1) sum c_lm^2); along a great circle it is a sum of sines of at most l
waves, whose second derivative is nowhere above l^2 A_l (Bernstein). A curve r(angle) is convex where r'' <= r
+ 2 r'^2 / r; so a ball is convex if sum (l^2 + 1) A_l <= R.

What the kernels take are polynomials (``tracer.kernels.ball``): r^l Y_lm is one in x, y, z, and times r^2,
which is 1 on the sphere, is of degree 6 or 5 in the end.
"""

from functools import cache
from math import comb, factorial, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.kernels.ball import EVEN, ODD, SHAPE_NUMBERS

LOWEST, HIGHEST = 2, 6
Float64 = NDArray[np.float64]
Polynomial = dict[tuple[int, int, int], float]


def _terms() -> tuple[tuple[str, int, int], ...]:
    """Name, degree l, and order m (negative for sines), degree by degree."""
    found = []
    for degree in range(LOWEST, HIGHEST + 1):
        found.append((f"C{degree}0", degree, 0))
        for order in range(1, degree + 1):
            found += [(f"C{degree}{order}", degree, order), (f"S{degree}{order}", degree, -order)]
    return tuple(found)


TERMS = _terms()
NAMES = tuple(name for name, _, _ in TERMS)
COUNT = len(TERMS)
DEGREES = np.array([degree for _, degree, _ in TERMS])


def up_to(degree: int) -> int:
    """Number of coefficients up to a degree."""
    return (degree + 1) ** 2 - LOWEST**2


@cache
def to_polynomials() -> Float64:
    """Matrix (49, 45) that turns coefficients into those of the polynomials of degree 6 and 5."""
    matrix = np.zeros((SHAPE_NUMBERS - EVEN, COUNT))
    for column, (_, degree, order) in enumerate(TERMS):
        at, whole = (EVEN, HIGHEST) if degree % 2 == 0 else (ODD, HIGHEST - 1)
        powers_of = [(i, j, whole - i - j) for i in range(whole + 1) for j in range(whole + 1 - i)]
        places = {powers: at - EVEN + place for place, powers in enumerate(powers_of)}
        polynomial = _solid(degree, order)
        for _ in range((whole - degree) // 2):
            polynomial = _times_square(polynomial)
        for powers, value in polynomial.items():
            matrix[places[powers], column] = value
    return matrix


def row_of(shape_mm: Float64, radius_mm: float) -> Float64:
    """Row (50,) for the kernels, from coefficients (45,) and the radius."""
    return np.array([radius_mm, *(to_polynomials() @ shape_mm)])


def amplitudes_mm(shapes_mm: Float64) -> Float64:
    """A_l (..., 5): what the parts of degree 2 to 6 nowhere exceed."""
    degrees = range(LOWEST, HIGHEST + 1)
    parts = [sqrt(2 * d + 1) * np.linalg.norm(shapes_mm[..., d == DEGREES], axis=-1) for d in degrees]
    return np.stack(parts, axis=-1)


def largest_mm(shapes_mm: Float64) -> Float64:
    """Largest deviation of a ball (...,) from its radius, from its coefficients (..., 45)."""
    return np.asarray(amplitudes_mm(shapes_mm).sum(axis=-1))


def bending_mm(shapes_mm: Float64) -> Float64:
    """Sum of (l^2 + 1) A_l: a ball of at least this radius is convex."""
    weight = np.array([d * d + 1.0 for d in range(LOWEST, HIGHEST + 1)])
    return np.asarray(amplitudes_mm(shapes_mm) @ weight)


def values(directions: ArrayLike) -> Float64:
    """Y (..., 45) in unit directions (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
    columns = [
        x**i * y**j * z ** (whole - i - j)
        for whole in (HIGHEST, HIGHEST - 1)
        for i in range(whole + 1)
        for j in range(whole + 1 - i)
    ]
    return np.asarray(np.stack(columns, axis=-1) @ to_polynomials())


@cache
def _quadrature() -> tuple[Float64, Float64]:
    """Directions (K, 3) and weights (K,) that sum to 1: exact for polynomials up to degree 47."""
    height, weight = np.polynomial.legendre.leggauss(24)
    angle = 2.0 * np.pi * np.arange(48) / 48
    across = np.sqrt(1.0 - height**2)
    x, y = across[:, None] * np.cos(angle), across[:, None] * np.sin(angle)
    z = np.broadcast_to(height[:, None], x.shape)
    return np.stack((x, y, z), axis=-1).reshape(-1, 3), np.repeat(weight / (2.0 * 48), 48)


def rotate_harmonics(shape_mm: Float64, rotation: Float64) -> Float64:
    """Coefficients (45,) of a ball turned by a rotation (3, 3)."""
    return np.asarray(turning(rotation) @ shape_mm)


def turning(rotation: Float64) -> Float64:
    """Matrix (45, 45) that turns coefficients."""
    directions, weights = _quadrature()
    before = values(directions @ rotation)  # what stands at u now stood at R^T u
    return np.asarray((weights[:, None] * values(directions)).T @ before)


def of_ellipsoid(semi_axes_mm: ArrayLike, rotation: Float64) -> tuple[float, Float64, float]:
    """Radius, coefficients (45,) and largest error [mm] of an ellipsoid; columns of `rotation` are its axes.

    r(u) = (u . A u)^(-1/2) projected on the harmonics; its mean is the radius.
    """
    directions, weights = _quadrature()
    across = (directions @ rotation) / np.asarray(semi_axes_mm, dtype=np.float64)
    surface = 1.0 / np.linalg.norm(across, axis=1)
    radius = float(weights @ surface)
    shape = (weights * surface) @ values(directions)
    return radius, shape, float(np.abs(radius + values(directions) @ shape - surface).max())


def _solid(degree: int, order: int) -> Polynomial:
    """Polynomial r^l Y_lm."""
    m = abs(order)
    norm = sqrt((2 - (m == 0)) * (2 * degree + 1) * factorial(degree - m) / factorial(degree + m))
    along: Polynomial = {}
    for k in range((degree - m) // 2 + 1):
        left = degree - 2 * k
        factor = (-1) ** k * comb(degree, k) * comb(degree + left, degree) / 2.0**degree
        part: Polynomial = {(0, 0, left - m): factor * factorial(left) / factorial(left - m)}
        for _ in range(k):
            part = _times_square(part)
        along = _sum(along, part)
    circle: Polynomial = {}
    for p in range(m + 1):  # (x + i y)^m: real part for cosines, imaginary part for sines
        turns = m - p
        if turns % 2 == (0 if order >= 0 else 1):
            circle[p, turns, 0] = comb(m, p) * (-1.0) ** (turns // 2)
    found: Polynomial = {}
    for (a, b, c), one in along.items():
        for (d, e, f), other in circle.items():
            found = _sum(found, {(a + d, b + e, c + f): norm * one * other})
    return found


def _times_square(polynomial: Polynomial) -> Polynomial:
    """Times x^2 + y^2 + z^2."""
    found: Polynomial = {}
    for (i, j, k), value in polynomial.items():
        found = _sum(found, {(i + 2, j, k): value, (i, j + 2, k): value, (i, j, k + 2): value})
    return found


def _sum(one: Polynomial, other: Polynomial) -> Polynomial:
    return {powers: one.get(powers, 0.0) + other.get(powers, 0.0) for powers in {**one, **other}}
