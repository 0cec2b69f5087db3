"""Many neighbouring rays at once through a few spheres: the fast form of ``tracer.kernels.march``.

The rays of a row go through all spheres in one fixed order, front to back, without a branch: every sphere
is computed for every ray and the result is taken or left by a select, so that the compiler puts 4 or 8 rays
into one vector instruction.  The spheres arrive as a TUPLE of tuples: their number is part of the type, the
loop over them is unrolled, and a scene with two spheres runs code made for two.  The arithmetic is that of
``tracer.kernels.sphere``.

A fixed order is right as long as no ray needs another one.  Spheres whose extents in z do not overlap are
met in order of z by every ray that keeps going down.  Others are ordered by their power |c - p|^2 - R^2 about
the pinhole p: along any ray from p the product of the two distances to a sphere is its power, so the first
straight piece meets disjoint spheres in that order.  The last piece is checked against every sphere.  What is
left are pieces between two spheres, and rays with two or more are rare: those are followed by `march` as well.
A ray that turned out to need another order, or was bent level or upwards, is MARKED, and the caller traces
marked rays again.  So the result never depends on the order being right.

Sphere tuple: centre x, y, z, R^2, 1/R^2, 1/(n R)^2, 1/n, (n^2 - 1)/n^2, 1/R.
"""

import math

from tracer.kernels._jit import Array, kernel
from tracer.kernels.camera import ideal_xy
from tracer.kernels.march import MISSED_PLANE, RECOVERED, march

Row = tuple[float, ...]
MARKED = 1 << 15  # bit of the crossing mask: this ray needs `march`


@kernel
def pass_sphere(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, s: Row
) -> tuple[bool, float, float, float, float, float, float]:
    """Whether the ray meets the sphere, and the ray after it (unchanged if not)."""
    wx, wy, wz = px - s[0], py - s[1], pz - s[2]
    m = -(wx * dx + wy * dy + wz * dz)
    ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
    b2 = ax * ax + ay * ay + az * az
    hit = (b2 < s[3]) & (m > 0.0)
    cos_i = math.sqrt(max((s[3] - b2) * s[4], 0.0))
    cos_t = math.sqrt(max(1.0 - b2 * s[5], 0.0))
    g = s[7] / (cos_t + cos_i * s[6])
    chi = b2 * s[4]
    cosine = 1.0 - 2.0 * chi * g * g
    q = 2.0 * g * (cos_i * cos_t + chi * s[6]) * s[8]
    along = b2 * q
    qx, qy, qz = s[0] + ax * cosine + dx * along, s[1] + ay * cosine + dy * along, s[2] + az * cosine + dz * along
    ex, ey, ez = dx * cosine - ax * q, dy * cosine - ay * q, dz * cosine - az * q
    return (  # selects of finished values: an expression in here would become a branch
        hit,
        qx if hit else px,
        qy if hit else py,
        qz if hit else pz,
        ex if hit else dx,
        ey if hit else dy,
        ez if hit else dz,
    )


@kernel
def chain_row(
    x: Array,
    y: Array,
    camera: Row,
    spheres: tuple[Row, ...],
    checked: bool,
    point: Array,
    status: Array,
    crossed: Array,
) -> None:
    """Trace a span of one row.

    ``x``, ``y`` (W,) are ideal image coordinates in focal lengths; ``point`` (W, 2), ``status`` (W,) and
    ``crossed`` (W,) uint16 (bit k: sphere k of the chain was crossed) are the span's outputs.  With `checked`
    the last piece is tested against all spheres.  Spans arrive as slices and are walked from 0: an index that
    might be negative would cost the vectorisation.
    """
    for i in range(x.shape[0]):
        scale = 1.0 / math.sqrt(x[i] * x[i] + y[i] * y[i] + 1.0)
        a, b = x[i] * scale, y[i] * scale
        dx = camera[3] * a + camera[6] * b + camera[9] * scale
        dy = camera[4] * a + camera[7] * b + camera[10] * scale
        dz = camera[5] * a + camera[8] * b + camera[11] * scale
        px, py, pz = camera[0], camera[1], camera[2]
        mask, bit, newest = 0, 1, 0
        level = False
        for sphere in spheres:
            hit, px, py, pz, dx, dy, dz = pass_sphere(px, py, pz, dx, dy, dz, sphere)
            mask |= bit if hit else 0
            newest = bit if hit else newest
            level |= not dz < 0.0
            bit *= 2
        again = False
        if checked:
            bit = 1
            for sphere in spheres:
                wx, wy, wz = px - sphere[0], py - sphere[1], pz - sphere[2]
                m = -(wx * dx + wy * dy + wz * dz)
                ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
                again |= (m > 0.0) & (ax * ax + ay * ay + az * az < sphere[3]) & (bit != newest)
                bit *= 2
        t = -pz / dz
        down = dz < 0.0
        tx, ty = px + t * dx, py + t * dy
        point[i, 0] = tx if down else math.nan
        point[i, 1] = ty if down else math.nan
        status[i] = RECOVERED if down else MISSED_PLANE
        crossed[i] = mask | (MARKED if again | level else 0)


@kernel
def check_order(x: Array, y: Array, camera: Row, table: Array, rods: Array, trail: Array, crossed: Array) -> None:
    """Mark the rays of a span that crossed two spheres or more, but not in chain order.

    ``table`` (N, 6) holds the spheres as `march` takes them, in chain order; ``trail`` (MAX_EVENTS,) is scratch.
    """
    for i in range(x.shape[0]):
        mask = int(crossed[i])
        if mask & MARKED or mask & (mask - 1) == 0:
            continue
        scale = 1.0 / math.sqrt(x[i] * x[i] + y[i] * y[i] + 1.0)
        a, b = x[i] * scale, y[i] * scale
        dx = camera[3] * a + camera[6] * b + camera[9] * scale
        dy = camera[4] * a + camera[7] * b + camera[10] * scale
        dz = camera[5] * a + camera[8] * b + camera[11] * scale
        _, _, _, _, _, _, _, _, _, _, events = march(
            camera[0], camera[1], camera[2], dx, dy, dz, table, rods, trail
        )
        met, newest = 0, -1
        for k in range(int(events)):
            met = met | 1 << trail[k] if trail[k] > newest else MARKED
            newest = trail[k]
        if met != mask:
            crossed[i] = mask | MARKED


@kernel
def direct_row(x: Array, y: Array, camera: Row, point: Array, status: Array, crossed: Array) -> None:
    """Trace a span of one row that no glass touches: the pinhole's line to the plane."""
    for i in range(x.shape[0]):
        dx = camera[3] * x[i] + camera[6] * y[i] + camera[9]
        dy = camera[4] * x[i] + camera[7] * y[i] + camera[10]
        dz = camera[5] * x[i] + camera[8] * y[i] + camera[11]
        t = -camera[2] / dz
        down = dz < 0.0
        tx, ty = camera[0] + t * dx, camera[1] + t * dy
        point[i, 0] = tx if down else math.nan
        point[i, 1] = ty if down else math.nan
        status[i] = RECOVERED if down else MISSED_PLANE
        crossed[i] = 0


@kernel
def glass_span(row: int, x: Array, y: Array, flat: bool, camera: Row, sphere: Row) -> tuple[int, int]:
    """Columns [first, last) of a row between which the direct rays can meet a sphere, a pixel wider each way.

    With w = pinhole - centre, a ray d meets it if (w . d)^2 > (w . w - R^2) d . d and w . d < 0.  On a row of
    an ideal camera (`flat`: y is the same in all columns, x is linear) d is linear in x and the bounds are the
    roots of a quadratic; else the row is searched.
    """
    wx, wy, wz = camera[0] - sphere[0], camera[1] - sphere[1], camera[2] - sphere[2]
    outside = wx * wx + wy * wy + wz * wz - sphere[3]
    u = camera[3] * wx + camera[4] * wy + camera[5] * wz  # w in camera axes
    v = camera[6] * wx + camera[7] * wy + camera[8] * wz
    w = camera[9] * wx + camera[10] * wy + camera[11] * wz
    width = x.shape[0]
    if flat:
        k = v * y[0] + w
        a = u * u - outside
        b = u * k
        c = k * k - outside * (y[0] * y[0] + 1.0)
        if a < 0.0:  # the usual case, an ellipse: inside between the roots
            root = b * b - a * c
            if root < 0.0:
                return 0, 0
            low, high = (-b + math.sqrt(root)) / a, (-b - math.sqrt(root)) / a
            step = x[1] - x[0] if width > 1 else 1.0
            first = int(max(0.0, min(width, math.floor((low - x[0]) / step))))
            last = int(max(0.0, min(width, math.ceil((high - x[0]) / step) + 1.0)))
            return first, max(first, last)
    first, last = width, 0
    for i in range(width):
        dot = u * x[i] + v * y[i] + w
        if dot < 0.0 and dot * dot > outside * (x[i] * x[i] + y[i] * y[i] + 1.0):
            first, last = min(first, i), i + 1
    return max(0, first - 1), max(max(0, first - 1), min(width, last + 1))


@kernel
def chain_rows(
    packed: Array,
    camera: Row,
    spheres: tuple[Row, ...],
    table: Array,
    rods: Array,
    trail: Array,
    checked: bool,
    flat: bool,
    first: int,
    last: int,
    x: Array,
    y: Array,
    spans: Array,
    point: Array,
    status: Array,
    crossed: Array,
) -> None:
    """Trace rows first..last-1: the direct view everywhere, the chain only where glass can be met.

    ``table`` and ``trail`` as in `check_order`; ``x``, ``y`` (W,) and ``spans`` (N + 1, 2) int64 are scratch;
    outputs as in `chain_row`, (H, W, ...).
    """
    width = x.shape[0]
    for row in range(first, last):
        if flat:
            for i in range(width):
                x[i] = (i - packed[13]) / packed[12]
                y[i] = (row - packed[14]) / packed[12]
        else:
            for i in range(width):
                x[i], y[i], _, _, _, _ = ideal_xy(float(i), float(row), packed)
        count = 0
        for sphere in spheres:
            low, high = glass_span(row, x, y, flat, camera, sphere)
            if low < high:
                count = insert_span(spans, count, low, high)
        done = 0
        for k in range(count + 1):
            low = spans[k, 0] if k < count else width
            p, t, c = point[row, done:low], status[row, done:low], crossed[row, done:low]
            direct_row(x[done:low], y[done:low], camera, p, t, c)
            if k < count:
                done = spans[k, 1]
                p, t, c = point[row, low:done], status[row, low:done], crossed[row, low:done]
                chain_row(x[low:done], y[low:done], camera, spheres, checked, p, t, c)
                if checked:
                    check_order(x[low:done], y[low:done], camera, table, rods, trail, c)


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
