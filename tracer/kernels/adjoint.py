"""How the landing point of a ray depends on everything: one backward sweep through the spheres.

Forwards a ray is a chain of turns (``tracer.kernels.sphere``); for a few outputs and many parameters the
chain rule is cheapest backwards.  The landing point has two coordinates, so two adjoint pairs
(p_bar, d_bar) = d(coordinate)/d(p, d) travel from the plane back to the pinhole.  Through one sphere,
with w = p - c, m = -w . d, a = w + m d, beta = a . a, C and q the turn, a' = C a + beta q d, d' = C d - q a:

    C_bar = a'_bar . a + d'_bar . d          along_bar = a'_bar . d
    q_bar = along_bar beta - d'_bar . a      beta_bar = along_bar q + C_bar C_beta + q_bar q_beta
    a_bar = C a'_bar - q d'_bar + 2 beta_bar a
    d_bar = beta q a'_bar + C d'_bar + m a_bar - (a_bar . d) w
    w_bar = a_bar - (a_bar . d) d
    R_bar = C_bar C_R + q_bar q_R            n_bar = C_bar C_n + q_bar q_n
    p_bar = w_bar                            c_bar = a'_bar - w_bar

Cost: about two tangents, whatever the number of parameters.

A tangent by rounding (``tracer.kernels.walk``) passes: C = 1, q = 0 and nothing depends on the sphere.  A body of
another kind gives derivatives forwards only (`Kind.rates`); one sweep through it takes six of them, and one more
for each of its own numbers.
"""

from typing import Any

from ground.jit import Array, kernel, kernel_composed
from tracer.kernels.shell import with_cores, with_cores_rates
from tracer.kernels.sphere import INDEX, RADIUS, angles, through, through_rates
from tracer.kernels.walk import Crossing, walk
from tracer.kernels.world import World, rates_other

STATE = 8  # w, d, m, b2 of each body crossed
AXES, NORMAL = 3, 9  # of a target: where they begin after its origin


@kernel_composed
def keep_states(kept: tuple[Array, Array], c: Crossing, world: World) -> tuple[Array, Array]:
    """Record what the way back needs: trail (MAX_EVENTS,) int32, state (MAX_EVENTS, STATE)."""
    trail, state = kept
    at = c.place
    trail[at] = c.event
    state[at, 0], state[at, 1], state[at, 2] = c.wx, c.wy, c.wz
    state[at, 3], state[at, 4], state[at, 5] = c.dx, c.dy, c.dz
    state[at, 6], state[at, 7] = c.m, c.b2
    return kept


@kernel
def trace_states(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, world: World, trail: Array, state: Array
) -> tuple[Any, ...]:  # fmt: skip
    """Trace one ray from p along d as `walk`, and keep its states."""
    status, px, py, pz, dx, dy, dz, key, events, _, _ = walk(
        px, py, pz, dx, dy, dz, world, keep_states, (trail, state)
    )
    return status, px, py, pz, dx, dy, dz, key, events


@kernel
def back_through_other(
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float, body: int, way: int,
    world: World, state: Array,
) -> tuple[float, ...]:  # fmt: skip
    """Carry one adjoint pair (f, g) of (p', d') back through a body of another kind."""
    px, py, pz, dx, dy, dz = state[0], state[1], state[2], state[3], state[4], state[5]
    back = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for k in range(6):
        a, b, c = 1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0
        e, f, g = 1.0 if k == 3 else 0.0, 1.0 if k == 4 else 0.0, 1.0 if k == 5 else 0.0
        x, y, z, u, v, w = rates_other(
            px, py, pz, dx, dy, dz, a, b, c, e, f, g, body, world.others, world.still, way
        )
        rate = fx * x + fy * y + fz * z + gx * u + gy * v + gz * w
        back = (
            rate if k == 0 else back[0],
            rate if k == 1 else back[1],
            rate if k == 2 else back[2],
            rate if k == 3 else back[3],
            rate if k == 4 else back[4],
            rate if k == 5 else back[5],
        )
    return back


@kernel
def back_to_row(
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float, body: int, way: int,
    world: World, state: Array, move: Array, out: Array,
) -> None:  # fmt: skip
    """Add what a body of another kind has of one adjoint pair by each number of its row to out (W,).

    move (MOST_NUMBERS,) scratch, all zeros before and after.
    """
    px, py, pz, dx, dy, dz = state[0], state[1], state[2], state[3], state[4], state[5]
    for k in range(out.shape[0]):
        move[k] = 1.0
        x, y, z, u, v, w = rates_other(
            px, py, pz, dx, dy, dz, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, body, world.others, move, way
        )
        out[k] += fx * x + fy * y + fz * z + gx * u + gy * v + gz * w
        move[k] = 0.0


@kernel
def back_through(
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float,
    sphere: Array, way: int, state: Array, out: Array,
) -> tuple[float, ...]:  # fmt: skip
    """Carry one adjoint pair (f, g) of (a', d') back through a sphere; add c_bar, R_bar, n_bar to out (5,).

    `way` through its cores, which are held fixed (``tracer.kernels.shell``).
    """
    wx, wy, wz, dx, dy, dz = state[0], state[1], state[2], state[3], state[4], state[5]
    m, b2 = state[6], state[7]
    radius, n = sphere[RADIUS], sphere[INDEX]
    if not b2 < radius * radius:
        return fx, fy, fz, gx + m * fx, gy + m * fy, gz + m * fz
    ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
    cos_i, cos_t = angles(b2, radius, n)
    solid, solid_q = through(b2, radius, n, cos_i, cos_t)
    cosine, q = solid, solid_q
    if way > 0:
        cosine, q, _, _ = with_cores(b2, sphere, way, solid, solid_q)
    cosine_bar = fx * ax + fy * ay + fz * az + gx * dx + gy * dy + gz * dz
    along_bar = fx * dx + fy * dy + fz * dz
    q_bar = along_bar * b2 - (gx * ax + gy * ay + gz * az)
    cosine_rate, q_rate = through_rates(b2, radius, n, cos_i, cos_t, 1.0, 0.0, 0.0)
    if way > 0:
        cosine_rate, q_rate = with_cores_rates(b2, sphere, way, solid, solid_q, cosine_rate, q_rate, 1.0, 0.0)
    b2_bar = along_bar * q + cosine_bar * cosine_rate + q_bar * q_rate
    cosine_rate, q_rate = through_rates(b2, radius, n, cos_i, cos_t, 0.0, 1.0, 0.0)
    if way > 0:
        cosine_rate, q_rate = with_cores_rates(b2, sphere, way, solid, solid_q, cosine_rate, q_rate, 0.0, 0.0)
    out[3] += cosine_bar * cosine_rate + q_bar * q_rate
    cosine_rate, q_rate = through_rates(b2, radius, n, cos_i, cos_t, 0.0, 0.0, 1.0)
    if way > 0:
        cosine_rate, q_rate = with_cores_rates(b2, sphere, way, solid, solid_q, cosine_rate, q_rate, 0.0, 1.0)
    out[4] += cosine_bar * cosine_rate + q_bar * q_rate
    hx = cosine * fx - q * gx + 2.0 * b2_bar * ax
    hy = cosine * fy - q * gy + 2.0 * b2_bar * ay
    hz = cosine * fz - q * gz + 2.0 * b2_bar * az
    h = hx * dx + hy * dy + hz * dz
    ux, uy, uz = hx - h * dx, hy - h * dy, hz - h * dz
    out[0] += fx - ux
    out[1] += fy - uy
    out[2] += fz - uz
    along = b2 * q
    return (
        ux,
        uy,
        uz,
        along * fx + cosine * gx + m * hx - h * wx,
        along * fy + cosine * gy + m * hy - h * wy,
        along * fz + cosine * gz + m * hz - h * wz,
    )


@kernel
def land_on_target(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, target: Array, axis: int
) -> tuple[float, ...]:
    """Target coordinate of p + t d along target axis 0 or 1, t, and the adjoints p_bar, d_bar of that coordinate.

    ``target`` (12,): origin, first axis, second axis, normal (orthonormal).
    """
    ex, ey, ez = target[AXES + 3 * axis], target[AXES + 3 * axis + 1], target[AXES + 3 * axis + 2]
    nx, ny, nz = target[NORMAL], target[NORMAL + 1], target[NORMAL + 2]
    qx, qy, qz = px - target[0], py - target[1], pz - target[2]
    slope = dx * nx + dy * ny + dz * nz
    t = -(qx * nx + qy * ny + qz * nz) / slope
    value = (qx + t * dx) * ex + (qy + t * dy) * ey + (qz + t * dz) * ez
    k = (dx * ex + dy * ey + dz * ez) / slope
    fx, fy, fz = ex - k * nx, ey - k * ny, ez - k * nz
    return value, t, fx, fy, fz, t * fx, t * fy, t * fz
