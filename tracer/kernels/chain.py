"""Many neighbouring rays at once through a few spheres: the fast form of ``tracer.kernels.rays``.

A block is up to LANES neighbouring pixels of one row.  Its rays go from body to body together, round by
round, in one structure of arrays: every pass is a loop over the block without a branch in which hits are
taken by selects, so that the compiler puts 4 or 8 rays into one vector instruction.  A round is

    look   at every sphere that can still be met: keep the nearest foot point ahead, as `trace_ray` does;
    turn   at every sphere that some ray met: all rays are turned, those that met it keep the result.

When one sphere alone can be met, or one that lies wholly above all others while every ray goes down, looking and
turning are one pass.  The number of spheres is data, so the same machine code serves every scene.  A sphere is not
looked at when

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

Where the way is known beforehand, `lone_block` and `direct_block` write plane points (NaN: the ray does not go
down) where they belong: passes over scratch cost more.
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.branches import ALL_BITS, BITS, MOST_EVENTS
from tracer.kernels.camera import (
    AHEAD_X,
    AHEAD_Y,
    AHEAD_Z,
    CENTRE_V,
    DOWN_X,
    DOWN_Y,
    DOWN_Z,
    EYE_X,
    EYE_Y,
    EYE_Z,
    FOCAL,
    RIGHT_X,
    RIGHT_Y,
    RIGHT_Z,
    axes_of,
    ideal_row,
)

LANES = 256  # rays of a block: 21 kB, what the first-level cache holds
BALL = 11
VECTOR = 8  # rays of the widest vector instruction
STEP = LANES + 40  # columns a power of two apart would fight for the same lines of that cache
PX, PY, PZ, DX, DY, DZ, QQ, IQ, NEAR = (k * STEP for k in range(9))
RAY_NUMBERS = 9 * STEP
PICK, TRIP = (k * STEP for k in range(2))
TRIP_NUMBERS = 2 * STEP
NOBODY = -1
SKIP_SILHOUETTES, SKIP_LEFT_BEHIND = 1, 2  # skips that a test may switch off; the result must not change


@kernel
def direct_block(x: Array, y: Array, camera: Array, point: Array) -> int:
    """Trace rays (n,) that no glass touches to point (2 n,), x and y in turn; return how many do not go down."""
    up = 0
    ox, oy, oz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    for i in range(x.shape[0]):
        dx = c3 * x[i] + c6 * y[i] + c9
        dy = c4 * x[i] + c7 * y[i] + c10
        dz = c5 * x[i] + c8 * y[i] + c11
        t = -oz / dz
        tx, ty = ox + t * dx, oy + t * dy
        down = dz < 0.0
        point[2 * i], point[2 * i + 1] = tx if down else math.nan, ty if down else math.nan
        up += 0 if down else 1
    return up


@kernel
def lone_block(x: Array, y: Array, camera: Array, balls: Array, point: Array, branch: Array) -> int:
    """Trace rays (n,) as `direct_block` does, but through the only sphere there is; branch (n,): who meets it."""
    up = 0
    ox, oy, oz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    cx, cy, cz, r2, ir2, kt = balls[0, 0], balls[0, 1], balls[0, 2], balls[0, 3], balls[0, 4], balls[0, 5]
    nu, gk, ir = balls[0, 6], balls[0, 7], balls[0, 8]
    wx, wy, wz = ox - cx, oy - cy, oz - cz
    for i in range(x.shape[0]):
        dx = c3 * x[i] + c6 * y[i] + c9
        dy = c4 * x[i] + c7 * y[i] + c10
        dz = c5 * x[i] + c8 * y[i] + c11
        square = dx * dx + dy * dy + dz * dz
        inverse = 1.0 / square
        m, ax, ay, az, b2 = foot_of(wx, wy, wz, dx, dy, dz, inverse)
        hit = (b2 < r2) & (m > 0.0)
        ex, ey, ez, cosine, along = turned(ax, ay, az, b2, dx, dy, dz, square, inverse, r2, ir2, kt, nu, gk, ir)
        px, py, pz = cx + ax * cosine + dx * along, cy + ay * cosine + dy * along, cz + az * cosine + dz * along
        px, py, pz = px if hit else ox, py if hit else oy, pz if hit else oz
        ex, ey, ez = ex if hit else dx, ey if hit else dy, ez if hit else dz
        t = -pz / ez
        tx, ty = px + t * ex, py + t * ey
        down = ez < 0.0
        point[2 * i], point[2 * i + 1] = tx if down else math.nan, ty if down else math.nan
        up += 0 if down else 1
        branch[i] = 1 if hit else 0
    return up


@kernel
def land_block(count: int, rays: Array) -> None:
    """Take the rays to the plane; their points are its points from then on."""
    for i in range(count):
        dz = rays[DZ + i]
        t = -rays[PZ + i] / dz
        tx, ty = rays[PX + i] + t * rays[DX + i], rays[PY + i] + t * rays[DY + i]
        down = dz < 0.0
        rays[PX + i], rays[PY + i] = tx if down else math.nan, ty if down else math.nan


@kernel
def whole_vectors(count: int) -> int:
    """Smallest multiple of VECTOR that is not below `count`."""
    return (count + VECTOR - 1) // VECTOR * VECTOR


@kernel
def begin_block(x: Array, y: Array, camera: Array, rays: Array, trips: Array) -> None:
    """Put the rays of a span with ideal image coordinates x, y (n,) into the block, n <= LANES."""
    ox, oy, oz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    for i in range(x.shape[0]):
        dx = c3 * x[i] + c6 * y[i] + c9
        dy = c4 * x[i] + c7 * y[i] + c10
        dz = c5 * x[i] + c8 * y[i] + c11
        square = dx * dx + dy * dy + dz * dz
        rays[PX + i], rays[PY + i], rays[PZ + i] = ox, oy, oz
        rays[DX + i], rays[DY + i], rays[DZ + i] = dx, dy, dz
        rays[QQ + i], rays[IQ + i] = square, 1.0 / square
    for i in range(x.shape[0]):
        trips[TRIP + i] = 0


@kernel_inlined
def foot_of(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, inverse: float
) -> tuple[float, float, float, float, float]:
    """Distance m to the foot point [|D|], the foot point a and b^2 of a ray from p relative to a centre."""
    m = -(px * dx + py * dy + pz * dz) * inverse
    ax, ay, az = px + m * dx, py + m * dy, pz + m * dz
    return m, ax, ay, az, ax * ax + ay * ay + az * az


@kernel_inlined
def turned(
    ax: float, ay: float, az: float, b2: float, dx: float, dy: float, dz: float, square: float, inverse: float,
    r2: float, ir2: float, kt: float, nu: float, gk: float, ir: float,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """D' of a ray that meets a sphere at its foot point a, cos delta, and b^2 L q / Q."""
    chi = b2 * ir2
    cos_i = math.sqrt(max((r2 - b2) * ir2, 0.0) * square)
    cos_t = math.sqrt(max(1.0 - b2 * kt, 0.0) * square)
    g = gk * square / (cos_t + cos_i * nu)
    gi = g * inverse
    cosine = 1.0 - 2.0 * chi * g * gi
    q = 2.0 * gi * (cos_i * cos_t + chi * nu * square) * ir
    return dx * cosine - ax * q, dy * cosine - ay * q, dz * cosine - az * q, cosine, b2 * q * inverse


@kernel
def clear_picks(count: int, rays: Array, trips: Array) -> None:
    """Forget what was looked at."""
    for i in range(count):
        rays[NEAR + i] = math.inf
        trips[PICK + i] = NOBODY


@kernel_inlined
def look(k: int, balls: Array, count: int, rays: Array, trips: Array) -> bool:
    """Note sphere k for the rays whose nearest sphere ahead it is so far; whether there are any."""
    cx, cy, cz, r2 = balls[k, 0], balls[k, 1], balls[k, 2], balls[k, 3]
    some = 0
    for i in range(count):
        m, _, _, _, b2 = foot_of(
            rays[PX + i] - cx,
            rays[PY + i] - cy,
            rays[PZ + i] - cz,
            rays[DX + i],
            rays[DY + i],
            rays[DZ + i],
            rays[IQ + i],
        )
        nearer = (b2 < r2) & (m > 0.0) & (m < rays[NEAR + i]) & (trips[TRIP + i] & ALL_BITS != k + 1)
        near = m if nearer else rays[NEAR + i]
        rays[NEAR + i] = near
        trips[PICK + i] = k if nearer else trips[PICK + i]
        some += nearer
    return some != 0


@kernel_inlined
def turn(k: int, alone: bool, balls: Array, count: int, rays: Array, trips: Array) -> tuple[bool, bool]:
    """Turn the rays that picked sphere k (`alone`: all that meet it); whether any did, and whether all go down."""
    cx, cy, cz, r2, ir2, kt = balls[k, 0], balls[k, 1], balls[k, 2], balls[k, 3], balls[k, 4], balls[k, 5]
    nu, gk, ir = balls[k, 6], balls[k, 7], balls[k, 8]
    some, level = 0, 0
    for i in range(count):
        dx, dy, dz = rays[DX + i], rays[DY + i], rays[DZ + i]
        px, py, pz = rays[PX + i], rays[PY + i], rays[PZ + i]
        square, inverse = rays[QQ + i], rays[IQ + i]
        m, ax, ay, az, b2 = foot_of(px - cx, py - cy, pz - cz, dx, dy, dz, inverse)
        hit = (b2 < r2) & (m > 0.0) & (trips[TRIP + i] & ALL_BITS != k + 1) & (alone | (trips[PICK + i] == k))
        ex, ey, ez, cosine, along = turned(ax, ay, az, b2, dx, dy, dz, square, inverse, r2, ir2, kt, nu, gk, ir)
        qx, qy, qz = cx + ax * cosine + dx * along, cy + ay * cosine + dy * along, cz + az * cosine + dz * along
        # Selects of finished values: an expression inside a select would become a branch.
        qx, qy, qz = qx if hit else px, qy if hit else py, qz if hit else pz
        ex, ey, ez = ex if hit else dx, ey if hit else dy, ez if hit else dz
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
    """Whether all rays of a block do."""
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
    all_down = goes_down(count, rays)
    for _ in range(MOST_EVENTS + 1):
        candidates, first, rest = 0, NOBODY, -math.inf
        for k in range(bodies):
            if wanted[k]:
                candidates += 1
                first, rest = (k, rest) if first == NOBODY else (first, max(rest, balls[k, 10]))
        if candidates == 0:
            return
        met, only, top = 0, NOBODY, -math.inf
        if candidates == 1 or (skips & SKIP_LEFT_BEHIND and all_down and balls[first, 9] >= rest):
            some, all_down = turn(first, True, balls, count, rays, trips)
            if not some:
                wanted[first] = 0
                continue
            met, only, top = 1, first, balls[first, 10]
        else:
            clear_picks(count, rays, trips)
            for k in range(bodies):
                if wanted[k]:
                    wanted[k] = 1 if look(k, balls, count, rays, trips) else 0
            for k in range(bodies):
                if wanted[k]:
                    some, all_down = turn(k, False, balls, count, rays, trips)  # the last one speaks for all
                    if some:
                        met += 1
                        only, top = k, max(top, balls[k, 10])
            if met == 0:
                return
        for k in range(bodies):
            above = all_down and balls[k, 9] >= top
            behind = (met == 1 and k == only) or (above and skips & SKIP_LEFT_BEHIND)
            wanted[k] = 0 if behind else 1
    for i in range(count):
        trips[TRIP + i] = NOBODY


@kernel
def glass_span(x: Array, y: Array, flat: bool, camera: Array, balls: Array, k: int) -> tuple[int, int]:
    """Columns [first, last) of a row between which the direct rays can meet sphere k, a pixel wider each way.

    With w = pinhole - centre, a ray d meets it if (w . d)^2 > (w . w - R^2) d . d and w . d < 0.  On a row of
    an ideal camera (`flat`: y is the same in all columns, x is linear) d is linear in x and the bounds are the
    roots of a quadratic; else the row is searched.
    """
    wx, wy, wz = camera[EYE_X] - balls[k, 0], camera[EYE_Y] - balls[k, 1], camera[EYE_Z] - balls[k, 2]
    outside = wx * wx + wy * wy + wz * wz - balls[k, 3]
    u = camera[RIGHT_X] * wx + camera[RIGHT_Y] * wy + camera[RIGHT_Z] * wz  # w in camera axes
    v = camera[DOWN_X] * wx + camera[DOWN_Y] * wy + camera[DOWN_Z] * wz
    w = camera[AHEAD_X] * wx + camera[AHEAD_Y] * wy + camera[AHEAD_Z] * wz
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
        dot = u * x[i] + v * y[i] + w
        d2 = x[i] * x[i] + y[i] * y[i] + 1.0
        # As above; for d itself, not its square root, so that no pixel at the rim is lost to rounding.
        meets = (dot < 0.0) & (dot * dot * (1.0 + 1e-13) > outside * d2)
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
