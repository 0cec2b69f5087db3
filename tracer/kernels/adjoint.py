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
"""

from tracer.kernels._jit import Array, kernel
from tracer.kernels.march import (
    BLOCKED,
    DIRECT,
    MAX_EVENTS,
    RECOVERED,
    TIR,
    TOO_MANY_EVENTS,
    next_body,
    next_key,
)
from tracer.kernels.rod import ROD
from tracer.kernels.shell import event_at, with_cores, with_cores_rates
from tracer.kernels.sphere import angles, foot, through, through_rates, turned

STATE = 8  # w, d, m, b2 of each sphere crossed


@kernel
def march_recorded(
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    spheres: Array,
    rods: Array,
    trail: Array,
    state: Array,
) -> tuple[float, ...]:
    """March as `tracer.kernels.march.march`, and keep what the way back needs.

    Returns status, the foot point and direction of the last straight piece, key and events; ``state``
    (MAX_EVENTS, STATE) receives w, d, m and b^2 of each sphere crossed, ``trail`` the event.
    """
    key, events, last = DIRECT, 0, -1
    while True:
        body = next_body(px, py, pz, dx, dy, dz, last, spheres, rods)
        if body == -1:
            return RECOVERED, px, py, pz, dx, dy, dz, key, events
        if body == ROD or spheres[body, 5] != 0.0:
            return BLOCKED, px, py, pz, dx, dy, dz, key, events
        if events == MAX_EVENTS:
            return TOO_MANY_EVENTS, px, py, pz, dx, dy, dz, key, events
        radius, n = spheres[body, 3], spheres[body, 4]
        wx, wy, wz = px - spheres[body, 0], py - spheres[body, 1], pz - spheres[body, 2]
        m, ax, ay, az = foot(wx, wy, wz, dx, dy, dz)
        b2 = ax * ax + ay * ay + az * az
        if b2 >= radius * radius or b2 >= n * n * radius * radius:
            return TIR, px, py, pz, dx, dy, dz, key, events
        event = event_at(b2, body, spheres)
        trail[events] = event
        state[events, 0], state[events, 1], state[events, 2] = wx, wy, wz
        state[events, 3], state[events, 4], state[events, 5] = dx, dy, dz
        state[events, 6], state[events, 7] = m, b2
        cos_i, cos_t = angles(b2, radius, n)
        cosine, q = through(b2, radius, n, cos_i, cos_t)
        if event != body:
            cosine, q, _, _ = with_cores(b2, spheres[body], event // spheres.shape[0], cosine, q)
        ax, ay, az, dx, dy, dz = turned(ax, ay, az, dx, dy, dz, b2, cosine, q)
        px, py, pz = spheres[body, 0] + ax, spheres[body, 1] + ay, spheres[body, 2] + az
        key = next_key(key, event)
        events += 1
        last = body


@kernel
def back_through(
    fx: float,
    fy: float,
    fz: float,
    gx: float,
    gy: float,
    gz: float,
    sphere: Array,
    way: int,
    state: Array,
    out: Array,
) -> tuple[float, ...]:
    """Carry one adjoint pair (f, g) of (a', d') back through a sphere; add c_bar, R_bar, n_bar to out (5,).

    `way` through its cores, which are held fixed (``tracer.kernels.shell``).
    """
    wx, wy, wz, dx, dy, dz, m, b2 = (
        state[0],
        state[1],
        state[2],
        state[3],
        state[4],
        state[5],
        state[6],
        state[7],
    )
    ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
    radius, n = sphere[3], sphere[4]
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
    ex, ey, ez = target[3 + 3 * axis], target[4 + 3 * axis], target[5 + 3 * axis]
    nx, ny, nz = target[9], target[10], target[11]
    qx, qy, qz = px - target[0], py - target[1], pz - target[2]
    slope = dx * nx + dy * ny + dz * nz
    t = -(qx * nx + qy * ny + qz * nz) / slope
    value = (qx + t * dx) * ex + (qy + t * dy) * ey + (qz + t * dz) * ez
    k = (dx * ex + dy * ey + dz * ez) / slope
    fx, fy, fz = ex - k * nx, ey - k * ny, ez - k * nz
    return value, t, fx, fy, fz, t * fx, t * fy, t * fz
