"""A slow tracer for balls out of round: 50 digits, harmonics from angles, no polynomial and no Newton.

A ball is r(latitude, longitude) with Legendre's functions by their recursion in degree. The surface is where
the distance from the centre is r: looked for on a line by the lowest point of their difference (golden
section), then by chords on either side of it. The normal is the difference quotient of the distance less r in
all digits. (The kernels know polynomials in x, y, z, tangents and gradients, and no angle.)
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import mpmath
from mpmath import mpf

from benchmarks.reference import TOUCHES, Vector, along, dot, snell
from tracer.bodies import Sphere
from tracer.harmonics import TERMS
from tracer.scene.scene import Scene

STEP = mpf(10) ** -17  # of difference quotients: what is left of the third order is 1e-34
GOLDEN = (mpmath.sqrt(5) - 1) / 2
ROUNDS = 200
SEARCHES = 120
STEEPEST = 2  # of the distance to a surface along a line; 1 for a sphere


@dataclass(frozen=True)
class End:
    """What became of a ray: 'recovered', 'tir', 'missed' or 'glass'; plane point, path, light, branch, sine."""

    status: str
    x: mpf
    y: mpf
    path: mpf
    passed: mpf
    branch: tuple[str, ...]
    steepest: mpf
    direction: Vector


@dataclass(frozen=True)
class Ball:
    """A ball in exact numbers: heights (degree, order, mm times `scale`) beside its mean radius."""

    name: str
    centre: Vector
    radius: mpf
    n: mpf
    heights: tuple[tuple[int, int, mpf], ...]

    @property
    def bound(self) -> mpf:
        """Radius of a sphere around it, and not on it."""
        return mpf("1.1") * self.radius

    def beyond(self, p: Vector) -> mpf:
        """Distance from the centre less r."""
        x, y, z = (a - b for a, b in zip(p, self.centre, strict=True))
        rho = mpmath.sqrt(x * x + y * y + z * z)
        if not self.heights:
            return rho - self.radius
        sine, cosine = z / rho, mpmath.sqrt(x * x + y * y) / rho
        turn = mpmath.mpc(x, y) / (rho * cosine) if cosine else mpmath.mpc(1)
        waves = [turn**order for order in range(7)]
        legendre = [column(order, sine, cosine) for order in range(7)]
        total = self.radius
        for degree, order, c in self.heights:
            wave = waves[abs(order)]
            total += c * legendre[abs(order)][degree - abs(order)] * (wave.real if order >= 0 else wave.imag)
        return rho - total

    def normal(self, p: Vector) -> Vector:
        """Outward unit normal."""
        slope = []
        for axis in range(3):
            ends = [tuple(v + s * STEP * (k == axis) for k, v in enumerate(p)) for s in (1, -1)]
            slope.append((self.beyond(ends[0]) - self.beyond(ends[1])) / (2 * STEP))
        length = mpmath.sqrt(sum(v * v for v in slope))
        return tuple(v / length for v in slope)


def column(order: int, sine: mpf, cosine: mpf) -> list[mpf]:
    """Legendre functions of one order, of degree `order` to 6: Heiskanen and Moritz, 1-62."""
    found = [mpf(1)]
    for m in range(1, order + 1):
        found[0] *= (2 * m - 1) * cosine
    below = mpf(0)
    for k in range(order + 1, 7):
        found.append(((2 * k - 1) * sine * found[-1] - (k + order - 1) * below) / (k - order))
        below = found[-2]
    return found


@cache
def scale(degree: int, order: int) -> mpf:
    """What makes a Legendre function times its wave of mean square 1 over the sphere: the same, 1-77."""
    count = mpmath.factorial(degree - order) / mpmath.factorial(degree + order)
    return mpmath.sqrt((2 - (order == 0)) * (2 * degree + 1) * count)


def balls_of(scene: Scene) -> list[Ball]:
    """Solid transparent balls of a scene without walls, n relative to the room."""

    def exact(sphere: Sphere) -> Ball:
        assert sphere.medium is not None
        n = mpf(sphere.medium.n(scene.wavelength_nm)) / mpf(scene.n_ambient)
        heights = tuple(
            (degree, order, mpf(float(c)) * scale(degree, abs(order)))
            for (_, degree, order), c in zip(TERMS, sphere.shape_mm, strict=True)
            if c != 0.0
        )
        return Ball(sphere.name, tuple(map(mpf, sphere.centre_mm)), mpf(sphere.radius_mm), n, heights)

    return [exact(sphere) for sphere in scene.spheres]


def chord(ball: Ball, p: Vector, d: Vector) -> tuple[mpf, mpf] | None:
    """Where a line goes into a convex ball and out of it."""
    w = tuple(a - b for a, b in zip(p, ball.centre, strict=True))
    m = -dot(w, d)
    far2 = ball.bound**2 - dot(w, w) + m * m
    if far2 <= 0:
        return None
    far = mpmath.sqrt(far2)

    def at(t: mpf) -> mpf:
        return ball.beyond(along(p, t, d))

    low, high = m - far, m + far
    inner = m
    if at(m) >= 0:
        a, b = low, high
        for _ in range(SEARCHES):
            c, e = b - GOLDEN * (b - a), a + GOLDEN * (b - a)
            least, inner = min((at(c), c), (at(e), e))
            if least < 0 or least > STEEPEST * (b - a):  # from there no lower point is within reach of 0
                break
            a, b = (a, e) if inner == c else (c, b)
        if least >= 0:
            return None
    return _root(at, low, inner), _root(at, high, inner)


def _root(at: Callable[[mpf], mpf], outside: mpf, inside: mpf) -> mpf:
    """Zero between a point outside and one inside: chords, the end that stays weighing half as much (Illinois)."""
    a, b, f_a, f_b = outside, inside, at(outside), at(inside)
    for _ in range(ROUNDS):
        c = b - f_b * (b - a) / (f_b - f_a)
        f = at(c)
        if abs(f) < mpf(10) ** -45:
            return c
        a, f_a = (b, f_b) if f * f_b < 0 else (a, f_a / 2)
        b, f_b = c, f
    raise RuntimeError("no root")


def follow_balls(scene: Scene, p: Vector, d: Vector) -> End:
    """Follow a ray to the plane z = 0, which balls may reach through."""
    balls, left = balls_of(scene), -1
    path, passed, steepest = mpf(0), mpf(1), mpf(0)
    branch: list[str] = []
    while True:
        ahead = []
        for number, ball in enumerate(balls):
            if number != left and (found := chord(ball, p, d)) is not None and found[0] + found[1] > 0:
                ahead.append((found[0], found[1], number))
        if not ahead:
            break
        t, _, left = min(ahead)
        if d[2] < 0 and along(p, t, d)[2] < 0:
            break
        ball = balls[left]
        branch.append(ball.name)
        p, path = along(p, t, d), path + t
        for entering in (True, False):
            normal = ball.normal(p)
            if not entering:
                normal = tuple(-x for x in normal)
            steepest = max(steepest, mpmath.sqrt(max(mpf(0), 1 - dot(normal, d) ** 2)))
            bent = snell(d, normal, 1 / ball.n if entering else ball.n)
            if bent is None:
                return End("tir", mpf(0), mpf(0), path, passed, tuple(branch), steepest, d)
            d, share = bent
            steepest = max(steepest, mpmath.sqrt(max(mpf(0), 1 - dot(normal, d) ** 2)))
            passed *= share
            if entering:
                found = chord(ball, p, d)
                assert found is not None
                p, path = along(p, found[1], d), path + ball.n * found[1]
        if p[2] < -TOUCHES:
            return End("glass", mpf(0), mpf(0), path, mpf(0), tuple(branch), steepest, d)
    if not d[2] < 0:
        return End("missed", mpf(0), mpf(0), path, passed, tuple(branch), steepest, d)
    t = -p[2] / d[2]
    end = along(p, t, d)
    return End("recovered", end[0], end[1], (path + t) * scene.n_ambient, passed, tuple(branch), steepest, d)
