"""A ray and a block: a convex body of glass with flat faces, hollow or not.

Row (39,): centre [mm], n of the glass and of what fills it, both / n of what is around, thickness of the wall [mm]
(0: solid), width of the edges [mm], then FACES half-spaces: unit normal outwards and distance h from the centre.
A point x is inside where normal . (x - centre) < h for all faces; one that is not used has normal 0 and h 1.  The
inside of a hollow block has the same faces, a wall further in.

The faces that look against a ray are entered and the others left, so the latest entry and the earliest exit bound
the chord; a ray that stands on a face after a turn never meets that face again by its sign alone, and no
tolerance is needed.  In the glass a ray is followed from face to face, totally reflected where Snell's law says
so, through MOST_SURFACES of them at most.

The way through a block is its faces in order, and rays on different ways are different branches: between them the
view jumps.  Kernels return  fate + FATES * faces, the faces as digits to base FACES + 1.  An edge of real glass is
ground, chipped or glued: a ray that crosses a face nearer to the plane of another face than the width of the edges
is lost (EDGE).  What reaches the investigation plane in the glass ends there (IN_GLASS).
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.crossed import CONTACT_TOL_MM
from tracer.kernels.refraction import plane_point_rates, refract, refract_rates
from tracer.kernels.rooms import OUT
from tracer.kernels.sphere import transmittance
from tracer.kernels.vectors import Vector, dot, move, scale, subtract, vector_at
from tracer.kernels.world import EDGE, ENTERED, FATES, IN_GLASS, OFF_INSIDE, RECOVERED, TIR, Crossed

FACES, MOST_SURFACES = 8, 5
GLASS, FILLED, WALL, BORDER, FIRST_FACE = 3, 4, 5, 6, 7
BLOCK_NUMBERS = FIRST_FACE + 4 * FACES
DIGIT = FACES + 1
Chord = tuple[float, int, float, int]  # distances to where a line enters and leaves, and by which faces


@kernel
def find_chord(p: Vector, d: Vector, row: Array, wall: float) -> Chord:
    """Find where a line enters and leaves the faces moved inwards by `wall`; it misses if it leaves first."""
    w = subtract(p, vector_at(row, 0))
    first, entry, last, leaving = -math.inf, 0, math.inf, 0
    for k in range(FACES):
        at = FIRST_FACE + 4 * k
        normal = vector_at(row, at)
        slope, above = dot(d, normal), dot(w, normal) - (row[at + 3] - wall)
        if slope < 0.0:
            if -above / slope > first:
                first, entry = -above / slope, k
        elif slope > 0.0:
            if -above / slope < last:
                last, leaving = -above / slope, k
        elif above >= 0.0:
            return math.inf, k, -math.inf, k
    return first, entry, last, leaving


@kernel
def is_at_edge(q: Vector, face: int, row: Array, wall: float) -> bool:
    """Return whether a point of a face is nearer to another face's plane than the width of the edges."""
    w, width = subtract(q, vector_at(row, 0)), row[BORDER]
    if width > 0.0:
        for k in range(FACES):
            at = FIRST_FACE + 4 * k
            if k != face and not dot(w, vector_at(row, at)) < row[at + 3] - wall - width:
                return True
    return False


@kernel
def meets_block(p: Vector, d: Vector, row: Array) -> float:
    """Distance to the middle of the chord; inf if there is none, or the investigation plane comes before it."""
    first, _, last, _ = find_chord(p, d, row, 0.0)
    if not first < last:
        return math.inf
    middle = 0.5 * (first + last)
    return middle if middle > 0.0 and p[2] + first * d[2] > -CONTACT_TOL_MM else math.inf


@kernel_inlined
def face_normal(row: Array, face: int, side: float) -> Vector:
    """Unit normal of a face, outwards (1) or inwards (-1)."""
    return scale(side, vector_at(row, FIRST_FACE + 4 * face))


@kernel
def cross_glass(q: Vector, e: Vector, row: Array, faces: int, in_wall: bool) -> Crossed:
    """Follow a ray in the glass until it leaves: as `Kind.cross`, path and light of this part alone.

    `faces` were crossed before; `in_wall`: it may meet the inside next.
    """
    n, path, light, fate = row[GLASS], 0.0, 1.0, RECOVERED
    while faces < DIGIT ** (MOST_SURFACES - 1):
        _, _, t, face = find_chord(q, e, row, 0.0)
        inner = False
        if in_wall:
            first, entry, last, _ = find_chord(q, e, row, row[WALL])
            inner = first < last and last > 0.0
            if inner:
                t, face = first, entry
        t = max(t, 0.0)
        q, path, faces = move(q, t, e), path + n * t, DIGIT * faces + face + 1
        if q[2] < -CONTACT_TOL_MM:
            return IN_GLASS, q, e, path, 0.0
        wall = row[WALL] if inner else 0.0
        if is_at_edge(q, face, row, wall):
            return EDGE, q, e, path, 0.0
        ratio = n / row[FILLED] if inner else n
        turned, c1, c2 = refract(e, face_normal(row, face, 1.0 if inner else -1.0), ratio)
        e, in_wall = turned, row[WALL] > 0.0 and not inner
        if c2 > 0.0:
            light *= transmittance(c1, c2, 1.0 / ratio)
            return (ENTERED if inner else fate) + FATES * faces, q, e, path, light
        fate = OFF_INSIDE if inner else fate
    return TIR, q, e, path, 0.0


@kernel
def cross_block(p: Vector, d: Vector, row: Array) -> Crossed:
    """Take a ray from outside through the block, or into it if it is hollow, as `Kind.cross`."""
    t, face, _, _ = find_chord(p, d, row, 0.0)
    q, n = move(p, t, d), row[GLASS]
    if is_at_edge(q, face, row, 0.0):
        return EDGE, q, d, t, 0.0
    e, c1, c2 = refract(d, face_normal(row, face, 1.0), 1.0 / n)
    if c2 == 0.0:
        return TIR, q, e, t, 0.0
    fate, q, e, path, light = cross_glass(q, e, row, face + 1, row[WALL] > 0.0)
    return fate, q, e, t + path, light * transmittance(c1, c2, n)


@kernel
def leave_block(p: Vector, d: Vector, row: Array) -> Crossed:
    """Take a ray from inside out through the wall, as `Kind.leave`.

    What is totally reflected has its face, so that rays which end in the room before are another branch.
    """
    _, _, t, face = find_chord(p, d, row, row[WALL])
    t = max(t, 0.0)
    q, path = move(p, t, d), row[FILLED] * t
    if q[2] < 0.0:
        return RECOVERED, p, d, 0.0, 1.0
    if is_at_edge(q, face, row, row[WALL]):
        return EDGE, q, d, path, 0.0
    ratio = row[FILLED] / row[GLASS]
    e, c1, c2 = refract(d, face_normal(row, face, -1.0), ratio)
    if c2 == 0.0:
        return TIR + FATES * (face + 1), q, e, path, 0.0
    fate, q, e, more, light = cross_glass(q, e, row, face + 1, False)
    if fate % FATES == RECOVERED:
        fate += ENTERED
    elif fate % FATES in (ENTERED, OFF_INSIDE, TIR):  # reflected at the outer face, and back in
        fate = TIR + FATES * (face + 1)
    return fate, q, e, path + more, light * transmittance(c1, c2, 1.0 / ratio)


@kernel
def face_rates(
    ray: tuple[Vector, Vector, float], f: Vector, u: Vector, row: Array, rate: Array,
    surface: tuple[int, float, float], bend: tuple[float, float],
) -> tuple[Vector, Vector, Vector, Vector]:  # fmt: skip
    """Point and direction behind a face, and their derivatives; `ray` and `bend` as of ``tube.surface_rates``.

    `surface`: number of the face, 1 where its outward normal looks against the ray, else -1, and the rate at which
    it moves inwards with the wall.
    """
    (p, d, t), (ratio, ratio_rate), (face, side, wall_rate) = ray, bend, surface
    at = FIRST_FACE + 4 * face
    normal, r, q = vector_at(row, at), vector_at(rate, at), move(p, t, d)
    lift = dot(normal, vector_at(rate, 0)) - dot(subtract(q, vector_at(row, 0)), r) + rate[at + 3] - wall_rate
    f = plane_point_rates(d, t, normal, f, u, lift)
    normal, r = scale(side, normal), scale(side, r)
    e, c1, c2 = refract(d, normal, ratio)
    return q, e, f, refract_rates(d, normal, ratio, c1, c2, u, r, ratio_rate)


@kernel
def block_rates(
    p: Vector, d: Vector, f: Vector, u: Vector, row: Array, rate: Array, way: int
) -> tuple[Vector, Vector]:
    """Derivatives of point and direction behind, on the way that the ray took, as `Kind.rates`."""
    n, filled, n_rate = row[GLASS], row[FILLED], rate[GLASS]
    into_wall = filled / n, (rate[FILLED] - filled / n * n_rate) / n
    inwards = n / filled, (n_rate - n / filled * rate[FILLED]) / filled
    if way == OUT:
        _, _, t, face = find_chord(p, d, row, row[WALL])
        ray = p, d, max(t, 0.0)
        p, d, f, u = face_rates(ray, f, u, row, rate, (face, -1.0, rate[WALL]), into_wall)
        in_wall = False
    else:
        t, face, _, _ = find_chord(p, d, row, 0.0)
        bend = 1.0 / n, -n_rate / (n * n)
        p, d, f, u = face_rates((p, d, t), f, u, row, rate, (face, 1.0, 0.0), bend)
        in_wall = row[WALL] > 0.0
    for _ in range(MOST_SURFACES - 1):
        _, _, t, face = find_chord(p, d, row, 0.0)
        inner = False
        if in_wall:
            first, entry, last, _ = find_chord(p, d, row, row[WALL])
            inner = first < last and last > 0.0
            if inner:
                t, face = first, entry
        bend, side = (inwards, 1.0) if inner else ((n, n_rate), -1.0)
        _, _, c2 = refract(d, face_normal(row, face, side), bend[0])
        ray = p, d, max(t, 0.0)
        p, d, f, u = face_rates(ray, f, u, row, rate, (face, side, rate[WALL] if inner else 0.0), bend)
        if c2 > 0.0:
            break
        in_wall = row[WALL] > 0.0 and not inner
    return f, u
