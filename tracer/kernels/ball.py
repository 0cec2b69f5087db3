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
from tracer.kernels.refraction import on_plane_rates, refracted, refracted_rates
from tracer.kernels.sphere import CENTRE_X, CENTRE_Y, CENTRE_Z, INDEX, RADIUS, foot, transmittance

MEAN, EVEN, ODD, SHAPE_NUMBERS = 0, 1, 29, 50  # of a row: R, and where coefficients of degree 6, 5 begin
BESIDE, BENT, REFLECTED = range(3)  # of a ray at a ball
MOST_STEPS = 60  # of Newton, for tangents; else three or four
ROUNDING = 1e-15  # of the radius


@kernel
def next_of_shaped(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, last: int, spheres: Array, shapes: Array,
    room: int, home: Array,
) -> tuple[int, float]:  # fmt: skip
    """Number of the sphere or ball in a room met next, or NOTHING, and the distance to a point in it."""
    best, nearest = NOTHING, math.inf
    for i in range(spheres.shape[0]):
        if i != last and (home.shape[0] == 0 or home[i] == room):
            wx, wy, wz = px - spheres[i, CENTRE_X], py - spheres[i, CENTRE_Y], pz - spheres[i, CENTRE_Z]
            m = -(wx * dx + wy * dy + wz * dz)
            radius = spheres[i, RADIUS]
            if m + radius > 0.0 and m - radius < nearest:
                ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
                if ax * ax + ay * ay + az * az < radius * radius:
                    if shapes[i, MEAN] > 0.0:
                        m = meets_ball(px, py, pz, dx, dy, dz, spheres[i], shapes[i])
                    if 0.0 < m < nearest:
                        best, nearest = i, m
    return best, nearest


def is_shaped(shapes: tuple[Any, ...], body: int) -> bool:
    """Whether a sphere is out of round."""
    return len(shapes) > 0 and bool(shapes[0][body, MEAN] > 0.0)


def next_shaped(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, last: int,
    spheres: Array, shapes: tuple[Any, ...], room: int, home: Array,
) -> tuple[int, float]:  # fmt: skip
    """`next_of_shaped` where there are shapes."""
    if not len(shapes):
        return NOTHING, math.inf
    return next_of_shaped(px, py, pz, dx, dy, dz, last, spheres, shapes[0], room, home)


def cross_shaped(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    body: int, spheres: Array, shapes: tuple[Any, ...],
) -> tuple[int, float, float, float, float, float, float, float, float]:  # fmt: skip
    """`cross_ball` where there are shapes."""
    if not len(shapes):
        return BESIDE, px, py, pz, dx, dy, dz, 0.0, 1.0
    return cross_ball(px, py, pz, dx, dy, dz, spheres[body], shapes[0][body])


def shaped_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float,
    body: int, spheres: Array, shapes: tuple[Any, ...],
) -> tuple[float, ...]:  # fmt: skip
    """`ball_rates` where there are shapes."""
    if not len(shapes):
        return fx, fy, fz, ux, uy, uz
    return ball_rates(px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, spheres[body], shapes[0][body])


def back_through_shaped(
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float, state: Array,
    body: int, spheres: Array, shapes: tuple[Any, ...], out: Array, by_shape: Array,
) -> tuple[float, ...]:  # fmt: skip
    """`back_through_ball` where there are shapes, from a state as ``tracer.kernels.landing`` keeps it."""
    if not len(shapes):
        return fx, fy, fz, gx, gy, gz
    px, py, pz = (
        state[0] + spheres[body, CENTRE_X],
        state[1] + spheres[body, CENTRE_Y],
        state[2] + spheres[body, 2],
    )
    return back_through_ball(
        fx, fy, fz, gx, gy, gz, px, py, pz, state[3], state[4], state[5], spheres[body], shapes[0][body],
        out, by_shape,
    )  # fmt: skip


@overload(is_shaped, jit_options=OVERLOADED)
def _is_shaped(shapes, body):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda shapes, body: False
    return lambda shapes, body: shapes[0][body, MEAN] > 0.0


@overload(next_shaped, jit_options=OVERLOADED)
def _next_shaped(px, py, pz, dx, dy, dz, last, spheres, shapes, room, home):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda px, py, pz, dx, dy, dz, last, spheres, shapes, room, home: (NOTHING, math.inf)
    return lambda px, py, pz, dx, dy, dz, last, spheres, shapes, room, home: next_of_shaped(
        px, py, pz, dx, dy, dz, last, spheres, shapes[0], room, home
    )


@overload(cross_shaped, jit_options=OVERLOADED)
def _cross_shaped(px, py, pz, dx, dy, dz, body, spheres, shapes):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda px, py, pz, dx, dy, dz, body, spheres, shapes: (BESIDE, px, py, pz, dx, dy, dz, 0.0, 1.0)
    return lambda px, py, pz, dx, dy, dz, body, spheres, shapes: cross_ball(
        px, py, pz, dx, dy, dz, spheres[body], shapes[0][body]
    )


@overload(shaped_rates, jit_options=OVERLOADED)
def _shaped_rates(px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, body, spheres, shapes):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, body, spheres, shapes: (
            fx, fy, fz, ux, uy, uz,
        )  # fmt: skip
    return lambda px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, body, spheres, shapes: ball_rates(
        px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, spheres[body], shapes[0][body]
    )


@overload(back_through_shaped, jit_options=OVERLOADED)
def _back_through_shaped(fx, fy, fz, gx, gy, gz, state, body, spheres, shapes, out, by_shape):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    if not len(shapes):
        return lambda fx, fy, fz, gx, gy, gz, state, body, spheres, shapes, out, by_shape: (
            fx, fy, fz, gx, gy, gz,
        )  # fmt: skip

    def back(fx, fy, fz, gx, gy, gz, state, body, spheres, shapes, out, by_shape):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        ball = spheres[body]
        return back_through_ball(
            fx, fy, fz, gx, gy, gz, state[0] + ball[0], state[1] + ball[1], state[2] + ball[2],
            state[3], state[4], state[5], ball, shapes[0][body], out, by_shape,
        )  # fmt: skip

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
def height(ux: float, uy: float, uz: float, shape: Array) -> tuple[float, float, float, float]:
    """H(u) and its gradient along the unit sphere."""
    a, ax, ay, az = polynomial(ux, uy, uz, shape, EVEN, 6)
    b, bx, by, bz = polynomial(ux, uy, uz, shape, ODD, 5)
    radial = 6.0 * a + 5.0 * b
    return a + b, ax + bx - radial * ux, ay + by - radial * uy, az + bz - radial * uz


@kernel
def excess(x: float, y: float, z: float, shape: Array) -> tuple[float, float, float, float]:
    """Rho / r(u) - 1 at a point, negative inside, and its gradient."""
    rho = math.sqrt(x * x + y * y + z * z)
    ux, uy, uz = x / rho, y / rho, z / rho
    h, hx, hy, hz = height(ux, uy, uz, shape)
    r = shape[MEAN] + h
    return (rho - r) / r, (ux - hx / r) / r, (uy - hy / r) / r, (uz - hz / r) / r


@kernel
def normal(x: float, y: float, z: float, shape: Array) -> tuple[float, float, float]:
    """G, the gradient of rho - r(u): an outward normal, not of length 1."""
    rho = math.sqrt(x * x + y * y + z * z)
    ux, uy, uz = x / rho, y / rho, z / rho
    _, hx, hy, hz = height(ux, uy, uz, shape)
    return ux - hx / rho, uy - hy / rho, uz - hz / rho


@kernel
def normal_change(
    x: float, y: float, z: float, shape: Array, vx: float, vy: float, vz: float
) -> tuple[float, float, float]:
    """C v, the change of `normal` when the point moves by v; C is symmetric."""
    rho = math.sqrt(x * x + y * y + z * z)
    ux, uy, uz = x / rho, y / rho, z / rho
    a, ax, ay, az = polynomial(ux, uy, uz, shape, EVEN, 6)
    b, bx, by, bz = polynomial(ux, uy, uz, shape, ODD, 5)
    axx, ayy, azz, axy, axz, ayz = curvature(ux, uy, uz, shape, EVEN, 6)
    bxx, byy, bzz, bxy, bxz, byz = curvature(ux, uy, uz, shape, ODD, 5)
    radial, twice = 6.0 * a + 5.0 * b, 48.0 * a + 35.0 * b
    gx, gy, gz = 6.0 * ax + 5.0 * bx, 6.0 * ay + 5.0 * by, 6.0 * az + 5.0 * bz
    uv, gv = ux * vx + uy * vy + uz * vz, gx * vx + gy * vy + gz * vz
    along = twice * uv - gv
    hx = (axx + bxx) * vx + (axy + bxy) * vy + (axz + bxz) * vz - uv * gx + along * ux - radial * vx
    hy = (axy + bxy) * vx + (ayy + byy) * vy + (ayz + byz) * vz - uv * gy + along * uy - radial * vy
    hz = (axz + bxz) * vx + (ayz + byz) * vy + (azz + bzz) * vz - uv * gz + along * uz - radial * vz
    return (
        (vx - uv * ux - hx / rho) / rho,
        (vy - uv * uy - hy / rho) / rho,
        (vz - uv * uz - hz / rho) / rho,
    )


@kernel
def surface(
    ax: float, ay: float, az: float, dx: float, dy: float, dz: float, s: float, side: float, shape: Array
) -> tuple[bool, float, float, float, float]:
    """Whether the line a + s d meets the ball, where, and the unit normal there.

    From s outside of it, towards the ball: `side` -1 is the near surface, 1 the far one.
    """
    nx, ny, nz = 0.0, 0.0, 0.0
    for _ in range(MOST_STEPS):
        value, nx, ny, nz = excess(ax + s * dx, ay + s * dy, az + s * dz, shape)
        slope = nx * dx + ny * dy + nz * dz
        if not side * slope > 0.0:
            return False, s, nx, ny, nz
        s -= value / slope
        if value <= ROUNDING:
            break
    nx, ny, nz = normal(ax + s * dx, ay + s * dy, az + s * dz, shape)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    return True, s, nx / length, ny / length, nz / length


@kernel
def meets_ball(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, ball: Array, shape: Array
) -> float:
    """Distance along the half-line p + t d to the middle of its chord in the ball, inf for a miss.

    `ball`: row of the sphere around it (``tracer.kernels.sphere``).
    """
    m, ax, ay, az = foot(px - ball[0], py - ball[1], pz - ball[2], dx, dy, dz)
    far2 = ball[RADIUS] * ball[RADIUS] - (ax * ax + ay * ay + az * az)
    if not far2 > 0.0 or not m + ball[RADIUS] > 0.0:
        return math.inf
    far = math.sqrt(far2)
    found, near, _, _, _ = surface(ax, ay, az, dx, dy, dz, -far, -1.0, shape)
    if not found:
        return math.inf
    _, far, _, _, _ = surface(ax, ay, az, dx, dy, dz, far, 1.0, shape)
    t = m + 0.5 * (near + far)
    return t if t > 0.0 else math.inf


@kernel
def cross_ball(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, ball: Array, shape: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """What becomes of a ray at a ball, point and direction behind it, path / n around, share of the light.

    The point is where it leaves the ball; where it is REFLECTED, totally, on either surface, or passes BESIDE by
    rounding, the nearest to the centre.
    """
    cx, cy, cz, n = ball[0], ball[1], ball[2], ball[INDEX]
    m, ax, ay, az = foot(px - cx, py - cy, pz - cz, dx, dy, dz)
    around2 = ball[RADIUS] * ball[RADIUS]
    far = math.sqrt(max(around2 - (ax * ax + ay * ay + az * az), 0.0))
    found, s, nx, ny, nz = surface(ax, ay, az, dx, dy, dz, -far, -1.0, shape)
    if not found:
        return BESIDE, cx + ax, cy + ay, cz + az, dx, dy, dz, m, 1.0
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, 1.0 / n)
    if c2 == 0.0:
        return REFLECTED, cx + ax, cy + ay, cz + az, dx, dy, dz, m, 0.0
    path, light = m + s, transmittance(c1, c2, n)
    m, ax, ay, az = foot(ax + s * dx, ay + s * dy, az + s * dz, ex, ey, ez)
    far = math.sqrt(max(around2 - (ax * ax + ay * ay + az * az), 0.0))
    _, s, nx, ny, nz = surface(ax, ay, az, ex, ey, ez, far, 1.0, shape)
    path += n * (m + s)
    qx, qy, qz = cx + (ax + s * ex), cy + (ay + s * ey), cz + (az + s * ez)
    dx, dy, dz, c1, c2 = refracted(ex, ey, ez, -nx, -ny, -nz, n)
    if c2 == 0.0:
        return REFLECTED, cx + ax, cy + ay, cz + az, ex, ey, ez, path, 0.0
    return BENT, qx, qy, qz, dx, dy, dz, path, light * transmittance(c1, c2, 1.0 / n)


@kernel
def inside(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, ball: Array, shape: Array
) -> tuple[float, ...]:
    """Both surfaces of a ray that goes through: t, q and the direction inside, t, q; q from the centre.

    Of a ray that does not meet the ball the first t is NaN.
    """
    n, around2 = ball[INDEX], ball[RADIUS] * ball[RADIUS]
    m, ax, ay, az = foot(px - ball[0], py - ball[1], pz - ball[2], dx, dy, dz)
    far = math.sqrt(max(around2 - (ax * ax + ay * ay + az * az), 0.0))
    found, s, nx, ny, nz = surface(ax, ay, az, dx, dy, dz, -far, -1.0, shape)
    ex, ey, ez, _, c2 = refracted(dx, dy, dz, nx, ny, nz, 1.0 / n)
    t = m + s if found and c2 > 0.0 else math.nan
    qx, qy, qz = ax + s * dx, ay + s * dy, az + s * dz
    m, ax, ay, az = foot(qx, qy, qz, ex, ey, ez)
    far = math.sqrt(max(around2 - (ax * ax + ay * ay + az * az), 0.0))
    _, s, _, _, _ = surface(ax, ay, az, ex, ey, ez, far, 1.0, shape)
    return t, qx, qy, qz, ex, ey, ez, m + s, ax + s * ex, ay + s * ey, az + s * ez


@kernel
def surface_rates(
    qx: float, qy: float, qz: float, dx: float, dy: float, dz: float, t: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float, shape: Array, side: float, e: float,
) -> tuple[float, ...]:  # fmt: skip
    """Derivatives of q = p + t d and of the direction behind the surface, `side` as for `surface`."""
    gx, gy, gz = normal(qx, qy, qz, shape)
    length = math.sqrt(gx * gx + gy * gy + gz * gz)
    fx, fy, fz = on_plane_rates(dx, dy, dz, t, gx, gy, gz, fx, fy, fz, ux, uy, uz, 0.0)
    rx, ry, rz = normal_change(qx, qy, qz, shape, fx, fy, fz)
    length *= -side
    nx, ny, nz, rx, ry, rz = gx / length, gy / length, gz / length, rx / length, ry / length, rz / length
    along = nx * rx + ny * ry + nz * rz
    _, _, _, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, e)
    rx, ry, rz = rx - along * nx, ry - along * ny, rz - along * nz
    ux, uy, uz = refracted_rates(dx, dy, dz, nx, ny, nz, e, c1, c2, ux, uy, uz, rx, ry, rz, 0.0)
    return fx, fy, fz, ux, uy, uz


@kernel
def ball_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float, ball: Array, shape: Array,
) -> tuple[float, ...]:  # fmt: skip
    """Derivatives of point and direction behind the ball when p changes by f and d by u."""
    t, qx, qy, qz, ex, ey, ez, s, x, y, z = inside(px, py, pz, dx, dy, dz, ball, shape)
    if not math.isfinite(t):
        m = -((px - ball[0]) * dx + (py - ball[1]) * dy + (pz - ball[2]) * dz)
        return fx + m * ux, fy + m * uy, fz + m * uz, ux, uy, uz
    n = ball[INDEX]
    fx, fy, fz, ux, uy, uz = surface_rates(qx, qy, qz, dx, dy, dz, t, fx, fy, fz, ux, uy, uz, shape, -1.0, 1.0 / n)
    return surface_rates(x, y, z, ex, ey, ez, s, fx, fy, fz, ux, uy, uz, shape, 1.0, n)


@kernel
def back_through_surface(
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float,
    qx: float, qy: float, qz: float, dx: float, dy: float, dz: float, t: float,
    shape: Array, side: float, e: float, out: Array,
) -> tuple[float, ...]:  # fmt: skip
    """Carry an adjoint pair (f, g) of q and of the direction behind one surface back to p and the one before.

    Adds what falls to the shape to out (50,); returns the pair, and what falls to e.
    """
    ox, oy, oz = normal(qx, qy, qz, shape)
    length = -side * math.sqrt(ox * ox + oy * oy + oz * oz)
    nx, ny, nz = ox / length, oy / length, oz / length
    _, _, _, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, e)
    k = (e - 1.0) * (e + 1.0) / (e * c1 + c2)
    k_bar = gx * nx + gy * ny + gz * nz
    c1_bar = k_bar * e * (1.0 - e * c1 / c2)
    e_bar = gx * dx + gy * dy + gz * dz + k_bar * (c1 + e * (1.0 - c1 * c1) / c2)
    rx, ry, rz = k * gx - c1_bar * dx, k * gy - c1_bar * dy, k * gz - c1_bar * dz
    gx, gy, gz = e * gx - c1_bar * nx, e * gy - c1_bar * ny, e * gz - c1_bar * nz
    along = rx * nx + ry * ny + rz * nz
    rx, ry, rz = (rx - along * nx) / length, (ry - along * ny) / length, (rz - along * nz) / length
    hx, hy, hz = normal_change(qx, qy, qz, shape, rx, ry, rz)
    fx, fy, fz = fx + hx, fy + hy, fz + hz
    s = (fx * dx + fy * dy + fz * dz) / (ox * dx + oy * dy + oz * dz)
    back_to_shape(qx, qy, qz, s, rx, ry, rz, out)
    fx, fy, fz = fx - s * ox, fy - s * oy, fz - s * oz
    return fx, fy, fz, gx + t * fx, gy + t * fy, gz + t * fz, e_bar


@kernel
def back_to_shape(qx: float, qy: float, qz: float, s: float, rx: float, ry: float, rz: float, out: Array) -> None:
    """Add what falls to R and to each coefficient: s times the height, less r times the slope of F by it."""
    rho = math.sqrt(qx * qx + qy * qy + qz * qz)
    x, y, z = qx / rho, qy / rho, qz / rho
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
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float,
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, ball: Array, shape: Array,
    out: Array, by_shape: Array,
) -> tuple[float, ...]:  # fmt: skip
    """Carry one adjoint pair (f, g) of point and direction behind a ball back to p and d.

    Adds what falls to centre, R and n to out (5,), and what falls to the shape's numbers to by_shape (50,).
    """
    t, qx, qy, qz, ex, ey, ez, s, x, y, z = inside(px, py, pz, dx, dy, dz, ball, shape)
    if not math.isfinite(t):
        m = -((px - ball[0]) * dx + (py - ball[1]) * dy + (pz - ball[2]) * dz)
        return fx, fy, fz, gx + m * fx, gy + m * fy, gz + m * fz
    n, radius_before, cx, cy, cz = ball[INDEX], by_shape[MEAN], fx, fy, fz
    fx, fy, fz, gx, gy, gz, out_bar = back_through_surface(
        fx, fy, fz, gx, gy, gz, x, y, z, ex, ey, ez, s, shape, 1.0, n, by_shape
    )
    fx, fy, fz, gx, gy, gz, in_bar = back_through_surface(
        fx, fy, fz, gx, gy, gz, qx, qy, qz, dx, dy, dz, t, shape, -1.0, 1.0 / n, by_shape
    )
    out[0] += cx - fx
    out[1] += cy - fy
    out[2] += cz - fz
    out[3] += by_shape[MEAN] - radius_before
    out[4] += out_bar - in_bar / (n * n)
    return fx, fy, fz, gx, gy, gz
