"""Rows of the sensor, block by block: which columns meet glass, how each block is traced, where it is written.

A row is cut into spans that some silhouette reaches and the rest.  The rest is the pinhole's line to the plane; a
span is cut into blocks of LANES pixels.  Where the scene has one sphere only, a block goes from pixel to plane
straight, otherwise by the rounds of ``tracer.kernels.chain``.  A finished block holds the plane point in columns
PX, PY (NaN: the ray does not go down) and the branch number in PICK.

Mirrors.  If nothing changes under x -> -x, pixel W - 1 - u sees (-x, y) where pixel u sees (x, y): rounding is the
same for both signs, so the bits are those of tracing it.  Then half of the columns are traced and
copied; the same for y -> -y and rows.  Bodies may change places: ``swap_x``, ``swap_y`` (2^N + 1,) int64 say which
branch number becomes which, the last one for UNKNOWN; none: all stay.

Every pixel has the same bits whatever block it stands in: all loops that calculate run over whole vectors.
"""

import math

from tracer.kernels._jit import Array, kernel, unowned
from tracer.kernels.chain import (
    ALL_BITS,
    BITS,
    COS_I,
    COS_T,
    DX,
    DY,
    DZ,
    IQ,
    LANES,
    NEAR,
    PICK,
    PX,
    PY,
    PZ,
    QQ,
    SKIP_SILHOUETTES,
    TRIP,
    UNKNOWN,
    begin_block,
    follow_block,
    foot_of,
    glass_span,
    insert_span,
    place_row,
    whole_vectors,
)
from tracer.kernels.march import MISSED_PLANE, RECOVERED


@kernel
def direct_block(x: Array, y: Array, camera: Array, rays: Array, trips: Array) -> None:
    """Trace a block (n,) that no glass touches."""
    ox, oy, oz = camera[0], camera[1], camera[2]
    c3, c4, c5, c6, c7, c8 = camera[3], camera[4], camera[5], camera[6], camera[7], camera[8]
    c9, c10, c11 = camera[9], camera[10], camera[11]
    for i in range(x.shape[0]):
        dx = c3 * x[i] + c6 * y[i] + c9
        dy = c4 * x[i] + c7 * y[i] + c10
        dz = c5 * x[i] + c8 * y[i] + c11
        t = -oz / dz
        tx, ty = ox + t * dx, oy + t * dy
        down = dz < 0.0
        rays[PX + i], rays[PY + i] = tx if down else math.nan, ty if down else math.nan
    for i in range(x.shape[0]):
        trips[PICK + i] = 0


@kernel
def lone_block(x: Array, y: Array, camera: Array, balls: Array, rays: Array, trips: Array) -> None:
    """Trace a block (n,) through the only sphere there is: what `begin_block`, `turn` and `land_block` calculate.

    In four passes: a chain of operations through to the plane is longer than the processor looks ahead, and the
    unit for roots would wait.
    """
    count = x.shape[0]
    ox, oy, oz = camera[0], camera[1], camera[2]
    c3, c4, c5, c6, c7, c8 = camera[3], camera[4], camera[5], camera[6], camera[7], camera[8]
    c9, c10, c11 = camera[9], camera[10], camera[11]
    cx, cy, cz, r2, ir2, kt = balls[0, 0], balls[0, 1], balls[0, 2], balls[0, 3], balls[0, 4], balls[0, 5]
    nu, gk, ir = balls[0, 6], balls[0, 7], balls[0, 8]
    wx, wy, wz = ox - cx, oy - cy, oz - cz
    for i in range(count):
        dx = c3 * x[i] + c6 * y[i] + c9
        dy = c4 * x[i] + c7 * y[i] + c10
        dz = c5 * x[i] + c8 * y[i] + c11
        square = dx * dx + dy * dy + dz * dz
        inverse = 1.0 / square
        m, ax, ay, az, b2 = foot_of(wx, wy, wz, dx, dy, dz, inverse)
        rays[DX + i], rays[DY + i], rays[DZ + i] = dx, dy, dz
        rays[PX + i], rays[PY + i], rays[PZ + i] = ax, ay, az
        rays[QQ + i], rays[IQ + i], rays[NEAR + i] = square, inverse, b2
        trips[PICK + i] = 1 if (b2 < r2) & (m > 0.0) else 0
    for i in range(count):
        b2, square = rays[NEAR + i], rays[QQ + i]
        rays[COS_I + i] = math.sqrt(max((r2 - b2) * ir2, 0.0) * square)
        rays[COS_T + i] = math.sqrt(max(1.0 - b2 * kt, 0.0) * square)
    for i in range(count):
        ax, ay, az = rays[PX + i], rays[PY + i], rays[PZ + i]
        dx, dy, dz = rays[DX + i], rays[DY + i], rays[DZ + i]
        square, inverse, b2 = rays[QQ + i], rays[IQ + i], rays[NEAR + i]
        cos_i, cos_t, hit = rays[COS_I + i], rays[COS_T + i], trips[PICK + i] != 0
        chi = b2 * ir2
        g = gk * square / (cos_t + cos_i * nu)
        gi = g * inverse
        cosine = 1.0 - 2.0 * chi * g * gi
        q = 2.0 * gi * (cos_i * cos_t + chi * nu * square) * ir
        along = b2 * q * inverse
        px, py, pz = cx + ax * cosine + dx * along, cy + ay * cosine + dy * along, cz + az * cosine + dz * along
        ex, ey, ez = dx * cosine - ax * q, dy * cosine - ay * q, dz * cosine - az * q
        px, py, pz = px if hit else ox, py if hit else oy, pz if hit else oz
        ex, ey, ez = ex if hit else dx, ey if hit else dy, ez if hit else dz
        rays[PX + i], rays[PY + i], rays[PZ + i] = px, py, pz
        rays[DX + i], rays[DY + i], rays[DZ + i] = ex, ey, ez
    land_block(count, rays)


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
def branch_number(trip: int, paired: bool, balls: Array) -> int:
    """Number of a trip, bit k for body k, if its bodies come in order; else UNKNOWN.

    `paired`: two of the same height have no order, because the mirror image would have the other.
    """
    if trip < 0:
        return UNKNOWN
    number, later = 0, ALL_BITS + 1
    while trip > 0:
        body = trip & ALL_BITS
        if body >= later or (paired and number and balls[body - 1, 2] == balls[later - 1, 2]):
            return UNKNOWN
        number |= 1 << (body - 1)
        later = body
        trip >>= BITS
    return number


@kernel
def number_block(count: int, paired: bool, balls: Array, trips: Array) -> int:
    """Turn the trips into branch numbers, in PICK; return how many are UNKNOWN."""
    others = 0
    for i in range(count):
        others += trips[TRIP + i] != trips[TRIP]
    number = branch_number(trips[TRIP], paired, balls)
    if others == 0:
        for i in range(count):
            trips[PICK + i] = number
        return count if number == UNKNOWN else 0
    known, unknown = trips[TRIP], 0
    for i in range(count):
        if trips[TRIP + i] != known:  # they come in long runs
            known = trips[TRIP + i]
            number = branch_number(known, paired, balls)
        unknown += number == UNKNOWN
        trips[PICK + i] = number
    return unknown


@kernel
def glass_block(
    x: Array,
    y: Array,
    low: int,
    count: int,
    skips: int,
    paired: bool,
    camera: Array,
    balls: Array,
    spans: Array,
    rays: Array,
    trips: Array,
    wanted: Array,
) -> int:
    """Trace `count` columns from `low` on; returns how many have no branch number."""
    full = whole_vectors(count)
    if balls.shape[0] == 1:
        lone_block(x[low : low + full], y[low : low + full], camera, balls, rays, trips)
        return 0
    begin_block(x[low : low + full], y[low : low + full], camera, rays, trips)
    follow_block(low, full, skips, balls, spans, rays, trips, wanted)
    land_block(full, rays)
    return number_block(count, paired, balls, trips)


@kernel
def write_block(count: int, rays: Array, trips: Array, point: Array, status: Array, branch: Array) -> None:
    """Write a block: point (2 n,) x and y in turn, status (n,), branch (n,)."""
    for i in range(count):
        point[2 * i], point[2 * i + 1] = rays[PX + i], rays[PY + i]
    for i in range(count):
        status[i] = RECOVERED if rays[PX + i] == rays[PX + i] else MISSED_PLANE
    for i in range(count):
        branch[i] = trips[PICK + i]


@kernel
def mirror_left_right(
    count: int, swap: Array, p: Array, s: Array, b: Array, point: Array, status: Array, branch: Array
) -> None:
    """Write what p (2 n,), s, b (n,) hold mirrored in x: the last pixel comes first."""
    last, most = count - 1, swap.shape[0] - 1
    for i in range(count):
        point[2 * i], point[2 * i + 1] = 0.0 - p[2 * (last - i)], p[2 * (last - i) + 1]
    for i in range(count):
        status[i] = s[last - i]
    if most < 0:
        for i in range(count):
            branch[i] = b[last - i]
    else:
        for i in range(count):
            branch[i] = swap[min(b[last - i], most)]


@kernel
def mirror_up_down(
    count: int, swap: Array, p: Array, s: Array, b: Array, point: Array, status: Array, branch: Array
) -> None:
    """Write what p (2 n,), s, b (n,) hold mirrored in y."""
    most = swap.shape[0] - 1
    for i in range(count):
        point[2 * i], point[2 * i + 1] = p[2 * i], 0.0 - p[2 * i + 1]
    for i in range(count):
        status[i] = s[i]
    if most < 0:
        for i in range(count):
            branch[i] = b[i]
    else:
        for i in range(count):
            branch[i] = swap[min(b[i], most)]


@kernel
def silhouettes(
    row: int, flat: bool, skips: int, camera: Array, balls: Array, x: Array, y: Array, width: int, spans: Array
) -> int:
    """Write each sphere's columns to spans[:N], joined ones to spans[N:]; return how many these are."""
    bodies = balls.shape[0]
    place_row(row, flat, camera, x, y)
    count = 0
    for k in range(bodies):
        low, high = glass_span(x[:width], y[:width], flat, camera, balls, k)
        if not skips & SKIP_SILHOUETTES:
            low, high = 0, width
        spans[k, 0], spans[k, 1] = low, high
        if low < high:
            count = insert_span(spans[bodies:], count, low, high)
    return count


@kernel
def flat_columns(flat: bool, camera: Array, x: Array) -> None:
    """Image coordinate x of all columns of an ideal camera, the same in every row."""
    focal, centre = camera[12], camera[13]
    if flat:
        for i in range(x.shape[0]):
            x[i] = (i - centre) / focal


@kernel
def sensor_rows(
    camera: Array,
    balls: Array,
    flat: bool,
    paired: bool,
    skips: int,
    mirror_x: bool,
    mirror_y: bool,
    swap_x: Array,
    swap_y: Array,
    first: int,
    last: int,
    x: Array,
    y: Array,
    spans: Array,
    wanted: Array,
    rays: Array,
    trips: Array,
    unknown: Array,
    point: Array,
    status: Array,
    branch: Array,
) -> None:
    """Trace rows first..last-1, and with `mirror_y` write those they are the mirror image of as well.

    Scratch: ``x``, ``y`` (W + VECTOR,), ``spans`` (2 N + 1, 2) and ``wanted`` (N,) int64, ``rays``, ``trips``.
    Outputs: ``unknown`` (H,) int64, pixels a row without a branch number, ``point`` (H, 2 W), ``status`` and
    ``branch`` (H, W).
    """
    camera, balls, x, y, spans, wanted = (
        unowned(camera),
        unowned(balls),
        unowned(x),
        unowned(y),
        unowned(spans),
        unowned(wanted),
    )
    rays, trips, point, status, branch = (
        unowned(rays),
        unowned(trips),
        unowned(point),
        unowned(status),
        unowned(branch),
    )
    swap_x, swap_y = unowned(swap_x), unowned(swap_y)
    height, width = status.shape
    bodies = balls.shape[0]
    flat_columns(flat, camera, x)
    joined = spans[bodies:]
    edge = (width + 1) // 2 if mirror_x else width
    for row in range(first, last):
        count = silhouettes(row, flat, skips, camera, balls, x, y, width, spans)
        other = height - 1 - row
        unknown[row] = 0
        low, j = 0, 0
        while low < edge:
            while j < count and joined[j, 1] <= low:
                j += 1
            inside = j < count and joined[j, 0] <= low
            stop = edge
            if j < count:
                stop = min(edge, joined[j, 1] if inside else joined[j, 0])
            high = min(low + LANES, stop)
            if inside:
                unknown[row] += glass_block(
                    x, y, low, high - low, skips, paired, camera, balls, spans, rays, trips, wanted
                )
            else:
                full = low + whole_vectors(high - low)
                direct_block(x[low:full], y[low:full], camera, rays, trips)
            p, s, b = point[row, 2 * low : 2 * high], status[row, low:high], branch[row, low:high]
            write_block(high - low, rays, trips, p, s, b)
            low = high
        p, s, b = point[row], status[row], branch[row]
        if mirror_x:
            n = width - edge  # a middle column is its own image
            mirror_left_right(n, swap_x, p[: 2 * n], s[:n], b[:n], p[2 * edge :], s[edge:], b[edge:])
        if mirror_y and other != row:
            mirror_up_down(width, swap_y, p, s, b, point[other], status[other], branch[other])
        if mirror_y:
            unknown[other] = unknown[row]
