"""Many neighbouring rays at once through a few spheres: the fast form of ``tracer.kernels.rays``.

A block is up to LANES neighbouring pixels of one row.  Its rays go from body to body together, round by
round, in one structure of arrays: every pass is a loop over the block without a branch in which hits are
taken by selects, so that the compiler puts 4 or 8 rays into one vector instruction.  A round is

    intersect   every sphere that can still be met: keep the nearest foot point ahead, as `trace_ray` does;
    refract     at every sphere that some ray met: all rays are turned, those that met it keep the result.

When one sphere alone can be met, or one that lies wholly above all others while every ray goes down, both are one
pass.  The number of spheres is data, so the same machine code serves every scene.  A sphere is
skipped when

    first round    its silhouette (`glass_span`, exact) does not reach into the block;
    later rounds   it is the only one met in the round before (a body just left cannot be met again), or it lies
                   wholly above all spheres just met while every ray of the block goes down.

Directions D are not normalised (Q = |D|^2 is kept by every turn), which saves a root.  With the symbols of
``tracer.kernels.sphere``, L = sqrt Q, m in units of D:

    L cos i = sqrt((1 - b^2/R^2) Q),   L cos t = sqrt((1 - b^2/(n R)^2) Q)
    L g = (1 - 1/n^2) Q / (L cos t + L cos i/n)
    cos delta = 1 - 2 (b/R)^2 (L g)^2/Q,   L q = 2 (L g) (L^2 cos i cos t + Q b^2/(n R^2)) / (Q R)
    D' = D cos delta - a L q,   a' = a cos delta + D b^2 L q/Q.

Blocks are filled up to a multiple of VECTOR rays: what a loop does to its last few rays one by one is rounded
another way than in vectors, and a pixel's bits must not depend on where its block ends.

All columns of a block lie in ONE array, STEP apart: the compiler then knows by itself that they do not
overlap, where eight arrays would need more overlap tests at run time than it is willing to make.

``balls`` (N, BALL): centre x, y, z, R^2, 1/R^2, 1/(n R)^2, 1/n, (n^2 - 1)/n^2, 1/R, lowest z, highest z.
``rays`` (RAY_NUMBERS,) float64 and ``trips`` (TRIP_NUMBERS,) int64 are the block.

Where the path is known beforehand, `single_block` and `direct_block` write plane points (NaN: the ray does not go
down) where they belong: passes over scratch cost more.
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.branches import ALL_BITS, BITS, MOST_EVENTS, NOTHING
from tracer.kernels.camera import AHEAD_X, CENTRE_V, DOWN_X, FOCAL, RIGHT_X, axes_of, eye_of, ideal_row
from tracer.kernels.packets import DX, DY, DZ, PX, PY, PZ, STEP, foot_of, refract
from tracer.kernels.vectors import Vector, dot, subtract, vector_at

BALL = 11
QQ, IQ, NEAR = (k * STEP for k in range(6, 9))
RAY_NUMBERS = 9 * STEP
PICK, TRIP = (k * STEP for k in range(2))
TRIP_NUMBERS = 2 * STEP
# Skips that a test may switch off; the result must not change
SKIP_SILHOUETTES, SKIP_LEFT_BEHIND, SKIP_LONE = 1, 2, 8


@kernel_inlined
def glass_of(balls: Array, k: int) -> tuple[float, float, float, float, float, float]:
    """R^2, 1/R^2, 1/(n R)^2, 1/n, (n^2 - 1)/n^2 and 1/R of sphere k, as `refract` takes them."""
    return balls[k, 3], balls[k, 4], balls[k, 5], balls[k, 6], balls[k, 7], balls[k, 8]


@kernel_inlined
def image_ray(x: float, y: float, axes: tuple[float, ...]) -> Vector:
    """Direction, not normalised, of the ray through ideal image coordinates x, y."""
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes
    return c3 * x + c6 * y + c9, c4 * x + c7 * y + c10, c5 * x + c8 * y + c11


@kernel_inlined
def write_plane_point(i: int, p: Vector, d: Vector, point: Array) -> int:
    """Write the plane point of a ray, x and y in turn, NaN if it does not go down; return 1 if so."""
    t = -p[2] / d[2]
    x, y = p[0] + t * d[0], p[1] + t * d[1]
    down = d[2] < 0.0
    point[2 * i], point[2 * i + 1] = x if down else math.nan, y if down else math.nan
    return 0 if down else 1


@kernel
def direct_block(x: Array, y: Array, camera: Array, point: Array) -> int:
    """Trace rays (n,) that no glass touches to point (2 n,), x and y in turn; return how many do not go down.

    One y stands for all where ``y`` is (1,), here and below.
    """
    up, eye, axes, level, first = 0, eye_of(camera), axes_of(camera), y.shape[0] == 1, y[0]
    for i in range(x.shape[0]):
        up += write_plane_point(i, eye, image_ray(x[i], first if level else y[i], axes), point)
    return up


@kernel
def single_block(x: Array, y: Array, camera: Array, balls: Array, k: int, point: Array, branch: Array) -> int:
    """Trace rays (n,) as `direct_block` does, but through sphere k alone; branch (n,): its number if met."""
    up, eye, axes, centre, glass = 0, eye_of(camera), axes_of(camera), vector_at(balls[k], 0), glass_of(balls, k)
    w, level, first = subtract(eye, centre), y.shape[0] == 1, y[0]
    for i in range(x.shape[0]):
        d = image_ray(x[i], first if level else y[i], axes)
        square = dot(d, d)
        inverse = 1.0 / square
        m, a, b2 = foot_of(w, d, inverse)
        hit = (b2 < glass[0]) & (m > 0.0)
        q, e = refract(centre, a, b2, d, (square, inverse), glass, True)
        p = q[0] if hit else eye[0], q[1] if hit else eye[1], q[2] if hit else eye[2]
        e = e[0] if hit else d[0], e[1] if hit else d[1], e[2] if hit else d[2]
        up += write_plane_point(i, p, e, point)
        branch[i] = 1 << k if hit else 0
    return up


@kernel
def begin_block(x: Array, y: Array, camera: Array, rays: Array, trips: Array) -> None:
    """Put the rays of a span with ideal image coordinates x, y (n,) into the block, n <= LANES."""
    (ox, oy, oz), axes, level, first = eye_of(camera), axes_of(camera), y.shape[0] == 1, y[0]
    for i in range(x.shape[0]):
        d = image_ray(x[i], first if level else y[i], axes)
        square = dot(d, d)
        rays[PX + i], rays[PY + i], rays[PZ + i] = ox, oy, oz
        rays[DX + i], rays[DY + i], rays[DZ + i] = d
        rays[QQ + i], rays[IQ + i] = square, 1.0 / square
    for i in range(x.shape[0]):
        trips[TRIP + i] = 0


@kernel
def clear_picks(count: int, rays: Array, trips: Array) -> None:
    """Forget the spheres that were met."""
    for i in range(count):
        rays[NEAR + i] = math.inf
        trips[PICK + i] = NOTHING


@kernel_inlined
def intersect(k: int, balls: Array, count: int, rays: Array, trips: Array) -> bool:
    """Note sphere k for the rays whose nearest sphere ahead it is so far; return whether there are any."""
    (cx, cy, cz), r2 = vector_at(balls[k], 0), balls[k, 3]
    some = 0
    for i in range(count):
        w = rays[PX + i] - cx, rays[PY + i] - cy, rays[PZ + i] - cz
        m, _, b2 = foot_of(w, (rays[DX + i], rays[DY + i], rays[DZ + i]), rays[IQ + i])
        nearer = (b2 < r2) & (m > 0.0) & (m < rays[NEAR + i]) & (trips[TRIP + i] & ALL_BITS != k + 1)
        near = m if nearer else rays[NEAR + i]
        rays[NEAR + i] = near
        trips[PICK + i] = k if nearer else trips[PICK + i]
        some += nearer
    return some != 0


@kernel_inlined
def refract_block(k: int, alone: bool, balls: Array, count: int, rays: Array, trips: Array) -> tuple[bool, bool]:
    """Refract the rays that picked sphere k (`alone`: all that meet it); whether any did, whether all go down."""
    centre, glass = vector_at(balls[k], 0), glass_of(balls, k)
    some, level = 0, 0
    for i in range(count):
        d = rays[DX + i], rays[DY + i], rays[DZ + i]
        p = rays[PX + i], rays[PY + i], rays[PZ + i]
        m, a, b2 = foot_of(subtract(p, centre), d, rays[IQ + i])
        hit = (
            (b2 < glass[0]) & (m > 0.0) & (trips[TRIP + i] & ALL_BITS != k + 1) & (alone | (trips[PICK + i] == k))
        )
        q, e = refract(centre, a, b2, d, (rays[QQ + i], rays[IQ + i]), glass, True)
        # Selects of finished values: an expression inside a select would become a branch.
        qx, qy, qz = q[0] if hit else p[0], q[1] if hit else p[1], q[2] if hit else p[2]
        ex, ey, ez = e[0] if hit else d[0], e[1] if hit else d[1], e[2] if hit else d[2]
        rays[PX + i], rays[PY + i], rays[PZ + i] = qx, qy, qz
        rays[DX + i], rays[DY + i], rays[DZ + i] = ex, ey, ez
        trip = trips[TRIP + i]
        longer = trip << BITS | (k + 1)
        trips[TRIP + i] = longer if hit else trip
        some += hit
        level += not ez < 0.0
    return some != 0, level == 0


@kernel
def goes_down(count: int, rays: Array) -> bool:
    """Return whether all rays of a block do."""
    level = 0
    for i in range(count):
        level += not rays[DZ + i] < 0.0
    return level == 0


@kernel
def follow_block(
    low: int, count: int, skips: int, balls: Array, spans: Array, rays: Array, trips: Array, wanted: Array
) -> None:
    """Take the block of columns low..low+count-1 through the spheres; spans (N, 2), scratch wanted (N,) int64."""
    bodies = balls.shape[0]
    for k in range(bodies):
        reached = (spans[k, 0] < low + count) & (spans[k, 1] > low)
        wanted[k] = 1 if reached or not skips & SKIP_SILHOUETTES else 0
    all_down, last_top = goes_down(count, rays), math.inf
    for _ in range(MOST_EVENTS + 1):
        candidates, first, rest = 0, NOTHING, -math.inf
        for k in range(bodies):
            if wanted[k]:
                candidates += 1
                first, rest = (k, rest) if first == NOTHING else (first, max(rest, balls[k, 10]))
        if candidates == 0:
            return
        met, only, top = 0, NOTHING, -math.inf
        only_one = candidates == 1 and balls[first, 9] < last_top  # back up hardly a ray goes: asked first
        if only_one or (skips & SKIP_LEFT_BEHIND and all_down and balls[first, 9] >= rest):
            some, all_down = refract_block(first, True, balls, count, rays, trips)
            if not some:
                wanted[first] = 0
                continue
            met, only, top = 1, first, balls[first, 10]
        else:
            clear_picks(count, rays, trips)
            for k in range(bodies):
                if wanted[k]:
                    wanted[k] = 1 if intersect(k, balls, count, rays, trips) else 0
            for k in range(bodies):
                if wanted[k]:
                    some, all_down = refract_block(
                        k, False, balls, count, rays, trips
                    )  # the last one speaks for all
                    if some:
                        met += 1
                        only, top = k, max(top, balls[k, 10])
            if met == 0:
                return
        last_top = top
        for k in range(bodies):
            above = all_down and balls[k, 9] >= top
            behind = (met == 1 and k == only) or (above and skips & SKIP_LEFT_BEHIND)
            wanted[k] = 0 if behind else 1
    for i in range(count):
        trips[TRIP + i] = NOTHING


@kernel
def glass_span(x: Array, y: Array, flat: bool, camera: Array, balls: Array, k: int) -> tuple[int, int]:
    """Columns [first, last) of a row between which the direct rays can meet sphere k, a pixel wider each way.

    With w = pinhole - centre, a ray d meets it if (w . d)^2 > (w . w - R^2) d . d and w . d < 0.  On a row of
    an ideal camera (`flat`: y is the same in all columns, x is linear) d is linear in x and the bounds are the
    roots of a quadratic; else the row is searched.
    """
    to_eye = subtract(eye_of(camera), vector_at(balls[k], 0))
    outside = dot(to_eye, to_eye) - balls[k, 3]
    u, v = dot(vector_at(camera, RIGHT_X), to_eye), dot(vector_at(camera, DOWN_X), to_eye)
    w = dot(vector_at(camera, AHEAD_X), to_eye)
    width = x.shape[0]
    if flat and u * u < outside:  # the usual case, an ellipse: inside between the roots
        rest = v * y[0] + w
        a, b, c = u * u - outside, u * rest, rest * rest - outside * (y[0] * y[0] + 1.0)
        root = b * b - a * c
        # Rounding of the root, a few parts in 1e16 of its terms: a row that just misses is still a row.
        root += 1e-14 * (b * b + abs(a * c))
        if root < 0.0:
            return 0, 0
        low, high = (-b + math.sqrt(root)) / a, (-b - math.sqrt(root)) / a
        step = x[1] - x[0] if width > 1 else 1.0
        first = int(max(0.0, min(width, math.floor((low - x[0]) / step) - 1.0)))
        last = int(max(0.0, min(width, math.ceil((high - x[0]) / step) + 2.0)))
        return first, max(first, last)
    first, last = width, 0
    for i in range(width):
        along = u * x[i] + v * y[i] + w
        d2 = x[i] * x[i] + y[i] * y[i] + 1.0
        # As above; for d itself, not its square root, so that no pixel at the rim is lost to rounding.
        meets = (along < 0.0) & (along * along * (1.0 + 1e-13) > outside * d2)
        first = min(first, i if meets else width)
        last = max(last, i + 1 if meets else 0)
    return max(0, first - 1), max(max(0, first - 1), min(width, last + 1))


@kernel
def place_row(row: int, flat: bool, camera: Array, x: Array, y: Array) -> None:
    """Ideal image coordinates x, y (W,) of a row.

    Of an ideal camera (`flat`) x is the same in every row and stays, and one y stands for all where `y` is (1,).
    """
    if flat:
        level = (row - camera[CENTRE_V]) / camera[FOCAL]
        for i in range(y.shape[0]):
            y[i] = level
    else:
        ideal_row(row, camera, x, y)


@kernel
def insert_span(spans: Array, count: int, low: int, high: int) -> int:
    """Insert [low, high) into `count` disjoint ascending spans, joining what overlaps; return the new count."""
    kept = 0
    for k in range(count):
        if spans[k, 1] < low or spans[k, 0] > high:
            spans[kept, 0], spans[kept, 1] = spans[k, 0], spans[k, 1]
            kept += 1
        else:
            low, high = min(low, spans[k, 0]), max(high, spans[k, 1])
    place = kept
    while place > 0 and spans[place - 1, 0] > low:
        spans[place, 0], spans[place, 1] = spans[place - 1, 0], spans[place - 1, 1]
        place -= 1
    spans[place, 0], spans[place, 1] = low, high
    return kept + 1
