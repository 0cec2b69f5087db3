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
from tracer.kernels.refraction import plane_point_rates, refract, refract_rates
from tracer.kernels.sphere import foot, transmittance
from tracer.kernels.vectors import (
    Vector,
    add,
    combine,
    cross_product,
    divide,
    dot,
    move,
    scale,
    subtract,
    vector_at,
)
from tracer.kernels.world import BLOCKED, RECOVERED, TIR, Crossed

REFRACTIVE_INDEX, BOXES, CENTRE, BALL, HEADER = 0, 1, 2, 5, 6
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
def patch_derivatives(row: Array, at: int, a: float, b: float) -> tuple[Vector, ...]:
    """Vectors of a patch: S, dS/da, dS/db, and the second derivatives aa, ab, bb."""
    x, xa, xb, xaa, xab, xbb = cubic(row, at, a, b)
    y, ya, yb, yaa, yab, ybb = cubic(row, at + POINTS, a, b)
    z, za, zb, zaa, zab, zbb = cubic(row, at + 2 * POINTS, a, b)
    return (x, y, z), (xa, ya, za), (xb, yb, zb), (xaa, yaa, zaa), (xab, yab, zab), (xbb, ybb, zbb)


@kernel_inlined
def meets_box(p: Vector, d: Vector, row: Array, at: int) -> bool:
    """Return whether a line passes through a box; boxes are a little larger than what is in them."""
    low, high = -math.inf, math.inf
    for axis in range(3):
        one, two = row[at + axis] - p[axis], row[at + 3 + axis] - p[axis]
        if d[axis] == 0.0:
            if one > 0.0 or two < 0.0:
                return False
        else:
            one, two = one / d[axis], two / d[axis]
            low, high = max(low, min(one, two)), min(high, max(one, two))
    return low <= high


@kernel
def intersect_patch(p: Vector, d: Vector, row: Array, at: int, side: float) -> tuple[float, float, float]:
    """Distance along the line, and a and b, of where it meets a patch on one side; inf if it does not."""
    # two directions across d: the first at right angles to its smallest part
    if abs(d[0]) <= abs(d[1]) and abs(d[0]) <= abs(d[2]):
        e = (0.0, d[2], -d[1])
    elif abs(d[1]) <= abs(d[2]):
        e = (-d[2], 0.0, d[0])
    else:
        e = (d[1], -d[0], 0.0)
    e = divide(e, math.sqrt(dot(e, e)))
    f = cross_product(d, e)
    near = CONVERGED * row[BALL]
    a = b = 1.0 / 3.0
    for _ in range(STEPS):
        s, s_a, s_b, _, _, _ = patch_derivatives(row, at, a, b)
        s = subtract(s, p)
        off1, off2 = dot(s, e), dot(s, f)
        a1, b1, a2, b2 = dot(s_a, e), dot(s_b, e), dot(s_a, f), dot(s_b, f)
        slope = a1 * b2 - a2 * b1
        if slope == 0.0:
            break
        step_a, step_b = (off1 * b2 - off2 * b1) / slope, (a1 * off2 - a2 * off1) / slope
        a, b = a - step_a, b - step_b
        if abs(a) > 3.0 or abs(b) > 3.0:  # on its way to another patch
            break
        if abs(off1) < near and abs(off2) < near:
            inside = a > -EDGE and b > -EDGE and a + b < 1.0 + EDGE
            if inside and dot(d, cross_product(s_a, s_b)) * side > 0.0:
                return dot(s, d), a, b
            break
    return math.inf, a, b


@kernel
def intersect_mesh(p: Vector, d: Vector, row: Array, side: float) -> tuple[float, int, float, float]:
    """Distance, patch (its place in the row), a and b where a line enters or leaves a mesh; inf if nowhere."""
    distance, place, best_a, best_b = math.inf, -1, 0.0, 0.0
    boxes = int(row[BOXES])
    patches = HEADER + boxes * BOX_NUMBERS
    box = 0
    while box < boxes:
        at = HEADER + box * BOX_NUMBERS
        if not meets_box(p, d, row, at):
            box = int(row[at + SKIP])
            continue
        for k in range(int(row[at + COUNT])):
            patch = patches + (int(row[at + FIRST]) + k) * PATCH_NUMBERS
            t, a, b = intersect_patch(p, d, row, patch, side)
            if t < distance:
                distance, place, best_a, best_b = t, patch, a, b
        box += 1
    return distance, place, best_a, best_b


@kernel
def normal_at(row: Array, at: int, a: float, b: float) -> Vector:
    """Outward unit normal of a patch."""
    _, s_a, s_b, _, _, _ = patch_derivatives(row, at, a, b)
    n = cross_product(s_a, s_b)
    return divide(n, math.sqrt(dot(n, n)))


@kernel
def normal_rates(row: Array, at: int, a: float, b: float, g: Vector) -> tuple[Vector, Vector]:
    """Outward unit normal of a patch, and its derivative when the point changes by g, along the patch."""
    _, s_a, s_b, s_aa, s_ab, s_bb = patch_derivatives(row, at, a, b)
    n = cross_product(s_a, s_b)
    square = dot(n, n)
    # g = a' S_a + b' S_b
    rate_a, rate_b = dot(cross_product(g, s_b), n) / square, dot(cross_product(s_a, g), n) / square
    by_a, by_b = combine(rate_a, s_aa, rate_b, s_ab), combine(rate_a, s_ab, rate_b, s_bb)
    r = add(cross_product(by_a, s_b), cross_product(s_a, by_b))
    length = math.sqrt(square)
    n = divide(n, length)
    return n, divide(move(r, -dot(r, n), n), length)


@kernel
def meets_mesh(p: Vector, d: Vector, row: Array) -> float:
    """Distance to where the ray goes in; inf if it does not."""
    m, a = foot(subtract(p, vector_at(row, CENTRE)), d)
    if not dot(a, a) < row[BALL] * row[BALL] or m < -row[BALL]:
        return math.inf
    t = intersect_mesh(p, d, row, ENTERS)[0]
    return t if t > 0.0 else math.inf


@kernel
def cross_mesh(p: Vector, d: Vector, row: Array) -> Crossed:
    """Take a ray through both faces, as `Kind.cross`."""
    n = row[REFRACTIVE_INDEX]
    t, patch, a, b = intersect_mesh(p, d, row, ENTERS)
    q = move(p, t, d)
    e, c1, c2 = refract(d, normal_at(row, patch, a, b), 1.0 / n)
    if c2 == 0.0:
        return TIR, q, e, t, 0.0
    light = transmittance(c1, c2, n)
    s, patch, a, b = intersect_mesh(q, e, row, LEAVES)
    if patch < 0:
        return BLOCKED, q, e, t, 0.0
    q = move(q, s, e)
    e, c1, c2 = refract(e, scale(-1.0, normal_at(row, patch, a, b)), n)
    if c2 == 0.0:
        return TIR, q, e, t + n * s, 0.0
    return RECOVERED, q, e, t + n * s, light * transmittance(c1, c2, 1.0 / n)


@kernel
def mesh_rates(
    p: Vector, d: Vector, f: Vector, u: Vector, row: Array, rate: Array, way: int
) -> tuple[Vector, Vector]:
    """Derivatives of point and direction behind, as `Kind.rates`; of the row only n may change."""
    n, n_rate = row[REFRACTIVE_INDEX], rate[REFRACTIVE_INDEX]
    t, patch, a, b = intersect_mesh(p, d, row, ENTERS)
    f = plane_point_rates(d, t, normal_at(row, patch, a, b), f, u, 0.0)
    normal, r = normal_rates(row, patch, a, b, f)
    e, c1, c2 = refract(d, normal, 1.0 / n)
    u = refract_rates(d, normal, 1.0 / n, c1, c2, u, r, -n_rate / (n * n))
    s, patch, a, b = intersect_mesh(move(p, t, d), e, row, LEAVES)
    f = plane_point_rates(e, s, normal_at(row, patch, a, b), f, u, 0.0)
    normal, r = normal_rates(row, patch, a, b, f)
    normal, r = scale(-1.0, normal), scale(-1.0, r)
    _, c1, c2 = refract(e, normal, n)
    return f, refract_rates(e, normal, n, c1, c2, u, r, n_rate)
