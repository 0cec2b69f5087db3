"""A ray and a ball out of round: r(u) = R + H(u), u the direction from the centre.

H is made of spherical harmonics of degree 2 to 6 (`tracer.harmonics`). On the unit sphere those of even
degree are one homogeneous polynomial of degree 6 in x, y, z, those of odd degree one of degree 5: a factor x^2
+ y^2 + z^2 changes nothing there. The row of a shape is (50,): R, the coefficients [mm] of x^i y^j z^k with i
+ j + k = 6, then those with 5, by i and then j. Value, gradient and curvature are each one pass of Horner's
scheme.

The ball is where rho / r(u) <= 1, rho the distance from the centre, which is a convex function of the point
where the ball is convex (that is demanded of it). Newton from outside on a convex function neither jumps over
the near root nor stops before it: from the sphere around the ball it comes up to the surface from one side in
three or four steps, and where the slope turns first, the ray has passed beside the ball. From the far side the
same finds the way out. No root is chosen by a tolerance. Points are relative to the centre, on the line
through its foot point, so that nothing depends on how far away the camera is. At both surfaces the ray is bent
as at every other (``tracer.kernels.refraction``).

Derivatives: with F = rho - r(u) the point q = p + t d stays on F = 0 and the normal is the gradient of F, G.
For changes f of p, u of d and of the shape, of which F changes by F' and G by G',

    q' = f + t u - d (G . (f + t u) + F') / (G . d),       normal' = C q' + G',       C the curvature of F,

forwards; backwards, for few results and many numbers, the transposed of the same.

Which spheres of a world are out of round is asked of the TYPE of its ``shapes``.  It is the empty tuple where
every sphere is one, and nothing of this is left in the machine code; else it holds one table (N, 50), a row for
each sphere, whose radius is 0 for those that are round. The row of such a ball in the table of spheres is the
sphere around it.
"""

import math
from typing import Any

from ground.jit import OVERLOADED, Array, kernel, overload
from tracer.kernels.branches import NOTHING
from tracer.kernels.refraction import plane_point_rates, refract, refract_rates
from tracer.kernels.sphere import RADIUS, REFRACTIVE_INDEX, foot, transmittance
from tracer.kernels.vectors import Vector, add, divide, dot, move, scale, subtract, vector_at

MEAN, EVEN, ODD, SHAPE_NUMBERS = 0, 1, 29, 50  # of a row: R, and where coefficients of degree 6, 5 begin
BESIDE, BENT, REFLECTED = range(3)  # of a ray at a ball
MOST_STEPS = 60  # of Newton, for tangents; else three or four
ROUNDING = 1e-15  # of the radius
Hit = tuple[Vector, Vector, float]  # point of a surface, direction of the ray to it and its length


@kernel
def next_among_shapes(
    p: Vector, d: Vector, last: int, spheres: Array, shapes: Array, room: int, home: Array
) -> tuple[int, float]:
    """Number of the sphere or ball in a room met next, or NOTHING, and the distance to a point in it."""
    best, nearest = NOTHING, math.inf
    for i in range(spheres.shape[0]):
        if i != last and (home.shape[0] == 0 or home[i] == room):
            w = subtract(p, vector_at(spheres[i], 0))
            m, radius = -dot(w, d), spheres[i, RADIUS]
            if m + radius > 0.0 and m - radius < nearest:
                a = move(w, m, d)
                if dot(a, a) < radius * radius:
                    if shapes[i, MEAN] > 0.0:
                        m = meets_ball(p, d, spheres[i], shapes[i])
                    if 0.0 < m < nearest:
                        best, nearest = i, m
    return best, nearest


def is_shaped(shapes: tuple[Any, ...], body: int) -> bool:
    """Return whether a sphere is out of round."""
    return len(shapes) > 0 and bool(shapes[0][body, MEAN] > 0.0)


def next_shaped(
    p: Vector, d: Vector, last: int, spheres: Array, shapes: tuple[Any, ...], room: int, home: Array
) -> tuple[int, float]:
    """`next_among_shapes` where there are shapes."""
    if not len(shapes):
        return NOTHING, math.inf
    return next_among_shapes(p, d, last, spheres, shapes[0], room, home)


def entry_of_shape(p: Vector, d: Vector, body: int, spheres: Array, shapes: tuple[Any, ...]) -> Vector:
    """`entry_point` where there are shapes."""
    return entry_point(p, d, spheres[body], shapes[0][body]) if len(shapes) else p


def cross_shaped(
    p: Vector, d: Vector, body: int, spheres: Array, shapes: tuple[Any, ...]
) -> tuple[int, Vector, Vector, float, float]:
    """`cross_ball` where there are shapes."""
    if not len(shapes):
        return BESIDE, p, d, 0.0, 1.0
    return cross_ball(p, d, spheres[body], shapes[0][body])


def shape_rates(
    p: Vector, d: Vector, f: Vector, u: Vector, body: int, spheres: Array, shapes: tuple[Any, ...]
) -> tuple[Vector, Vector]:
    """`ball_rates` where there are shapes."""
    if not len(shapes):
        return f, u
    return ball_rates(p, d, f, u, spheres[body], shapes[0][body])


def back_through_shaped(
    f: Vector, g: Vector, state: Array, body: int, spheres: Array, shapes: tuple[Any, ...], out: Array,
    by_shape: Array,
) -> tuple[Vector, Vector]:  # fmt: skip
    """`back_through_ball` where there are shapes, from a state as ``tracer.kernels.landing`` keeps it."""
    if not len(shapes):
        return f, g
    p = add(vector_at(state, 0), vector_at(spheres[body], 0))
    return back_through_ball(f, g, p, vector_at(state, 3), spheres[body], shapes[0][body], out, by_shape)


@overload(is_shaped, jit_options=OVERLOADED)
def _is_shaped(shapes, body):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda shapes, body: False
    return lambda shapes, body: shapes[0][body, MEAN] > 0.0


@overload(next_shaped, jit_options=OVERLOADED)
def _next_shaped(p, d, last, spheres, shapes, room, home):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda p, d, last, spheres, shapes, room, home: (NOTHING, math.inf)
    return lambda p, d, last, spheres, shapes, room, home: next_among_shapes(
        p, d, last, spheres, shapes[0], room, home
    )


@overload(entry_of_shape, jit_options=OVERLOADED)
def _entry_of_shape(p, d, body, spheres, shapes):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda p, d, body, spheres, shapes: p
    return lambda p, d, body, spheres, shapes: entry_point(p, d, spheres[body], shapes[0][body])


@overload(cross_shaped, jit_options=OVERLOADED)
def _cross_shaped(p, d, body, spheres, shapes):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda p, d, body, spheres, shapes: (BESIDE, p, d, 0.0, 1.0)
    return lambda p, d, body, spheres, shapes: cross_ball(p, d, spheres[body], shapes[0][body])


@overload(shape_rates, jit_options=OVERLOADED)
def _shape_rates(p, d, f, u, body, spheres, shapes):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda p, d, f, u, body, spheres, shapes: (f, u)
    return lambda p, d, f, u, body, spheres, shapes: ball_rates(p, d, f, u, spheres[body], shapes[0][body])


@overload(back_through_shaped, jit_options=OVERLOADED)
def _back_through_shaped(f, g, state, body, spheres, shapes, out, by_shape):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda f, g, state, body, spheres, shapes, out, by_shape: (f, g)

    def back(f, g, state, body, spheres, shapes, out, by_shape):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        p = add(vector_at(state, 0), vector_at(spheres[body], 0))
        return back_through_ball(f, g, p, vector_at(state, 3), spheres[body], shapes[0][body], out, by_shape)

    return back


@kernel
def polynomial(
    x: float, y: float, z: float, shape: Array, at: int, degree: int
) -> tuple[float, float, float, float]:
    """Value and gradient of the homogeneous polynomial whose coefficients begin at a place of the row."""
    value, by_x, by_y, by_z = 0.0, 0.0, 0.0, 0.0
    place = at + (degree + 1) * (degree + 2) // 2
    for rest in range(degree + 1):  # i = degree - rest
        a, a_y, a_z, power, slope = 0.0, 0.0, 0.0, 1.0, 0.0
        for _ in range(rest + 1):  # j from rest down; power = z^k
            place -= 1
            a_y = a_y * y + a
            a = a * y + shape[place] * power
            a_z = a_z * y + shape[place] * slope
            slope = slope * z + power
            power *= z
        by_x = by_x * x + value
        value, by_y, by_z = value * x + a, by_y * x + a_y, by_z * x + a_z
    return value, by_x, by_y, by_z


@kernel
def curvature(
    x: float, y: float, z: float, shape: Array, at: int, degree: int
) -> tuple[float, float, float, float, float, float]:
    """Second derivatives xx, yy, zz, xy, xz, yz of the same polynomial."""
    v, x1, y1, z1, xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    place = at + (degree + 1) * (degree + 2) // 2
    for rest in range(degree + 1):
        a, a_y, a_z, a_yy, a_zz, a_yz, power, slope, bend = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0
        for _ in range(rest + 1):
            place -= 1
            a_yy = a_yy * y + 2.0 * a_y
            a_yz = a_yz * y + a_z
            a_y = a_y * y + a
            a = a * y + shape[place] * power
            a_z = a_z * y + shape[place] * slope
            a_zz = a_zz * y + shape[place] * bend
            bend = bend * z + 2.0 * slope
            slope = slope * z + power
            power *= z
        xx, xy, xz = xx * x + 2.0 * x1, xy * x + y1, xz * x + z1
        x1 = x1 * x + v
        v, y1, z1 = v * x + a, y1 * x + a_y, z1 * x + a_z
        yy, zz, yz = yy * x + a_yy, zz * x + a_zz, yz * x + a_yz
    return xx, yy, zz, xy, xz, yz


@kernel
def height(u: Vector, shape: Array) -> tuple[float, Vector]:
    """H(u) and its gradient along the unit sphere."""
    a, ax, ay, az = polynomial(u[0], u[1], u[2], shape, EVEN, 6)
    b, bx, by, bz = polynomial(u[0], u[1], u[2], shape, ODD, 5)
    return a + b, move(add((ax, ay, az), (bx, by, bz)), -(6.0 * a + 5.0 * b), u)


@kernel
def excess(q: Vector, shape: Array) -> tuple[float, Vector]:
    """Rho / r(u) - 1 at a point, negative inside, and its gradient."""
    rho = math.sqrt(dot(q, q))
    u = divide(q, rho)
    h, gradient = height(u, shape)
    r = shape[MEAN] + h
    return (rho - r) / r, divide(subtract(u, divide(gradient, r)), r)


@kernel
def normal(q: Vector, shape: Array) -> Vector:
    """G, the gradient of rho - r(u): an outward normal, not of length 1."""
    rho = math.sqrt(dot(q, q))
    u = divide(q, rho)
    _, gradient = height(u, shape)
    return subtract(u, divide(gradient, rho))


@kernel
def normal_change(q: Vector, shape: Array, v: Vector) -> Vector:
    """C v, the change of `normal` when the point moves by v; C is symmetric."""
    rho = math.sqrt(dot(q, q))
    u = divide(q, rho)
    ux, uy, uz = u
    a, ax, ay, az = polynomial(ux, uy, uz, shape, EVEN, 6)
    b, bx, by, bz = polynomial(ux, uy, uz, shape, ODD, 5)
    axx, ayy, azz, axy, axz, ayz = curvature(ux, uy, uz, shape, EVEN, 6)
    bxx, byy, bzz, bxy, bxz, byz = curvature(ux, uy, uz, shape, ODD, 5)
    radial, twice = 6.0 * a + 5.0 * b, 48.0 * a + 35.0 * b
    g = (6.0 * ax + 5.0 * bx, 6.0 * ay + 5.0 * by, 6.0 * az + 5.0 * bz)
    uv = dot(u, v)
    along = twice * uv - dot(g, v)
    xy, xz, yz = axy + bxy, axz + bxz, ayz + byz
    h = (dot((axx + bxx, xy, xz), v), dot((xy, ayy + byy, yz), v), dot((xz, yz, azz + bzz), v))
    h = move(move(move(h, -uv, g), along, u), -radial, v)
    return divide(subtract(move(v, -uv, u), divide(h, rho)), rho)


@kernel
def intersect_surface(a: Vector, d: Vector, s: float, side: float, shape: Array) -> tuple[bool, float, Vector]:
    """Return whether the line a + s d meets the ball, where, and the unit normal there.

    From s outside of it, towards the ball: `side` -1 is the near surface, 1 the far one.
    """
    n = (0.0, 0.0, 0.0)
    for _ in range(MOST_STEPS):
        value, n = excess(move(a, s, d), shape)
        slope = dot(n, d)
        if not side * slope > 0.0:
            return False, s, n
        s -= value / slope
        if value <= ROUNDING:
            break
    n = normal(move(a, s, d), shape)
    return True, s, divide(n, math.sqrt(dot(n, n)))


@kernel
def meets_ball(p: Vector, d: Vector, ball: Array, shape: Array) -> float:
    """Distance along the half-line p + t d to the middle of its chord in the ball, inf for a miss.

    `ball`: row of the sphere around it (``tracer.kernels.sphere``).
    """
    m, a = foot(subtract(p, vector_at(ball, 0)), d)
    far2 = ball[RADIUS] * ball[RADIUS] - dot(a, a)
    if not far2 > 0.0 or not m + ball[RADIUS] > 0.0:
        return math.inf
    far = math.sqrt(far2)
    is_met, near, _ = intersect_surface(a, d, -far, -1.0, shape)
    if not is_met:
        return math.inf
    _, far, _ = intersect_surface(a, d, far, 1.0, shape)
    t = m + 0.5 * (near + far)
    return t if t > 0.0 else math.inf


@kernel
def entry_point(p: Vector, d: Vector, ball: Array, shape: Array) -> Vector:
    """Point at which a ray enters a ball that it meets."""
    centre, around2 = vector_at(ball, 0), ball[RADIUS] * ball[RADIUS]
    _, a = foot(subtract(p, centre), d)
    _, s, _ = intersect_surface(a, d, -math.sqrt(max(around2 - dot(a, a), 0.0)), -1.0, shape)
    return add(centre, move(a, s, d))


@kernel
def cross_ball(p: Vector, d: Vector, ball: Array, shape: Array) -> tuple[int, Vector, Vector, float, float]:
    """Take a ray through a ball: status, point and direction behind it, path / n around, share of the light.

    The point is where it leaves the ball; where it is REFLECTED, totally, on either surface, or passes BESIDE by
    rounding, the nearest to the centre.
    """
    centre, n, around2 = vector_at(ball, 0), ball[REFRACTIVE_INDEX], ball[RADIUS] * ball[RADIUS]
    m, a = foot(subtract(p, centre), d)
    is_met, s, nml = intersect_surface(a, d, -math.sqrt(max(around2 - dot(a, a), 0.0)), -1.0, shape)
    if not is_met:
        return BESIDE, add(centre, a), d, m, 1.0
    e, c1, c2 = refract(d, nml, 1.0 / n)
    if c2 == 0.0:
        return REFLECTED, add(centre, a), d, m, 0.0
    path, light = m + s, transmittance(c1, c2, n)
    m, a = foot(move(a, s, d), e)
    _, s, nml = intersect_surface(a, e, math.sqrt(max(around2 - dot(a, a), 0.0)), 1.0, shape)
    path += n * (m + s)
    d, c1, c2 = refract(e, scale(-1.0, nml), n)
    if c2 == 0.0:
        return REFLECTED, add(centre, a), e, path, 0.0
    return BENT, add(centre, move(a, s, e)), d, path, light * transmittance(c1, c2, 1.0 / n)


@kernel
def inside(p: Vector, d: Vector, ball: Array, shape: Array) -> tuple[Hit, Hit]:
    """Both surfaces that a ray goes through: point from the centre, direction to it and its length.

    Of a ray that does not meet the ball the first length is NaN.
    """
    n, around2 = ball[REFRACTIVE_INDEX], ball[RADIUS] * ball[RADIUS]
    m, a = foot(subtract(p, vector_at(ball, 0)), d)
    is_met, s, nml = intersect_surface(a, d, -math.sqrt(max(around2 - dot(a, a), 0.0)), -1.0, shape)
    e, _, c2 = refract(d, nml, 1.0 / n)
    t = m + s if is_met and c2 > 0.0 else math.nan
    q = move(a, s, d)
    m, a = foot(q, e)
    _, s, _ = intersect_surface(a, e, math.sqrt(max(around2 - dot(a, a), 0.0)), 1.0, shape)
    return (q, d, t), (move(a, s, e), e, m + s)


@kernel
def surface_rates(hit: Hit, f: Vector, u: Vector, shape: Array, side: float, e: float) -> tuple[Vector, Vector]:
    """Derivatives of q = p + t d and of the direction behind a surface, `side` as for `intersect_surface`."""
    q, d, t = hit
    g = normal(q, shape)
    f = plane_point_rates(d, t, g, f, u, 0.0)
    length = math.sqrt(dot(g, g)) * -side
    n, r = divide(g, length), divide(normal_change(q, shape, f), length)
    _, c1, c2 = refract(d, n, e)
    return f, refract_rates(d, n, e, c1, c2, u, move(r, -dot(n, r), n), 0.0)


@kernel
def ball_rates(p: Vector, d: Vector, f: Vector, u: Vector, ball: Array, shape: Array) -> tuple[Vector, Vector]:
    """Derivatives of point and direction behind the ball when p changes by f and d by u."""
    first, second = inside(p, d, ball, shape)
    if not math.isfinite(first[2]):
        return move(f, -dot(subtract(p, vector_at(ball, 0)), d), u), u
    n = ball[REFRACTIVE_INDEX]
    f, u = surface_rates(first, f, u, shape, -1.0, 1.0 / n)
    return surface_rates(second, f, u, shape, 1.0, n)


@kernel
def back_through_surface(
    f: Vector, g: Vector, hit: Hit, shape: Array, side: float, e: float, out: Array
) -> tuple[Vector, Vector, float]:
    """Carry an adjoint pair (f, g) of q and of the direction behind one surface back to p and the one before.

    Adds what falls to the shape to out (50,); returns the pair, and what falls to e.
    """
    q, d, t = hit
    o = normal(q, shape)
    length = -side * math.sqrt(dot(o, o))
    n = divide(o, length)
    _, c1, c2 = refract(d, n, e)
    k = (e - 1.0) * (e + 1.0) / (e * c1 + c2)
    k_bar = dot(g, n)
    c1_bar = k_bar * e * (1.0 - e * c1 / c2)
    e_bar = dot(g, d) + k_bar * (c1 + e * (1.0 - c1 * c1) / c2)
    r = move(scale(k, g), -c1_bar, d)
    g = move(scale(e, g), -c1_bar, n)
    r = divide(move(r, -dot(r, n), n), length)
    f = add(f, normal_change(q, shape, r))
    s = dot(f, d) / dot(o, d)
    back_to_shape(q, s, r, out)
    f = move(f, -s, o)
    return f, move(g, t, f), e_bar


@kernel
def back_to_shape(q: Vector, s: float, r: Vector, out: Array) -> None:
    """Add what falls to R and to each coefficient: s times the height, less r times the slope of F by it."""
    rho = math.sqrt(dot(q, q))
    (x, y, z), (rx, ry, rz) = divide(q, rho), r
    out[MEAN] += s
    along = rx * x + ry * y + rz * z
    for at, degree in ((EVEN, 6), (ODD, 5)):
        place, x_power, x_slope = at, 1.0, 0.0
        for i in range(degree + 1):
            y_power, y_slope = 1.0, 0.0
            for j in range(degree - i + 1):
                z_power, z_slope = 1.0, 0.0
                for _ in range(degree - i - j):
                    z_slope = z_slope * z + z_power
                    z_power *= z
                value = x_power * y_power * z_power
                slope = rx * x_slope * y_power * z_power + ry * x_power * y_slope * z_power
                slope += rz * x_power * y_power * z_slope - degree * along * value
                out[place] += s * value - slope / rho
                place += 1
                y_slope = y_slope * y + y_power
                y_power *= y
            x_slope = x_slope * x + x_power
            x_power *= x


@kernel
def back_through_ball(
    f: Vector, g: Vector, p: Vector, d: Vector, ball: Array, shape: Array, out: Array, by_shape: Array
) -> tuple[Vector, Vector]:
    """Carry one adjoint pair (f, g) of point and direction behind a ball back to p and d.

    Adds what falls to centre, R and n to out (5,), and what falls to the shape's numbers to by_shape (50,).
    """
    first, second = inside(p, d, ball, shape)
    if not math.isfinite(first[2]):
        return f, move(g, -dot(subtract(p, vector_at(ball, 0)), d), f)
    n, radius_before, behind = ball[REFRACTIVE_INDEX], by_shape[MEAN], f
    f, g, out_bar = back_through_surface(f, g, second, shape, 1.0, n, by_shape)
    f, g, in_bar = back_through_surface(f, g, first, shape, -1.0, 1.0 / n, by_shape)
    for k in range(3):
        out[k] += behind[k] - f[k]
    out[3] += by_shape[MEAN] - radius_before
    out[4] += out_bar - in_bar / (n * n)
    return f, g
