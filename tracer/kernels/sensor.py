"""Rows of the sensor, block by block: which columns meet glass, how each block is traced, where it is written.

A row is cut into spans that some silhouette reaches and the rest.  The rest is the pinhole's line to the plane; a
span is cut into blocks of LANES pixels.  Where the scene has one sphere only, a block goes from pixel to plane
straight as well, otherwise by the rounds of ``tracer.kernels.chain``: it then holds the plane point in columns PX,
PY (NaN: the ray does not go down) and the branch number in PICK.

Every pixel has the same bits whatever block it stands in: all loops that calculate run over whole vectors.

Of scenes that are their own mirror image half or a quarter is traced, the rest copied.  If nothing changes under x
-> -x, pixel W - 1 - u sees (-x, y) where pixel u sees (x, y): rounding is the same for both signs, so the bits are
those of tracing it.  Then half of the columns are traced and copied; the same for y -> -y and rows.  Bodies may
change places: ``swap`` (2^N + 1,) int64 says which branch number becomes which, the last one for UNKNOWN; empty:
all stay.
"""

from typing import NamedTuple

from ground.jit import Array, kernel
from tracer.kernels.branches import UNKNOWN, branch_number
from tracer.kernels.camera import CENTRE_U, FOCAL
from tracer.kernels.chain import (
    LANES,
    PICK,
    PX,
    PY,
    SKIP_SILHOUETTES,
    TRIP,
    VECTOR,
    begin_block,
    direct_block,
    follow_block,
    glass_span,
    insert_span,
    land_block,
    lone_block,
    place_row,
    whole_vectors,
)
from tracer.kernels.world import MISSED_PLANE, RECOVERED


class Mirrors(NamedTuple):
    """Mirror images that a scene is of itself, and which branch number becomes which."""

    in_x: bool
    in_y: bool
    swap_x: Array
    swap_y: Array


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


class RowScratch(NamedTuple):
    """Memory of one thread: ``x``, ``y`` (W + VECTOR,), ``spans`` (3 N + 1, 2), ``wanted`` (N,), a block's."""

    x: Array
    y: Array
    spans: Array
    wanted: Array
    rays: Array
    trips: Array


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
def straight_span(
    inside: bool, x: Array, y: Array, camera: Array, balls: Array, rays: Array, trips: Array, point: Array,
    status: Array, branch: Array,
) -> None:  # fmt: skip
    """Trace and write a span that no glass touches, or if `inside` one through the only sphere.

    Its last pixels, no whole vector, go by way of scratch.
    """
    count = status.shape[0]
    whole = count // VECTOR * VECTOR
    last = slice(whole, whole + VECTOR if whole < count else whole)
    if inside:
        up = lone_block(x[:whole], y[:whole], camera, balls, point, branch)
        up += lone_block(x[last], y[last], camera, balls, rays, trips)
        for i in range(whole, count):
            branch[i] = trips[i - whole]
    else:
        up = direct_block(x[:whole], y[:whole], camera, point)
        up += direct_block(x[last], y[last], camera, rays)
        branch[:] = 0
    for i in range(2 * (count - whole)):
        point[2 * whole + i] = rays[i]
    status[:] = RECOVERED
    if up > 0:
        for i in range(count):
            status[i] = RECOVERED if point[2 * i] == point[2 * i] else MISSED_PLANE


@kernel
def silhouettes(
    flat: bool, skips: int, camera: Array, balls: Array, x: Array, y: Array, width: int, spans: Array
) -> int:
    """Write each sphere's columns of a row to spans[:N], joined ones to spans[N:]; return how many these are."""
    bodies = balls.shape[0]
    count = 0
    for k in range(bodies):
        low, high = 0, width
        if skips & SKIP_SILHOUETTES:
            low, high = glass_span(x[:width], y[:width], flat, camera, balls, k)
        spans[k, 0], spans[k, 1] = low, high
        if low < high:
            count = insert_span(spans[bodies:], count, low, high)
    return count


@kernel
def flat_columns(flat: bool, camera: Array, x: Array) -> None:
    """Image coordinate x of all columns of an ideal camera, the same in every row."""
    focal, centre = camera[FOCAL], camera[CENTRE_U]
    if flat:
        for i in range(x.shape[0]):
            x[i] = (i - centre) / focal


@kernel
def next_span(low: int, edge: int, joined: Array, count: int, j: int) -> tuple[int, bool, int]:
    """From column `low` of a row on: the span at or behind it, whether it is inside, where span or gap ends."""
    while j < count and joined[j, 1] <= low:
        j += 1
    inside = j < count and joined[j, 0] <= low
    stop = edge
    if j < count:
        stop = min(edge, joined[j, 1] if inside else joined[j, 0])
    return j, inside, stop


@kernel
def write_mirrored(
    row: int, edge: int, mirror_x: bool, mirror_y: bool, swap_x: Array, swap_y: Array,
    unknown: Array, point: Array, status: Array, branch: Array,
) -> None:  # fmt: skip
    """Complete a row that was traced up to column `edge`, and write the row that is its mirror image."""
    height, width = status.shape
    other = height - 1 - row
    p, s, b = point[row], status[row], branch[row]
    if mirror_x:
        n = width - edge  # a middle column is its own image
        mirror_left_right(n, swap_x, p[: 2 * n], s[:n], b[:n], p[2 * edge :], s[edge:], b[edge:])
    if mirror_y and other != row:
        mirror_up_down(width, swap_y, p, s, b, point[other], status[other], branch[other])
    if mirror_y:
        unknown[other] = unknown[row]


@kernel
def sensor_rows(
    camera: Array,
    balls: Array,
    flat: bool,
    paired: bool,
    skips: int,
    mirrors: Mirrors,
    first: int,
    last: int,
    scratch: RowScratch,
    unknown: Array,
    point: Array,
    status: Array,
    branch: Array,
) -> None:
    """Trace rows first..last-1, and with ``mirrors.in_y`` write those they are the mirror image of as well.

    Outputs: ``unknown`` (H,) int64, pixels a row without a branch number, ``point`` (H, 2 W), ``status`` and
    ``branch`` (H, W).
    """
    x, y, spans, wanted = scratch.x, scratch.y, scratch.spans, scratch.wanted
    rays, trips = scratch.rays, scratch.trips
    mirror_x, mirror_y = mirrors.in_x, mirrors.in_y
    swap_x, swap_y = mirrors.swap_x, mirrors.swap_y
    width = status.shape[1]
    bodies = balls.shape[0]
    flat_columns(flat, camera, x)
    joined = spans[bodies:]
    edge = (width + 1) // 2 if mirror_x else width
    for row in range(first, last):
        place_row(row, flat, camera, x, y)
        count = silhouettes(flat, skips, camera, balls, x, y, width, spans)
        unknown[row] = 0
        low, j = 0, 0
        while low < edge:
            j, inside, high = next_span(low, edge, joined, count, j)
            through = inside and bodies > 1
            high = min(high, low + LANES) if through else high
            p, s, b = point[row, 2 * low : 2 * high], status[row, low:high], branch[row, low:high]
            if through:
                unknown[row] += glass_block(
                    x, y, low, high - low, skips, paired, camera, balls, spans, rays, trips, wanted
                )
                write_block(high - low, rays, trips, p, s, b)
            else:
                straight_span(inside, x[low:], y[low:], camera, balls, rays, trips, p, s, b)
            low = high
        write_mirrored(row, edge, mirror_x, mirror_y, swap_x, swap_y, unknown, point, status, branch)
