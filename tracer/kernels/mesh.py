"""A ray and a mesh: glass of any convex shape, known by cubic patches over triangles.

A ray goes in once and out once.  Where one of both is not found, at a rim within rounding, it is lost.  What is
totally reflected from inside is lost too: unlike in a ball it may be anywhere on such a body, and what comes out
at last has met several faces.

A flat facet has no curvature and refracts like a prism.  A PN triangle (Vlachos, Peters, Boyd and Mitchell,
"Curved PN triangles", I3D 2001) is the cubic Bezier triangle that stands on the three points of a facet, at
right angles to their three normals.  Its ten control points, P the points and N the normals, w_ij = (P_j - P_i)
. N_i, are

    b300 = P1,      b210 = (2 P1 + P2 - w12 N1) / 3, ...      b111 = E + (E - V) / 2,

E the mean of the six on the edges and V of the three corners.  Neighbours share the two points and normals of
their edge, hence the whole curve: there is no gap.  The normal that refracts is that of the cubic patch itself,
dS/da x dS/db: it is off by the third power of the edges (the quadratic normals that go with such patches in
pictures are off by the first).

A line p + t d meets S(a, b) where the two parts of S - p across d are zero: Newton in a, b from the middle of
the patch, no t needed.  A convex body is entered once, where N . d < 0, and left once, where N . d > 0, so the
side chooses the root and no tolerance does.  Patches lie in the hull of their control points: a tree of boxes
around these finds the few that can be met.  A box that is missed is left by its skip, so that there is no stack.

Numbers of a mesh, one row, as the table of its kind has them:

    n / n around, number of boxes B, centre x, y, z and radius of a ball around it, then HEADER
    B times     box x, y, z low, x, y, z high, first patch, patches in it (0: its children come next), skip
    patches     ten control points, x of all, y of all, z of all:
                b300 b030 b003 b210 b120 b021 b012 b102 b201 b111
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.refraction import on_plane_rates, refracted, refracted_rates
from tracer.kernels.sphere import foot, transmittance
from tracer.kernels.world import BLOCKED, RECOVERED, TIR

INDEX, BOXES, CENTRE, BALL, HEADER = 0, 1, 2, 5, 6
FIRST, COUNT, SKIP, BOX_NUMBERS = 6, 7, 8, 9
POINTS, PATCH_NUMBERS = 10, 30
STEPS, CONVERGED, EDGE = 12, 1e-13, 1e-9  # Newton; of the size of the mesh; of a patch, rounding at shared edges
ENTERS, LEAVES = -1.0, 1.0


@kernel_inlined
def cubic(row: Array, at: int, a: float, b: float) -> tuple[float, float, float, float, float, float]:
    """One coordinate of a patch: S, dS/da, dS/db, and the second derivatives aa, ab, bb; de Casteljau."""
    c = 1.0 - a - b
    p300, p030, p003, p210, p120 = row[at], row[at + 1], row[at + 2], row[at + 3], row[at + 4]
    p021, p012, p102, p201, p111 = row[at + 5], row[at + 6], row[at + 7], row[at + 8], row[at + 9]
    q200, q020 = a * p300 + b * p210 + c * p201, a * p120 + b * p030 + c * p021
    q002, q110 = a * p102 + b * p012 + c * p003, a * p210 + b * p120 + c * p111
    q011, q101 = a * p111 + b * p021 + c * p012, a * p201 + b * p111 + c * p102
    r1, r2 = a * q200 + b * q110 + c * q101, a * q110 + b * q020 + c * q011
    r3 = a * q101 + b * q011 + c * q002
    return (
        a * r1 + b * r2 + c * r3, 3.0 * (r1 - r3), 3.0 * (r2 - r3),
        6.0 * (q200 - 2.0 * q101 + q002), 6.0 * (q110 - q101 - q011 + q002), 6.0 * (q020 - 2.0 * q011 + q002),
    )  # fmt: skip


@kernel_inlined
def in_box(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array, at: int
) -> bool:  # fmt: skip
    """Whether a line passes through a box; boxes are a little larger than what is in them."""
    low, high = -math.inf, math.inf
    for axis in range(3):
        p = px if axis == 0 else py if axis == 1 else pz
        d = dx if axis == 0 else dy if axis == 1 else dz
        one, two = row[at + axis] - p, row[at + 3 + axis] - p
        if d == 0.0:
            if one > 0.0 or two < 0.0:
                return False
        else:
            one, two = one / d, two / d
            low, high = max(low, min(one, two)), min(high, max(one, two))
    return low <= high


@kernel
def on_patch(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array, at: int, side: float
) -> tuple[float, float, float]:
    """Distance along the line, and a and b, of where it meets a patch on one side; inf if it does not."""
    # two directions across d: the first at right angles to its smallest part
    if abs(dx) <= abs(dy) and abs(dx) <= abs(dz):
        ex, ey, ez = 0.0, dz, -dy
    elif abs(dy) <= abs(dz):
        ex, ey, ez = -dz, 0.0, dx
    else:
        ex, ey, ez = dy, -dx, 0.0
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    ex, ey, ez = ex / length, ey / length, ez / length
    fx, fy, fz = dy * ez - dz * ey, dz * ex - dx * ez, dx * ey - dy * ex
    near = CONVERGED * row[BALL]
    a = b = 1.0 / 3.0
    for _ in range(STEPS):
        x, xa, xb, _, _, _ = cubic(row, at, a, b)
        y, ya, yb, _, _, _ = cubic(row, at + POINTS, a, b)
        z, za, zb, _, _, _ = cubic(row, at + 2 * POINTS, a, b)
        x, y, z = x - px, y - py, z - pz
        off1, off2 = x * ex + y * ey + z * ez, x * fx + y * fy + z * fz
        a1, b1 = xa * ex + ya * ey + za * ez, xb * ex + yb * ey + zb * ez
        a2, b2 = xa * fx + ya * fy + za * fz, xb * fx + yb * fy + zb * fz
        slope = a1 * b2 - a2 * b1
        if slope == 0.0:
            break
        step_a, step_b = (off1 * b2 - off2 * b1) / slope, (a1 * off2 - a2 * off1) / slope
        a, b = a - step_a, b - step_b
        if abs(a) > 3.0 or abs(b) > 3.0:  # on its way to another patch
            break
        if abs(off1) < near and abs(off2) < near:
            inside = a > -EDGE and b > -EDGE and a + b < 1.0 + EDGE
            facing = dx * (ya * zb - za * yb) + dy * (za * xb - xa * zb) + dz * (xa * yb - ya * xb)
            if inside and facing * side > 0.0:
                return x * dx + y * dy + z * dz, a, b
            break
    return math.inf, a, b


@kernel
def where_met(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array, side: float
) -> tuple[float, int, float, float]:
    """Distance, patch (its place in the row), a and b where a line enters or leaves a mesh; inf if nowhere."""
    distance, place, best_a, best_b = math.inf, -1, 0.0, 0.0
    boxes = int(row[BOXES])
    patches = HEADER + boxes * BOX_NUMBERS
    box = 0
    while box < boxes:
        at = HEADER + box * BOX_NUMBERS
        if not in_box(px, py, pz, dx, dy, dz, row, at):
            box = int(row[at + SKIP])
            continue
        for k in range(int(row[at + COUNT])):
            patch = patches + (int(row[at + FIRST]) + k) * PATCH_NUMBERS
            t, a, b = on_patch(px, py, pz, dx, dy, dz, row, patch, side)
            if t < distance:
                distance, place, best_a, best_b = t, patch, a, b
        box += 1
    return distance, place, best_a, best_b


@kernel
def normal_at(row: Array, at: int, a: float, b: float) -> tuple[float, float, float]:
    """Outward unit normal of a patch."""
    _, xa, xb, _, _, _ = cubic(row, at, a, b)
    _, ya, yb, _, _, _ = cubic(row, at + POINTS, a, b)
    _, za, zb, _, _, _ = cubic(row, at + 2 * POINTS, a, b)
    nx, ny, nz = ya * zb - za * yb, za * xb - xa * zb, xa * yb - ya * xb
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length


@kernel
def normal_rates(
    row: Array, at: int, a: float, b: float, gx: float, gy: float, gz: float
) -> tuple[float, float, float, float, float, float]:
    """Outward unit normal of a patch, and its derivative when the point changes by g, along the patch."""
    _, xa, xb, xaa, xab, xbb = cubic(row, at, a, b)
    _, ya, yb, yaa, yab, ybb = cubic(row, at + POINTS, a, b)
    _, za, zb, zaa, zab, zbb = cubic(row, at + 2 * POINTS, a, b)
    nx, ny, nz = ya * zb - za * yb, za * xb - xa * zb, xa * yb - ya * xb
    square = nx * nx + ny * ny + nz * nz
    # g = a' S_a + b' S_b
    rate_a = ((gy * zb - gz * yb) * nx + (gz * xb - gx * zb) * ny + (gx * yb - gy * xb) * nz) / square
    rate_b = ((ya * gz - za * gy) * nx + (za * gx - xa * gz) * ny + (xa * gy - ya * gx) * nz) / square
    ax, ay, az = xaa * rate_a + xab * rate_b, yaa * rate_a + yab * rate_b, zaa * rate_a + zab * rate_b
    bx, by, bz = xab * rate_a + xbb * rate_b, yab * rate_a + ybb * rate_b, zab * rate_a + zbb * rate_b
    rx = ay * zb - az * yb + ya * bz - za * by
    ry = az * xb - ax * zb + za * bx - xa * bz
    rz = ax * yb - ay * xb + xa * by - ya * bx
    length = math.sqrt(square)
    nx, ny, nz = nx / length, ny / length, nz / length
    along = rx * nx + ry * ny + rz * nz
    return nx, ny, nz, (rx - along * nx) / length, (ry - along * ny) / length, (rz - along * nz) / length


@kernel
def meets_mesh(px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array) -> float:
    """Distance to where the ray goes in; inf if it does not."""
    m, ax, ay, az = foot(px - row[CENTRE], py - row[CENTRE + 1], pz - row[CENTRE + 2], dx, dy, dz)
    if not ax * ax + ay * ay + az * az < row[BALL] * row[BALL] or m < -row[BALL]:
        return math.inf
    t = where_met(px, py, pz, dx, dy, dz, row, ENTERS)[0]
    return t if t > 0.0 else math.inf


@kernel
def cross_mesh(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """Through both faces, as `Kind.cross`."""
    n = row[INDEX]
    t, patch, a, b = where_met(px, py, pz, dx, dy, dz, row, ENTERS)
    qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
    nx, ny, nz = normal_at(row, patch, a, b)
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, 1.0 / n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, t, 0.0
    light = transmittance(c1, c2, n)
    s, patch, a, b = where_met(qx, qy, qz, ex, ey, ez, row, LEAVES)
    if patch < 0:
        return BLOCKED, qx, qy, qz, ex, ey, ez, t, 0.0
    qx, qy, qz = qx + s * ex, qy + s * ey, qz + s * ez
    nx, ny, nz = normal_at(row, patch, a, b)
    ex, ey, ez, c1, c2 = refracted(ex, ey, ez, -nx, -ny, -nz, n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, t + n * s, 0.0
    return RECOVERED, qx, qy, qz, ex, ey, ez, t + n * s, light * transmittance(c1, c2, 1.0 / n)


@kernel
def mesh_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float, row: Array, rate: Array, way: int,
) -> tuple[float, ...]:  # fmt: skip
    """Derivatives of point and direction behind, as `Kind.rates`; of the row only n may change."""
    n, n_rate = row[INDEX], rate[INDEX]
    t, patch, a, b = where_met(px, py, pz, dx, dy, dz, row, ENTERS)
    qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
    nx, ny, nz = normal_at(row, patch, a, b)
    fx, fy, fz = on_plane_rates(dx, dy, dz, t, nx, ny, nz, fx, fy, fz, ux, uy, uz, 0.0)
    nx, ny, nz, rx, ry, rz = normal_rates(row, patch, a, b, fx, fy, fz)
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, 1.0 / n)
    ux, uy, uz = refracted_rates(
        dx, dy, dz, nx, ny, nz, 1.0 / n, c1, c2, ux, uy, uz, rx, ry, rz, -n_rate / (n * n)
    )
    s, patch, a, b = where_met(qx, qy, qz, ex, ey, ez, row, LEAVES)
    nx, ny, nz = normal_at(row, patch, a, b)
    fx, fy, fz = on_plane_rates(ex, ey, ez, s, nx, ny, nz, fx, fy, fz, ux, uy, uz, 0.0)
    nx, ny, nz, rx, ry, rz = normal_rates(row, patch, a, b, fx, fy, fz)
    _, _, _, c1, c2 = refracted(ex, ey, ez, -nx, -ny, -nz, n)
    ux, uy, uz = refracted_rates(ex, ey, ez, -nx, -ny, -nz, n, c1, c2, ux, uy, uz, -rx, -ry, -rz, n_rate)
    return fx, fy, fz, ux, uy, uz
