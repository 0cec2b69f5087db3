"""Newton on traced rays, from a node of the plane to the pixel that shows it: one by one, or in blocks.

Any node is solved by itself (`solve_node`).  A block of nodes is solved at once along ONE known sequence of
spheres: on a sheet every ray takes the same sequence, so nothing has to be looked for while iterating: the block
goes through the turns of the sequence, derivatives and all, in loops without a branch.  What leaves the sheet (no
hit: NaN; wrong sign of the determinant; a long step; no convergence) is gathered and solved again, damped: no
step is longer than LONGEST_PX, and a step that leaves the sheet is halved.  A node whose very start is off the
sheet has nowhere to go back to.  What converged still has to be verified (``views``): a node that is found only
behind another body, which the sequence knows nothing of, is not seen there.

A node has converged when a step is so small that derivatives and transmittance, which are those of the place
before it, are right behind it to what float32 holds; how small that is comes with its start.  The step is still
taken and leaves about its square.  The node then stays frozen while its neighbours go on, so that its bits do not
depend on them.

Windows in front of everything come first, in the closed form of ``tracer.kernels.windowed``: for unit vectors D,
with w^2 = n^2 - 1 + m^2 and w'^2 likewise, D' = (D + (m - w') N)/n' through P' = P + (w' h/m + w' T/w - h - T) N.

Columns of the block, STEP apart in one array (see ``tracer.kernels.chain``): pixel u, v; node x, y; position and
direction; their derivatives by u (F, U) and by v (G, V); transmittance; Jacobian d plane / d pixel.  They are
indexed in the loops that use them: read through another function, such a loop takes twice as long.

The same turns give the derivatives of a pixel that has no neighbour of its branch (`slopes_along`), where
differences need one.  Behind a bed of a thousand balls one pixel in ten has none, and to look for the
balls that its ray meets takes several times as long as to go through those that are known.

The grid arrives as (x0, y0, pitch): node (row, column) is (x0 + column pitch, y0 - row pitch).  Jacobians
are d pixel / d node, four numbers: du/dcolumn, du/drow, dv/dcolumn, dv/drow.
"""

import math
from typing import NamedTuple

import numpy as np

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.camera import CENTRE_U, CENTRE_V, FOCAL, axes_of, eye_of, lens_of, undistort, unit_tangent
from tracer.kernels.rays import ORIGIN, trace_pixel_tangents
from tracer.kernels.sphere import (
    RADIUS,
    REFRACTIVE_INDEX,
    Turn,
    foot,
    foot_tangent,
    rotate,
    rotate_tangent,
    transmittance,
)
from tracer.kernels.vectors import Vector, add, dot, move, scale, subtract, vector_at
from tracer.kernels.window import BEHIND, GLASS, THICKNESS
from tracer.kernels.world import RECOVERED as TRACED
from tracer.kernels.world import Tables

MAX_STEPS = 25
TOLERANCE_PX = 1e-6  # last Newton step; it is still applied, which leaves about its square
GROUP = 64  # nodes of a block: 27 columns of them fit the first-level cache
STEP = GROUP + 8
U, V, X, Y, PX, PY, PZ, DX, DY, DZ = (k * STEP for k in range(10))
FX, FY, FZ, UX, UY, UZ, GX, GY, GZ, VX, VY, VZ = (k * STEP for k in range(10, 22))
LIGHT, KEPT, XU, XV, YU, YV, WORTH, WITHIN, BACK_U, BACK_V = (k * STEP for k in range(22, 32))
NEWTON_NUMBERS = 32 * STEP
VECTOR_STEPS = 8  # from a start within a pixel one or two do; more are for damped steps
LONGEST_PX = 2.0  # of a step
MOVING, CONVERGED, FAILED, OFF_BRANCH = 0, 1, 2, 3
foot_inlined = kernel_inlined(foot.py_func)  # type: ignore[attr-defined]
rotate_inlined = kernel_inlined(rotate.py_func)  # type: ignore[attr-defined]
foot_tangent_inlined = kernel_inlined(foot_tangent.py_func)  # type: ignore[attr-defined]
rotate_tangent_inlined = kernel_inlined(rotate_tangent.py_func)  # type: ignore[attr-defined]
transmittance_inlined = kernel_inlined(transmittance.py_func)  # type: ignore[attr-defined]
unit_tangent_inlined = kernel_inlined(unit_tangent.py_func)  # type: ignore[attr-defined]


@kernel
def inverse_2x2(xu: float, xv: float, yu: float, yv: float) -> tuple[float, ...]:
    """Inverse of [[xu, xv], [yu, yv]] and its determinant's reciprocal; not finite where singular."""
    r = 1.0 / (xu * yv - xv * yu)
    return yv * r, -xv * r, -yu * r, xu * r


@kernel
def stretch(uc: float, ur: float, vc: float, vr: float) -> tuple[float, ...]:
    """Smallest and largest singular value of [[uc, ur], [vc, vr]]."""
    e, f = 0.5 * (uc + vr), 0.5 * (uc - vr)
    g, h = 0.5 * (vc + ur), 0.5 * (vc - ur)
    p, q = math.sqrt(e * e + h * h), math.sqrt(f * f + g * g)
    return abs(p - q), p + q


@kernel
def solve_node(x: float, y: float, u: float, v: float, key: int, sign: float, tables: Tables) -> tuple[float, ...]:
    """Careful Newton for one node: converged, u, v, Jacobian d plane / d pixel, transmittance.

    It steps back where it has left the sheet, a connected part of one branch with one sign of the determinant.
    """
    du = dv = 0.0
    for _ in range(MAX_STEPS):
        s, a, b, au, av, bu, bv, passed, k, _ = trace_pixel_tangents(u, v, *tables)
        if s != TRACED or k != key or not (au * bv - av * bu) * sign > 0.0:
            du, dv = 0.5 * du, 0.5 * dv  # stepped off the sheet: go half the way back
            if abs(du) + abs(dv) < TOLERANCE_PX:
                break
            u, v = u - du, v - dv
            continue
        ux, uy, vx, vy = inverse_2x2(au, av, bu, bv)
        du, dv = ux * (x - a) + uy * (y - b), vx * (x - a) + vy * (y - b)
        size = max(abs(du), abs(dv))
        if size > 2.0:
            du, dv = 2.0 * du / size, 2.0 * dv / size
        u, v = u + du, v + dv
        if size <= TOLERANCE_PX:
            return 1.0, u, v, au, av, bu, bv, passed
    return 0.0, u, v, 0.0, 0.0, 0.0, 0.0, 0.0


@kernel
def aim(count: int, camera: Array, b: Array) -> None:
    """Rays of the pixels u, v with their derivatives."""
    eye = eye_of(camera)
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    scale, u0, v0 = 1.0 / camera[FOCAL], camera[CENTRE_U], camera[CENTRE_V]
    k1, k2, k3, p1, p2 = lens_of(camera)
    for i in range(count):
        x, y = (b[U + i] - u0) * scale, (b[V + i] - v0) * scale
        a, e, radial, slope = undistort(x, y, k1, k2, k3, p1, p2)
        xx = (radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x) * scale
        xy = (2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y) * scale
        yy = (radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x) * scale
        unit = 1.0 / math.sqrt(a * a + e * e + 1.0)
        d = (c3 * a + c6 * e + c9) * unit, (c4 * a + c7 * e + c10) * unit, (c5 * a + c8 * e + c11) * unit
        by_u = c3 * xx + c6 * xy, c4 * xx + c7 * xy, c5 * xx + c8 * xy
        by_v = c3 * xy + c6 * yy, c4 * xy + c7 * yy, c5 * xy + c8 * yy
        b[PX + i], b[PY + i], b[PZ + i] = eye
        b[DX + i], b[DY + i], b[DZ + i] = d
        b[UX + i], b[UY + i], b[UZ + i] = unit_tangent_inlined(d, unit, by_u)
        b[VX + i], b[VY + i], b[VZ + i] = unit_tangent_inlined(d, unit, by_v)
        b[FX + i], b[FY + i], b[FZ + i] = ORIGIN
        b[GX + i], b[GY + i], b[GZ + i] = ORIGIN
        b[LIGHT + i] = 1.0


@kernel
def enter_window(count: int, row: Array, b: Array) -> None:
    """All rays through one window, to where they seem to come from behind it; NaN where one is reflected."""
    start, normal, thickness, n, behind = (
        vector_at(row, 0),
        vector_at(row, 3),
        row[THICKNESS],
        row[GLASS],
        row[BEHIND],
    )
    gain, gain_behind, inverse = (n - 1.0) * (n + 1.0), (behind - 1.0) * (behind + 1.0), 1.0 / behind
    for i in range(count):
        p, d, f, g = (
            (b[PX + i], b[PY + i], b[PZ + i]),
            (b[DX + i], b[DY + i], b[DZ + i]),
            (b[FX + i], b[FY + i], b[FZ + i]),
            (b[GX + i], b[GY + i], b[GZ + i]),
        )
        u, v = (b[UX + i], b[UY + i], b[UZ + i]), (b[VX + i], b[VY + i], b[VZ + i])
        m, h = -dot(d, normal), dot(subtract(p, start), normal)
        w, w2 = math.sqrt(gain + m * m), math.sqrt(gain_behind + m * m)
        far = h / m + thickness / w
        moved, turned = w2 * far - h - thickness, m - w2
        b[LIGHT + i] *= transmittance_inlined(m, w / n, n) * transmittance_inlined(w / n, w2 * inverse, behind / n)
        mu, mv, hu, hv = -dot(u, normal), -dot(v, normal), dot(f, normal), dot(g, normal)
        by_m = m / w2 * far - w2 * (h / (m * m) + thickness * m / (w * w * w))
        by_h, by_turn = w2 / m - 1.0, 1.0 - m / w2
        b[PX + i], b[PY + i], b[PZ + i] = move(p, moved, normal)
        b[FX + i], b[FY + i], b[FZ + i] = move(f, by_m * mu + by_h * hu, normal)
        b[GX + i], b[GY + i], b[GZ + i] = move(g, by_m * mv + by_h * hv, normal)
        b[DX + i], b[DY + i], b[DZ + i] = scale(inverse, move(d, turned, normal))
        b[UX + i], b[UY + i], b[UZ + i] = scale(inverse, move(u, by_turn * mu, normal))
        b[VX + i], b[VY + i], b[VZ + i] = scale(inverse, move(v, by_turn * mv, normal))


@kernel_inlined
def turn_of(b2: float, glass: tuple[float, ...]) -> tuple[Turn, Turn, float]:
    """Turn (``tracer.kernels.sphere``), its derivatives by b^2, and the transmittance of one surface.

    `glass`: R^2, 1/R^2, 1/R, n, 1/n, (n^2 - 1)/n^2 and 1/(n R)^2 of the sphere.

    One division serves for all: the reciprocals of cos i, cos t, cos t + cos i/n and n cos i + cos t are products
    of three of them times the reciprocal of all four.
    """
    r2, ir2, ir, n, nu, gk, kt = glass
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
    return (cosine, q), (cosine_rate, q_rate), passed


@kernel_inlined
def carry_tangent(
    ray: tuple[Vector, Vector, float, Vector, float], turn: Turn, by_b2: Turn, f: Vector, u: Vector
) -> tuple[Vector, Vector]:
    """Derivatives of foot point and direction behind a turn; `ray` is w, d, m, a and b^2 before it."""
    w, d, m, a, b2 = ray
    f = foot_tangent_inlined(w, d, m, f, u)
    b2_rate = 2.0 * dot(a, f)
    f, u = rotate_tangent_inlined(a, d, b2, turn, f, u, b2_rate, (by_b2[0] * b2_rate, by_b2[1] * b2_rate))
    return f, u


@kernel
def cross_sphere(count: int, sphere: Array, b: Array) -> None:
    """All rays through one sphere; NaN where a ray misses it or meets it behind."""
    centre, radius, n = vector_at(sphere, 0), sphere[RADIUS], sphere[REFRACTIVE_INDEX]
    r2, nu = radius * radius, 1.0 / n
    ir2, ir, kt, gk = 1.0 / r2, 1.0 / radius, 1.0 / (n * n * r2), (n - 1.0) * (n + 1.0) / (n * n)
    for i in range(count):
        d, w = (b[DX + i], b[DY + i], b[DZ + i]), subtract((b[PX + i], b[PY + i], b[PZ + i]), centre)
        m, a = foot_inlined(w, d)
        b2 = dot(a, a)
        m = m if (m > 0.0) & (b2 < r2) & (b2 * kt < 1.0) else math.nan
        turn, by_b2, surface = turn_of(b2, (r2, ir2, ir, n, nu, gk, kt))
        b[LIGHT + i] = b[LIGHT + i] * surface * surface
        ray = w, d, m, a, b2
        f, u = carry_tangent(
            ray, turn, by_b2, (b[FX + i], b[FY + i], b[FZ + i]), (b[UX + i], b[UY + i], b[UZ + i])
        )
        g, v = carry_tangent(
            ray, turn, by_b2, (b[GX + i], b[GY + i], b[GZ + i]), (b[VX + i], b[VY + i], b[VZ + i])
        )
        a, d = rotate_inlined(a, d, b2, turn)
        b[PX + i], b[PY + i], b[PZ + i] = add(centre, a)
        b[DX + i], b[DY + i], b[DZ + i] = d
        b[FX + i], b[FY + i], b[FZ + i] = f
        b[UX + i], b[UY + i], b[UZ + i] = u
        b[GX + i], b[GY + i], b[GZ + i] = g
        b[VX + i], b[VY + i], b[VZ + i] = v


class SheetPath(NamedTuple):
    """Path of the rays of one sheet.

    Parameters
    ----------
    events, balls : (E,) int64 each
        Its spheres in the order of the sphere table, and of a bundle's table where it is verified in bundles.
    key, trip : int
        Branch key, and trip in the chain of lockstep; -1 where a scene does not fit that.
    number, sign : int, float
        Branch number, and sign of the determinant.
    solid : bool
        Whether a block can follow it: spheres alone, behind `windows` alone.
    """

    events: Array
    balls: Array
    key: int
    trip: int
    number: int
    sign: float
    solid: bool


@kernel
def step_pixels(count: int, damped: bool, first: bool, sign: float, b: Array, state: Array) -> int:
    """Move u, v by one Newton step towards the nodes; state (LANES,) int64; how many still move.

    A node that has left the sheet, or whose step is too long, has FAILED, OFF_BRANCH if that is its `first` step;
    `damped`: no step is too long, and one that leaves the sheet is halved.
    """
    moving, lost = 0, OFF_BRANCH if first else FAILED
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
        shorter = LONGEST_PX / max(size, LONGEST_PX)  # 1 unless the step is too long
        back_u, back_v = -0.5 * b[BACK_U + i], -0.5 * b[BACK_V + i]
        on_sheet = (det * sign > 0.0) & (dz < 0.0)  # NaN is not
        good = on_sheet & (damped | ((abs(du) <= LONGEST_PX) & (abs(dv) <= LONGEST_PX)))
        is_moving = state[i] == MOVING
        goes, kept = is_moving & (good | damped), is_moving & good
        du, dv = shorter * du if on_sheet else back_u, shorter * dv if on_sheet else back_v
        b[U + i], b[V + i] = b[U + i] + du if goes else b[U + i], b[V + i] + dv if goes else b[V + i]
        b[BACK_U + i], b[BACK_V + i] = du if on_sheet else -back_u, dv if on_sheet else -back_v
        b[KEPT + i] = b[LIGHT + i] if kept else b[KEPT + i]
        b[XU + i], b[XV + i] = xu if kept else b[XU + i], xv if kept else b[XV + i]
        b[YU + i], b[YV + i] = yu if kept else b[YU + i], yv if kept else b[YV + i]
        within = TOLERANCE_PX if damped else b[WITHIN + i]
        ended = CONVERGED if kept & (size <= within) else MOVING
        ended = ended if good | (damped & (abs(back_u) + abs(back_v) >= TOLERANCE_PX)) else FAILED
        ended = ended if on_sheet | damped else lost
        ended = ended if is_moving else state[i]
        state[i] = ended
        moving += ended == MOVING
    return moving


@kernel
def follow_sequence(count: int, camera: Array, windows: Array, spheres: Array, sequence: Array, b: Array) -> None:
    """All rays with their derivatives through windows (K, 10), then the spheres of `sequence`."""
    aim(count, camera, b)
    for k in range(windows.shape[0]):
        enter_window(count, windows[k], b)
    for e in range(sequence.shape[0]):
        cross_sphere(count, spheres[sequence[e]], b)


@kernel
def solve_block(
    count: int, damped: bool, tables: Tables, windows: Array, path: SheetPath, b: Array, state: Array
) -> None:
    """Newton for the nodes x, y from the pixels u, v through windows (K, 10), then the spheres of a path."""
    for i in range(count):
        state[i] = MOVING
        b[BACK_U + i] = b[BACK_V + i] = 0.0
    for step in range(MAX_STEPS if damped else VECTOR_STEPS):
        follow_sequence(count, tables[0], windows, tables[1].spheres, path.events, b)
        if step_pixels(count, damped, step == 0 and not damped, path.sign, b, state) == 0:
            break


class BranchSequences(NamedTuple):
    """Spheres of every branch, in order: of branch k events[begin[k] : begin[k + 1]]; empty: not asked by them.

    Parameters
    ----------
    begin, events : (B + 1,) int64, (E,) int64
        As above.
    windows : (K, 10) float64
        In front of all spheres.
    """

    begin: Array
    events: Array
    windows: Array


NO_SEQUENCES = BranchSequences(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 10)))


@kernel
def slopes_along(
    u: float, v: float, branch: int, sequences: BranchSequences, camera: Array, spheres: Array, block: Array
) -> tuple[float, float, float, float]:
    """dx/du, dx/dv, dy/du, dy/dv of the plane at pixel u, v; ``block`` (NEWTON_NUMBERS,) is scratch."""
    block[U], block[V] = u, v
    sequence = sequences.events[sequences.begin[branch] : sequences.begin[branch + 1]]
    follow_sequence(1, camera, sequences.windows, spheres, sequence, block)
    inverse = -1.0 / block[DZ]
    t = block[PZ] * inverse
    tu, tv = (block[FZ] + t * block[UZ]) * inverse, (block[GZ] + t * block[VZ]) * inverse
    xu, xv = block[FX] + tu * block[DX] + t * block[UX], block[GX] + tv * block[DX] + t * block[VX]
    yu, yv = block[FY] + tu * block[DY] + t * block[UY], block[GY] + tv * block[DY] + t * block[VY]
    return xu, xv, yu, yv
