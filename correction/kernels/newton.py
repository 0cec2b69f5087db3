"""Newton on traced rays for a block of nodes at once, along ONE known sequence of spheres.

On a sheet every ray takes the same sequence, so nothing has to be looked for while iterating: the block goes
through the turns of the sequence, derivatives and all, in loops without a branch.  What leaves the sheet (no hit:
NaN; wrong sign of the determinant; a long step; no convergence) is left to the careful one-by-one Newton of
``correction.kernels.inverse``; what converged is traced once more with all bodies, and only counts if the ray
really takes the sequence.

A node has converged when a step is so small that derivatives and transmittance, which are those of the place
before it, are right behind it to what float32 holds; how small that is comes with its start.  The step is still
taken and leaves about its square.  The node then stays frozen while its neighbours go on, so that its bits do not
depend on them.

Columns of the block, STEP apart in one array (see ``tracer.kernels.chain``): pixel u, v; node x, y; position and
direction; their derivatives by u (F, U) and by v (G, V); transmittance; Jacobian d plane / d pixel.
"""

import math

from correction.kernels.bspline import INDEX
from correction.kernels.inverse import inverse_2x2, keep_view, solve_node, stretch, unowned_tables
from correction.node_status import FOLD, LOW_MAGNIFICATION, OUT_OF_FRAME, RECOVERED
from tracer.kernels._jit import Array, kernel, kernel_inlined, unowned
from tracer.kernels.camera import undistorted, unit_tangent
from tracer.kernels.chain import SKIP_LEFT_BEHIND, TRIP, begin_block, follow_block, whole_vectors
from tracer.kernels.march import RECOVERED as TRACED
from tracer.kernels.march import march_pixel_tangents
from tracer.kernels.sphere import (
    foot,
    foot_tangent,
    turned,
    turned_tangent,
)

GROUP = 64  # nodes of a block: 27 columns of them fit the first-level cache
STEP = GROUP + 8
U, V, X, Y, PX, PY, PZ, DX, DY, DZ = (k * STEP for k in range(10))
FX, FY, FZ, UX, UY, UZ, GX, GY, GZ, VX, VY, VZ = (k * STEP for k in range(10, 22))
LIGHT, KEPT, XU, XV, YU, YV, WORTH, WITHIN = (k * STEP for k in range(22, 30))
NEWTON_NUMBERS = 30 * STEP
VECTOR_STEPS = 8  # from a start within a pixel one or two do; more are for the careful way
MOVING, CONVERGED, FAILED = 0, 1, 2
ANOTHER = -2  # a trip that no ray takes

inverse_inlined = kernel_inlined(inverse_2x2.py_func)  # type: ignore[attr-defined]
stretch_inlined = kernel_inlined(stretch.py_func)  # type: ignore[attr-defined]
foot_inlined = kernel_inlined(foot.py_func)  # type: ignore[attr-defined]
turned_inlined = kernel_inlined(turned.py_func)  # type: ignore[attr-defined]
foot_tangent_inlined = kernel_inlined(foot_tangent.py_func)  # type: ignore[attr-defined]
turned_tangent_inlined = kernel_inlined(turned_tangent.py_func)  # type: ignore[attr-defined]
unit_tangent_inlined = kernel_inlined(unit_tangent.py_func)  # type: ignore[attr-defined]


@kernel
def aim(count: int, camera: Array, b: Array) -> None:
    """Rays of the pixels u, v with their derivatives."""
    ox, oy, oz = camera[0], camera[1], camera[2]
    c3, c4, c5, c6, c7, c8 = camera[3], camera[4], camera[5], camera[6], camera[7], camera[8]
    c9, c10, c11, scale, u0, v0 = camera[9], camera[10], camera[11], 1.0 / camera[12], camera[13], camera[14]
    k1, k2, k3, p1, p2 = camera[15], camera[16], camera[17], camera[18], camera[19]
    for i in range(count):
        x, y = (b[U + i] - u0) * scale, (b[V + i] - v0) * scale
        a, e, radial, slope = undistorted(x, y, k1, k2, k3, p1, p2)
        xx = (radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x) * scale
        xy = (2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y) * scale
        yy = (radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x) * scale
        unit = 1.0 / math.sqrt(a * a + e * e + 1.0)
        dx, dy, dz = (c3 * a + c6 * e + c9) * unit, (c4 * a + c7 * e + c10) * unit, (c5 * a + c8 * e + c11) * unit
        ux, uy, uz = unit_tangent_inlined(
            dx, dy, dz, unit, c3 * xx + c6 * xy, c4 * xx + c7 * xy, c5 * xx + c8 * xy
        )
        vx, vy, vz = unit_tangent_inlined(
            dx, dy, dz, unit, c3 * xy + c6 * yy, c4 * xy + c7 * yy, c5 * xy + c8 * yy
        )
        b[PX + i], b[PY + i], b[PZ + i], b[DX + i], b[DY + i], b[DZ + i] = ox, oy, oz, dx, dy, dz
        b[UX + i], b[UY + i], b[UZ + i], b[VX + i], b[VY + i], b[VZ + i] = ux, uy, uz, vx, vy, vz
        b[FX + i], b[FY + i], b[FZ + i], b[GX + i], b[GY + i], b[GZ + i] = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        b[LIGHT + i] = 1.0


@kernel_inlined
def turn_of(
    b2: float, r2: float, ir2: float, ir: float, n: float, nu: float, gk: float, kt: float
) -> tuple[float, float, float, float, float]:
    """Cos delta, q, their derivatives by b^2, and the transmittance of one surface; see ``tracer.kernels.sphere``.

    One division serves for all: the reciprocals of cos i, cos t, cos t + cos i/n and n cos i + cos t are products
    of three of them times the reciprocal of all four.
    """
    chi = b2 * ir2
    c, t = math.sqrt((r2 - b2) * ir2), math.sqrt(max(1.0 - b2 * kt, 0.0))
    den, other = t + c * nu, n * c + t
    ct, do = c * t, den * other
    r = 1.0 / (ct * do)
    inv_den, inv_other = r * ct * other, r * ct * den
    c_rate, t_rate = -0.5 * ir2 * (r * t * do), -0.5 * kt * (r * c * do)
    g = gk * inv_den
    g_rate = -g * inv_den * (t_rate + nu * c_rate)
    both = ct + chi * nu
    both_rate = c_rate * t + c * t_rate + ir2 * nu
    cosine, cosine_rate = 1.0 - 2.0 * chi * g * g, -2.0 * g * (ir2 * g + 2.0 * chi * g_rate)
    q, q_rate = 2.0 * g * both * ir, 2.0 * ir * (g_rate * both + g * both_rate)
    passed = 2.0 * n * ct * (nu * nu * inv_den * inv_den + inv_other * inv_other)
    return cosine, q, cosine_rate, q_rate, passed


@kernel
def cross(count: int, cx: float, cy: float, cz: float, radius: float, n: float, b: Array) -> None:
    """All rays through one sphere; NaN where a ray misses it or meets it behind."""
    r2, nu = radius * radius, 1.0 / n
    ir2, ir, kt, gk = 1.0 / r2, 1.0 / radius, 1.0 / (n * n * r2), (n - 1.0) * (n + 1.0) / (n * n)
    for i in range(count):
        dx, dy, dz = b[DX + i], b[DY + i], b[DZ + i]
        wx, wy, wz = b[PX + i] - cx, b[PY + i] - cy, b[PZ + i] - cz
        m, ax, ay, az = foot_inlined(wx, wy, wz, dx, dy, dz)
        b2 = ax * ax + ay * ay + az * az
        m = m if (m > 0.0) & (b2 < r2) & (b2 * kt < 1.0) else math.nan
        ux, uy, uz, vx, vy, vz = b[UX + i], b[UY + i], b[UZ + i], b[VX + i], b[VY + i], b[VZ + i]
        fx, fy, fz = foot_tangent_inlined(wx, wy, wz, dx, dy, dz, m, b[FX + i], b[FY + i], b[FZ + i], ux, uy, uz)
        gx, gy, gz = foot_tangent_inlined(wx, wy, wz, dx, dy, dz, m, b[GX + i], b[GY + i], b[GZ + i], vx, vy, vz)
        cosine, q, cosine_1, q_1, surface = turn_of(b2, r2, ir2, ir, n, nu, gk, kt)
        b[LIGHT + i] = b[LIGHT + i] * surface * surface
        rate = 2.0 * (ax * fx + ay * fy + az * fz)
        c_rate, q_rate = cosine_1 * rate, q_1 * rate
        fx, fy, fz, ux, uy, uz = turned_tangent_inlined(
            ax, ay, az, dx, dy, dz, b2, cosine, q, fx, fy, fz, ux, uy, uz, rate, c_rate, q_rate
        )
        rate = 2.0 * (ax * gx + ay * gy + az * gz)
        c_rate, q_rate = cosine_1 * rate, q_1 * rate
        gx, gy, gz, vx, vy, vz = turned_tangent_inlined(
            ax, ay, az, dx, dy, dz, b2, cosine, q, gx, gy, gz, vx, vy, vz, rate, c_rate, q_rate
        )
        ax, ay, az, dx, dy, dz = turned_inlined(ax, ay, az, dx, dy, dz, b2, cosine, q)
        b[PX + i], b[PY + i], b[PZ + i] = cx + ax, cy + ay, cz + az
        b[DX + i], b[DY + i], b[DZ + i] = dx, dy, dz
        b[FX + i], b[FY + i], b[FZ + i], b[UX + i], b[UY + i], b[UZ + i] = fx, fy, fz, ux, uy, uz
        b[GX + i], b[GY + i], b[GZ + i], b[VX + i], b[VY + i], b[VZ + i] = gx, gy, gz, vx, vy, vz


@kernel
def step_pixels(count: int, sign: float, b: Array, state: Array) -> int:
    """Move u, v by one Newton step towards the nodes; state (LANES,) int64; how many still move."""
    moving = 0
    for i in range(count):
        dx, dy, dz = b[DX + i], b[DY + i], b[DZ + i]
        inverse = -1.0 / dz
        t = b[PZ + i] * inverse
        tu, tv = (b[FZ + i] + t * b[UZ + i]) * inverse, (b[GZ + i] + t * b[VZ + i]) * inverse
        xu, xv = b[FX + i] + tu * dx + t * b[UX + i], b[GX + i] + tv * dx + t * b[VX + i]
        yu, yv = b[FY + i] + tu * dy + t * b[UY + i], b[GY + i] + tv * dy + t * b[VY + i]
        ex, ey = b[X + i] - b[PX + i] - t * dx, b[Y + i] - b[PY + i] - t * dy
        det = xu * yv - xv * yu
        inverse = 1.0 / det
        du, dv = (yv * ex - xv * ey) * inverse, (xu * ey - yu * ex) * inverse
        size = max(abs(du), abs(dv))
        good = (det * sign > 0.0) & (dz < 0.0) & (abs(du) <= 2.0) & (abs(dv) <= 2.0)  # NaN is not good
        goes = (state[i] == MOVING) & good
        settled = goes & (size <= b[WITHIN + i])
        b[U + i] = b[U + i] + du if goes else b[U + i]
        b[V + i] = b[V + i] + dv if goes else b[V + i]
        b[KEPT + i] = b[LIGHT + i] if goes else b[KEPT + i]
        b[XU + i], b[XV + i] = xu if goes else b[XU + i], xv if goes else b[XV + i]
        b[YU + i], b[YV + i] = yu if goes else b[YU + i], yv if goes else b[YV + i]
        ended = CONVERGED if settled else MOVING
        ended = ended if good else FAILED
        ended = ended if state[i] == MOVING else state[i]
        state[i] = ended
        moving += ended == MOVING
    return moving


@kernel
def solve_block(
    count: int, camera: Array, spheres: Array, sequence: Array, sign: float, b: Array, state: Array
) -> None:
    """Newton for the nodes x, y from the pixels u, v through the spheres of `sequence` (E,), in this order."""
    for i in range(count):
        state[i] = MOVING
    for _ in range(VECTOR_STEPS):
        aim(count, camera, b)
        for e in range(sequence.shape[0]):
            k = sequence[e]
            cross(count, spheres[k, 0], spheres[k, 1], spheres[k, 2], spheres[k, 3], spheres[k, 4], b)
        if step_pixels(count, sign, b, state) == 0:
            break


@kernel
def solve_nodes(
    tables: tuple[Array, ...],
    grid: Array,
    balls: Array,
    sequence: Array,
    trip: int,
    solid: bool,
    key: int,
    number: int,
    sign: float,
    limits: Array,
    starts: Array,
    nodes: Array,
    block: Array,
    state: Array,
    xy: Array,
    spans: Array,
    wanted: Array,
    rays: Array,
    trips: Array,
    maps: tuple[Array, ...],
) -> None:
    """Solve nodes of one sheet from their starts and keep the views.

    ``sequence`` (E,) numbers the spheres of the branch in the sphere table, `trip` is the same in the order of
    ``balls`` (see ``tracer.kernels.chain``), -1 where a scene does not fit lockstep: then what a block has solved
    is verified ray by ray, and where not all spheres of the sequence are `solid` every node is solved by itself.
    `key` is the branch key of ``march``.  ``starts`` (N, 4) and ``nodes`` (N, 2) as from
    `scatter_sheet`; ``maps`` as in `keep_view`.  Scratch: ``block`` (NEWTON_NUMBERS,), ``state`` (GROUP,), ``xy``
    (2, GROUP), those of `follow_block`.
    """
    status, pixel, jacobian, weight, transmittance, branch = maps  # once: taking one from a tuple is not free
    tables, sequence = unowned_tables(tables), unowned(sequence)
    camera, spheres = tables[0], tables[1]
    status, pixel, jacobian, weight = unowned(status), unowned(pixel), unowned(jacobian), unowned(weight)
    transmittance, branch, starts, nodes = unowned(transmittance), unowned(branch), unowned(starts), unowned(nodes)
    block, xy, rays, trips = unowned(block), unowned(xy), unowned(rays), unowned(trips)
    state, balls, spans, wanted = unowned(state), unowned(balls), unowned(spans), unowned(wanted)
    for low in range(0, nodes.shape[0], GROUP):
        count = min(GROUP, nodes.shape[0] - low)
        for i in range(count):
            row, column = nodes[low + i, 0], nodes[low + i, 1]
            block[X + i], block[Y + i] = grid[0] + column * grid[2], grid[1] - row * grid[2]
            block[U + i], block[V + i], block[WITHIN + i] = (
                starts[low + i, 0],
                starts[low + i, 1],
                starts[low + i, 3],
            )
            state[i] = FAILED
        full = whole_vectors(count)
        for i in range(count, full):
            block[X + i], block[Y + i] = block[X], block[Y]
            block[U + i], block[V + i], block[WITHIN + i] = block[U], block[V], block[WITHIN]
        if trip > 0:
            solve_block(full, camera, spheres, sequence, sign, block, state)
            verify(count, camera, balls, xy, spans, wanted, rays, trips, block)
        elif solid:
            solve_block(full, camera, spheres, sequence, sign, block, state)
            verify_one_by_one(count, trip, key, tables, state, trips, block)
        for i in range(count):
            if not (state[i] == CONVERGED and trips[TRIP + i] == trip):
                done, block[U + i], block[V + i], xu, xv, yu, yv, block[KEPT + i] = solve_node(
                    block[X + i], block[Y + i], starts[low + i, 0], starts[low + i, 1], key, sign, tables
                )
                block[XU + i], block[XV + i], block[YU + i], block[YV + i] = xu, xv, yu, yv
                state[i] = CONVERGED if done > 0.0 else FAILED
        judge(count, grid[2], sequence.shape[0], limits, block, state)
        for i in range(count):
            row, column = nodes[low + i, 0] & INDEX, nodes[low + i, 1] & INDEX
            uc, ur, vc, vr = block[XU + i], block[XV + i], block[YU + i], block[YV + i]
            u, v, light, worth = block[U + i], block[V + i], block[KEPT + i], block[WORTH + i]
            keep_view(
                state[i],
                u,
                v,
                uc,
                ur,
                vc,
                vr,
                light,
                worth,
                number,
                row,
                column,
                status,
                pixel,
                jacobian,
                weight,
                transmittance,
                branch,
            )


@kernel
def judge(count: int, pitch: float, events: int, limits: Array, b: Array, state: Array) -> None:
    """Turn d plane / d pixel (XU ...) into d pixel / d node, state into NodeStatus, and weigh the views.

    ``limits`` (4,): smallest and largest magnification, sensor width and height.
    """
    least, most, right, bottom = limits[0], limits[1], limits[2] - 1.0, limits[3] - 1.0
    share = 1.0 / (1.0 + events)
    for i in range(count):
        ux, uy, vx, vy = inverse_inlined(b[XU + i], b[XV + i], b[YU + i], b[YV + i])
        uc, ur, vc, vr = ux * pitch, -uy * pitch, vx * pitch, -vy * pitch
        low, high = stretch_inlined(uc, ur, vc, vr)
        u, v = b[U + i], b[V + i]
        inside = (u >= 0.0) & (u <= right) & (v >= 0.0) & (v <= bottom)
        verdict = FOLD if high > most else RECOVERED
        verdict = LOW_MAGNIFICATION if low < least else verdict
        verdict = verdict if inside else OUT_OF_FRAME
        state[i] = verdict if state[i] == CONVERGED else FOLD
        b[XU + i], b[XV + i], b[YU + i], b[YV + i] = uc, ur, vc, vr
        b[WORTH + i] = b[KEPT + i] * min(1.0, abs(uc * vr - ur * vc)) * share


@kernel
def verify(
    count: int,
    camera: Array,
    balls: Array,
    xy: Array,
    spans: Array,
    wanted: Array,
    rays: Array,
    trips: Array,
    b: Array,
) -> None:
    """Trips that the pixels u, v of a block really take, all bodies asked."""
    scale, u0, v0 = 1.0 / camera[12], camera[13], camera[14]
    k1, k2, k3, p1, p2 = camera[15], camera[16], camera[17], camera[18], camera[19]
    x, y = xy[0], xy[1]
    for i in range(count):
        a, e, _, _ = undistorted((b[U + i] - u0) * scale, (b[V + i] - v0) * scale, k1, k2, k3, p1, p2)
        x[i], y[i] = a, e
    begin_block(x[:count], y[:count], camera, rays, trips)
    follow_block(0, count, SKIP_LEFT_BEHIND, balls, spans, rays, trips, wanted)


@kernel
def verify_one_by_one(
    count: int, trip: int, key: int, tables: tuple[Array, ...], state: Array, trips: Array, b: Array
) -> None:
    """As `verify` for scenes of many bodies: `trip` for converged pixels whose ray has the branch key `key`."""
    for i in range(count):
        taken = ANOTHER
        if state[i] == CONVERGED:
            s, _, _, _, _, _, _, _, k, _ = march_pixel_tangents(b[U + i], b[V + i], *tables)
            taken = trip if s == TRACED and k == key else ANOTHER
        trips[TRIP + i] = taken
