"""Landing points on a target plane with their derivatives by every number of the scene.

The backward sweep ends at the pinhole with f = ds/dorigin and g = ds/ddirection for
each landing coordinate s.  The camera's part is closed form, because the pinhole ray is d = Rot(w) R^T v/|v|
with v = (a, b, 1) and (a, b) the ideal image point of the acquired (x, y):

    ds/dw = d x g,    h = ds/d(a, b) = (c - (c . v) v/|v|^2) / |v| with c = R g,    ds/d(x, y) = h d(a, b)/d(x, y)

and the target's follows from the last straight piece: moving the target's material points by D changes the
landing point on it as moving the ray by -D does, of which the part along the ray counts for nothing.

A row of ``rate`` holds camera (14: x, y, z, rx, ry, rz, focal_px, cu, cv, k1, k2, k3, p1, p2) | 5 of each
sphere (x, y, z, radius, n) | the row of each other body whose kind has `Kind.numbers`, table by table | target (6:
x, y, z, rx, ry, rz); turns are about the world's axes [rad].  What the shapes of balls out of round do stands in
``by_shape``, of no rows where none is.

**The sweep.**  Forwards a ray is a chain of turns (``tracer.kernels.sphere``); for a few outputs and many
parameters the chain rule is cheapest backwards.  The landing point has two coordinates, so two adjoint pairs
(p_bar, d_bar) = d(coordinate)/d(p, d) travel from the plane back to the pinhole.  Through one sphere, with w = p -
c, m = -w . d, a = w + m d, beta = a . a, C and q the turn, a' = C a + beta q d, d' = C d - q a:

    C_bar = a'_bar . a + d'_bar . d          along_bar = a'_bar . d
    q_bar = along_bar beta - d'_bar . a      beta_bar = along_bar q + C_bar C_beta + q_bar q_beta
    a_bar = C a'_bar - q d'_bar + 2 beta_bar a
    d_bar = beta q a'_bar + C d'_bar + m a_bar - (a_bar . d) w
    w_bar = a_bar - (a_bar . d) d
    R_bar = C_bar C_R + q_bar q_R            n_bar = C_bar C_n + q_bar q_n
    p_bar = w_bar                            c_bar = a'_bar - w_bar

Cost: about two tangents, whatever the number of parameters.

A tangent by rounding (``tracer.kernels.rays``) passes: C = 1, q = 0 and nothing depends on the sphere.  A body of
another kind gives derivatives forwards only (`Kind.rates`); one sweep through it takes six of them, and one more
for each of its own numbers.
"""

import math
from typing import Any, NamedTuple

from ground.jit import OVERLOADED, Array, kernel, kernel_composed, overload
from tracer.kernels.ball import back_through_shaped, is_shaped
from tracer.kernels.branches import NOTHING, body_of
from tracer.kernels.camera import (
    AHEAD_X,
    CENTRE_U,
    CENTRE_V,
    DOWN_X,
    FOCAL,
    K1,
    K2,
    K3,
    P1,
    P2,
    RIGHT_X,
    eye_of,
    undistort,
)
from tracer.kernels.rays import ORIGIN, Crossing, trace_ray
from tracer.kernels.sphere import (
    RADIUS,
    REFRACTIVE_INDEX,
    Turn,
    angles,
    through,
    through_rates,
    with_cores,
    with_cores_rates,
)
from tracer.kernels.vectors import (
    Vector,
    add_dot,
    combine,
    cross_product,
    dot,
    move,
    scale,
    subtract,
    vector_at,
    with_component,
)
from tracer.kernels.world import KINDS, MISSED_PLANE, RECOVERED, Tables, World, place_of_other, rates_other

STATE = 8  # w, d, m, b2 of each body crossed
AXES, NORMAL = 3, 9  # of a target: where they begin after its origin
CAMERA_NUMBERS, SPHERE_NUMBERS, TARGET_NUMBERS = 14, 5, 6


class SweepScratch(NamedTuple):
    """Memory of one thread: trail (MAX_EVENTS,) int32, state (MAX_EVENTS, STATE), zeros move (MOST_NUMBERS,)."""

    trail: Array
    state: Array
    move: Array


class LandingArrays(NamedTuple):
    """Results for N pixels.

    Parameters
    ----------
    status, key, point : (N,) uint8, (N,) int64, (N, 2)
        Status, branch key and target coordinates.
    by_pixel, rate : (N, 2, 2), (N, 2, 14 + 5 S + W + 6)
        Derivatives by the pixel and by the scene's numbers; W = 0 where other bodies' numbers are not asked for.
    by_shape : (N, 2, S, 50)
        Derivatives by the shapes; (0, 2, S, 50) where all spheres are round.
    """

    status: Array
    key: Array
    point: Array
    by_pixel: Array
    rate: Array
    by_shape: Array


@kernel_composed
def keep_states(kept: tuple[Array, Array], c: Crossing, world: World) -> tuple[Array, Array]:
    """Record what the way back needs: trail (MAX_EVENTS,) int32, state (MAX_EVENTS, STATE)."""
    trail, state = kept
    at = c.place
    trail[at] = c.event
    state[at, 0], state[at, 1], state[at, 2] = c.w
    state[at, 3], state[at, 4], state[at, 5] = c.d
    state[at, 6], state[at, 7] = c.m, c.b2
    return kept


@kernel
def trace_states(
    p: Vector, d: Vector, world: World, trail: Array, state: Array
) -> tuple[int, Vector, Vector, int, int]:
    """Trace one ray from p along d as `trace_ray`, and keep its states: status, point, direction, key, events."""
    status, p, d, key, events, _, _ = trace_ray(p, d, world, keep_states, (trail, state))
    return status, p, d, key, events


@kernel
def back_through_other(
    f: Vector, g: Vector, body: int, way: int, world: World, state: Array
) -> tuple[Vector, Vector]:
    """Carry one adjoint pair (f, g) of (p', d') back through a body of another kind."""
    p, d = vector_at(state, 0), vector_at(state, 3)
    back_f, back_g = ORIGIN, ORIGIN
    for k in range(3):
        unit = with_component(ORIGIN, k, 1.0)
        x, u = rates_other(p, d, unit, ORIGIN, body, world.others, world.still, way)
        back_f = with_component(back_f, k, add_dot(dot(f, x), g, u))
        x, u = rates_other(p, d, ORIGIN, unit, body, world.others, world.still, way)
        back_g = with_component(back_g, k, add_dot(dot(f, x), g, u))
    return back_f, back_g


@kernel
def back_to_row(
    f: Vector, g: Vector, body: int, way: int, world: World, state: Array, move: Array, out: Array
) -> None:
    """Add what a body of another kind has of one adjoint pair by each number of its row to out (W,).

    move (MOST_NUMBERS,) scratch, all zeros before and after.
    """
    p, d = vector_at(state, 0), vector_at(state, 3)
    for k in range(out.shape[0]):
        move[k] = 1.0
        x, u = rates_other(p, d, ORIGIN, ORIGIN, body, world.others, move, way)
        out[k] += add_dot(dot(f, x), g, u)
        move[k] = 0.0


@kernel
def turn_rates(b2: float, sphere: Array, way: int, surface: tuple[float, float, Turn], rates: Vector) -> Turn:
    """Derivatives of a sphere's turn for given rates of b^2, R and n; `surface`: cos i, cos t, turn."""
    (b2_rate, radius_rate, n_rate), (cos_i, cos_t, solid) = rates, surface
    turn = through_rates(b2, sphere[RADIUS], sphere[REFRACTIVE_INDEX], cos_i, cos_t, b2_rate, radius_rate, n_rate)
    return with_cores_rates(b2, sphere, way, solid, turn, b2_rate, n_rate) if way > 0 else turn


@kernel
def back_through(f: Vector, g: Vector, sphere: Array, way: int, state: Array, out: Array) -> tuple[Vector, Vector]:
    """Carry one adjoint pair (f, g) of (a', d') back through a sphere; add c_bar, R_bar, n_bar to out (5,).

    `way` through its cores, which are held fixed (``tracer.kernels.sphere``).
    """
    w, d, m, b2 = vector_at(state, 0), vector_at(state, 3), state[6], state[7]
    radius, n = sphere[RADIUS], sphere[REFRACTIVE_INDEX]
    if not b2 < radius * radius:
        return f, move(g, m, f)
    a = move(w, m, d)
    cos_i, cos_t = angles(b2, radius, n)
    solid = through(b2, radius, n, cos_i, cos_t)
    turn = solid
    if way > 0:
        turn, _, _ = with_cores(b2, sphere, way, solid)
    cosine, q = turn
    cosine_bar, along_bar = add_dot(dot(f, a), g, d), dot(f, d)
    q_bar, surface = along_bar * b2 - dot(g, a), (cos_i, cos_t, solid)
    cosine_rate, q_rate = turn_rates(b2, sphere, way, surface, (1.0, 0.0, 0.0))
    b2_bar = along_bar * q + cosine_bar * cosine_rate + q_bar * q_rate
    cosine_rate, q_rate = turn_rates(b2, sphere, way, surface, (0.0, 1.0, 0.0))
    out[3] += cosine_bar * cosine_rate + q_bar * q_rate
    cosine_rate, q_rate = turn_rates(b2, sphere, way, surface, (0.0, 0.0, 1.0))
    out[4] += cosine_bar * cosine_rate + q_bar * q_rate
    h = move(combine(cosine, f, -q, g), 2.0 * b2_bar, a)
    h_along = dot(h, d)
    u = move(h, -h_along, d)
    for k in range(3):
        out[k] += f[k] - u[k]
    return u, move(move(combine(b2 * q, f, cosine, g), m, h), -h_along, w)


@kernel
def hit_target(p: Vector, d: Vector, target: Array, axis: int) -> tuple[float, float, Vector, Vector]:
    """Target coordinate of p + t d along target axis 0 or 1, t, and the adjoints p_bar, d_bar of that coordinate.

    ``target`` (12,): origin, first axis, second axis, normal (orthonormal).
    """
    e, n = vector_at(target, AXES + 3 * axis), vector_at(target, NORMAL)
    q = subtract(p, vector_at(target, 0))
    slope = dot(d, n)
    t = -dot(q, n) / slope
    f = move(e, -(dot(d, e) / slope), n)
    return dot(move(q, t, d), e), t, f, scale(t, f)


@kernel
def camera_rates(
    pixel: tuple[float, float], camera: Array, d: Vector, g: Vector, by_pixel: Array, row: Array
) -> None:
    """Derivatives of one landing coordinate by rotation, focal length, centre and lens, from g = ds/ddirection.

    camera (20,) as in `tracer.kernels.camera`; d the ray's direction; by_pixel (2,) out; row (14,) out, but its
    first three.
    """
    focal = camera[FOCAL]
    x, y = (pixel[0] - camera[CENTRE_U]) / focal, (pixel[1] - camera[CENTRE_V]) / focal
    p1, p2 = camera[P1], camera[P2]
    a, b, radial, slope = undistort(x, y, camera[K1], camera[K2], camera[K3], p1, p2)
    row[3], row[4], row[5] = cross_product(d, g)
    c = (dot(vector_at(camera, RIGHT_X), g), dot(vector_at(camera, DOWN_X), g), dot(vector_at(camera, AHEAD_X), g))
    square = a * a + b * b + 1.0
    length, along = math.sqrt(square), (c[0] * a + c[1] * b + c[2]) / square
    hx, hy = (c[0] - along * a) / length, (c[1] - along * b) / length
    mixed = 2.0 * (x * y * slope + p1 * x + p2 * y)
    by_x = hx * (radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x) + hy * mixed
    by_y = hy * (radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x) + hx * mixed
    by_pixel[0], by_pixel[1] = by_x / focal, by_y / focal
    row[6], row[7], row[8] = -(by_x * x + by_y * y) / focal, -by_x / focal, -by_y / focal
    r2, radial_bar = x * x + y * y, hx * x + hy * y
    row[9], row[10], row[11] = radial_bar * r2, radial_bar * r2 * r2, radial_bar * r2 * r2 * r2
    row[12] = 2.0 * hx * x * y + hy * (r2 + 2.0 * y * y)
    row[13] = hx * (r2 + 2.0 * x * x) + 2.0 * hy * x * y


@kernel
def target_rates(f: Vector, q: Vector, row: Array) -> None:
    """Derivatives by the target's pose, row (6,), from p_bar and the point on the target."""
    turn = cross_product(q, f)
    for k in range(3):
        row[k], row[3 + k] = -f[k], -turn[k]


def bend_rays(others: tuple[Any, ...]) -> bool:
    """Return whether rays go on behind bodies of some tables: behind opaque ones nothing has derivatives."""
    return any(KINDS[type(table)].rates is not None for table in others)


@overload(bend_rays, jit_options=OVERLOADED)
def _bend_rays(others):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    found = any(KINDS[table.instance_class].rates is not None for table in others.types)
    return lambda others: found


@kernel
def sweep_back(
    pair: tuple[Vector, Vector],
    events: int,
    world: World,
    scratch: SweepScratch,
    out: LandingArrays,
    i: int,
    axis: int,
) -> tuple[Vector, Vector]:
    """Carry an adjoint pair of coordinate `axis` of pixel i from behind the last event back to the pinhole.

    Adds what falls to the numbers of the bodies to ``out.rate`` and ``out.by_shape``.
    """
    (f, g), spheres, row = pair, world.spheres, out.rate[i, axis]
    end = row.shape[0] - TARGET_NUMBERS
    of_others = CAMERA_NUMBERS + SPHERE_NUMBERS * spheres.shape[0]
    for event in range(events - 1, -1, -1):
        (body, way), state = body_of(scratch.trail[event], spheres), scratch.state[event]
        if bend_rays(world.others) and body < NOTHING:
            at, width = place_of_other(body, world.others, of_others)
            if at + width <= end:
                back_to_row(f, g, body, way, world, state, scratch.move, row[at : at + width])
            f, g = back_through_other(f, g, body, way, world, state)
            continue
        at = CAMERA_NUMBERS + SPHERE_NUMBERS * body
        numbers = row[at : at + SPHERE_NUMBERS]
        if len(world.shapes) > 0 and is_shaped(world.shapes, body):
            by_shape = out.by_shape[i, axis, body]
            f, g = back_through_shaped(f, g, state, body, spheres, world.shapes, numbers, by_shape)
        else:
            f, g = back_through(f, g, spheres[body], way, state, numbers)
    return f, g


@kernel
def trace_landings(
    rays: tuple[Array, Array], tables: Tables, target: Array, n_ambient: float, first: int, last: int,
    scratch: SweepScratch, out: LandingArrays,
) -> None:  # fmt: skip
    """Trace pixels first..last-1 onto a target plane with all derivatives; NaN unless recovered.

    `rays`: pixels (N, 2) and directions (N, 3) of their rays; ``target`` (12,): origin and axes.
    """
    (pixels, directions), (camera, world) = rays, tables
    spheres, end = world.spheres, out.rate.shape[2] - TARGET_NUMBERS
    for i in range(first, last):
        direction = vector_at(directions[i], 0)
        kept = scratch.trail, scratch.state
        s, p, d, key, events, _, _ = trace_ray(eye_of(camera), direction, world, keep_states, kept)
        if s == RECOVERED and not dot(d, vector_at(target, NORMAL)) < 0.0:
            s = MISSED_PLANE
        out.status[i], out.key[i] = s, key
        if s != RECOVERED:
            out.point[i] = math.nan
            out.by_pixel[i] = math.nan
            out.rate[i] = math.nan
            if len(world.shapes) > 0:
                out.by_shape[i] = math.nan
            continue
        for axis in range(2):
            value, t, f, g = hit_target(p, d, target, axis)
            row = out.rate[i, axis]
            out.point[i, axis] = value
            target_rates(f, subtract(move(p, t, d), vector_at(target, 0)), row[end:])
            row[CAMERA_NUMBERS:end] = 0.0
            if len(world.shapes) > 0:
                out.by_shape[i, axis] = 0.0
            f, g = sweep_back((f, g), int(events), world, scratch, out, i, axis)
            for k in range(spheres.shape[0]):
                around = n_ambient  # derivatives are by the absolute index of the glass
                if world.rooms.home.shape[0] > 0:
                    around *= world.rooms.n[world.rooms.home[k]]
                row[CAMERA_NUMBERS + SPHERE_NUMBERS * k + 4] /= around
            row[0], row[1], row[2] = f
            camera_rates((pixels[i, 0], pixels[i, 1]), camera, direction, g, out.by_pixel[i, axis], row)
