"""Rows of the sensor, block by block: which columns meet glass, how each block is traced, where it is written.

A row is cut into spans that some silhouette reaches and the rest.  The rest is the pinhole's line to the plane; a
span is cut into blocks of LANES pixels.  Where the scene has one sphere only, or every ray meets one sphere and
nothing behind it (`lone_spans`, one interval a row and sphere), a block goes from pixel to plane straight as well,
otherwise by the rounds of ``tracer.kernels.chain``: it then holds the plane point in columns PX, PY (NaN: the ray
does not go down) and the branch number in PICK.

Every pixel has the same bits whatever block it stands in: all loops that calculate run over whole vectors.

Of scenes that are their own mirror image half or a quarter is traced, the rest copied.  If nothing changes under x
-> -x, pixel W - 1 - u sees (-x, y) where pixel u sees (x, y): rounding is the same for both signs, so the bits are
those of tracing it.  Then half of the columns are traced and copied; the same for y -> -y and rows.  Bodies may
change places: ``swap`` (2^N + 1,) int64 says which branch number becomes which, the last one for UNKNOWN; empty:
all stay.
"""

from typing import NamedTuple

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.branches import NOTHING, UNKNOWN, branch_number
from tracer.kernels.camera import CENTRE_U, FOCAL, axes_of
from tracer.kernels.chain import (
    PICK,
    SKIP_LONE,
    SKIP_SILHOUETTES,
    TRIP,
    begin_block,
    direct_block,
    follow_block,
    glass_span,
    image_ray,
    insert_span,
    place_row,
    single_block,
)
from tracer.kernels.packets import LANES, PX, STEP, VECTOR, hit_plane, whole_vectors
from tracer.kernels.vectors import dot, subtract, vector_at
from tracer.kernels.world import MISSED_PLANE, RECOVERED

SLACK = 3  # columns that `glass_span` may give too many, each way, and one more
FRONT_MM = 1e-6  # by which foot points differ at least: far above rounding, far below any gap


class Mirrors(NamedTuple):
    """Mirror images that a scene is of itself, and which branch number becomes which."""

    in_x: bool
    in_y: bool
    swap_x: Array
    swap_y: Array


class MapArrays(NamedTuple):
    """Map of a sensor: plane points (H, 2 W), status and branch numbers (H, W), or of a part of one row."""

    point: Array
    status: Array
    branch: Array


class RowOptions(NamedTuple):
    """Properties of the scene: no lens terms; spheres in pairs of one height; and what may be skipped."""

    flat: bool
    paired: bool
    skips: int


@kernel_inlined
def part_of_row(out: MapArrays, row: int, low: int, high: int) -> MapArrays:
    """Columns [low, high) of a row."""
    return MapArrays(out.point[row, 2 * low : 2 * high], out.status[row, low:high], out.branch[row, low:high])


@kernel
def mirror_row(count: int, in_x: bool, swap: Array, source: MapArrays, out: MapArrays) -> None:
    """Write `count` pixels mirrored in x, the last one first, or in y; ``swap`` are the branch numbers there."""
    most, last = swap.shape[0] - 1, count - 1
    for i in range(count):
        k = last - i if in_x else i
        x, y = source.point[2 * k], source.point[2 * k + 1]
        out.point[2 * i], out.point[2 * i + 1] = 0.0 - x if in_x else x, y if in_x else 0.0 - y
    for i in range(count):
        out.status[i] = source.status[last - i if in_x else i]
    for i in range(count):
        number = source.branch[last - i if in_x else i]
        out.branch[i] = number if most < 0 else swap[min(number, most)]


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
    low: int, count: int, options: RowOptions, camera: Array, balls: Array, scratch: RowScratch
) -> int:
    """Trace `count` columns from `low` on; returns how many have no branch number."""
    full = whole_vectors(count)
    y = scratch.y[:1] if options.flat else scratch.y[low:]
    begin_block(scratch.x[low : low + full], y, camera, scratch.rays, scratch.trips)
    follow_block(low, full, options.skips, balls, scratch.spans, scratch.rays, scratch.trips, scratch.wanted)
    hit_plane(full, scratch.rays)
    return number_block(count, options.paired, balls, scratch.trips)


@kernel
def write_block(count: int, rays: Array, trips: Array, out: MapArrays) -> None:
    """Write a block."""
    point, status, branch = out
    for i in range(count):
        point[2 * i], point[2 * i + 1] = rays[PX + i], rays[PX + STEP + i]
    for i in range(count):
        status[i] = RECOVERED if rays[PX + i] == rays[PX + i] else MISSED_PLANE
    for i in range(count):
        branch[i] = trips[PICK + i]


@kernel
def straight_span(
    alone: int, flat: bool, low: int, camera: Array, balls: Array, scratch: RowScratch, out: MapArrays
) -> None:
    """Trace and write a span from column `low` on, through the sphere `alone`, or straight if that is NOTHING.

    Its last pixels, no whole vector, go by way of scratch.
    """
    (point, status, branch), rays, trips = out, scratch.rays, scratch.trips
    count = status.shape[0]
    whole = count // VECTOR * VECTOR
    more = VECTOR if whole < count else 0
    x, y = scratch.x[low : low + whole], scratch.y[:1] if flat else scratch.y[low:]
    low += whole
    last_x, last_y = scratch.x[low : low + more], scratch.y[:1] if flat else scratch.y[low:]
    if alone >= 0:
        up = single_block(x, y, camera, balls, alone, point, branch)
        up += single_block(last_x, last_y, camera, balls, alone, rays, trips)
        for i in range(whole, count):
            branch[i] = trips[i - whole]
    else:
        up = direct_block(x, y, camera, point)
        up += direct_block(last_x, last_y, camera, rays)
        branch[:] = 0
    for i in range(2 * (count - whole)):
        point[2 * whole + i] = rays[i]
    status[:] = RECOVERED
    if up > 0:
        for i in range(count):
            status[i] = RECOVERED if point[2 * i] == point[2 * i] else MISSED_PLANE


@kernel
def silhouettes(options: RowOptions, camera: Array, balls: Array, width: int, scratch: RowScratch) -> int:
    """Write each sphere's columns of a row to spans[:N], joined ones to spans[N:]; return how many these are."""
    bodies, spans, count = balls.shape[0], scratch.spans, 0
    for k in range(bodies):
        low, high = 0, width
        if options.skips & SKIP_SILHOUETTES:
            low, high = glass_span(scratch.x[:width], scratch.y[:width], options.flat, camera, balls, k)
        spans[k, 0], spans[k, 1] = low, high
        if low < high:
            count = insert_span(spans[bodies:], count, low, high)
    return count


@kernel
def lone_spans(
    options: RowOptions, camera: Array, balls: Array, discs: Array, width: int, scratch: RowScratch
) -> None:
    """Write to spans[2 N:] the columns of a row in which rays meet sphere k first and no other one behind it.

    They lie within its disc (`lone_discs`) and outside the silhouettes of those that may stand before it.
    """
    bodies, spans, x, y = balls.shape[0], scratch.spans, scratch.x[:width], scratch.y[:width]
    if bodies == 1:
        spans[2, 0], spans[2, 1] = spans[0, 0], spans[0, 1]
        return
    for k in range(bodies):
        low, high = 0, 0
        if options.flat and options.skips & SKIP_LONE:
            low, high = glass_span(x, y, True, camera, discs, k)
        low, high = low + SLACK, high - SLACK
        for j in range(bodies):
            first, last = spans[j, 0], spans[j, 1]
            if j != k and low < high and first < high and last > low:
                apart, axes = subtract(vector_at(balls[j], 0), vector_at(balls[k], 0)), axes_of(camera)
                one, other = image_ray(x[low], y[0], axes), image_ray(x[high - 1], y[0], axes)
                if not min(dot(apart, one), dot(apart, other)) > FRONT_MM:
                    # Somewhere j's foot point is the nearer one: the longer part beside its silhouette is left
                    low, high = (low, first) if first - low > high - last else (last, high)
        spans[2 * bodies + k, 0], spans[2 * bodies + k, 1] = (low, high) if low < high else (0, 0)


@kernel
def lone_at(low: int, high: int, lone: Array) -> tuple[int, int]:
    """Sphere whose lone columns (N, 2) begin at or before `low`, or NOTHING; and where these, or others, end."""
    alone = NOTHING
    for k in range(lone.shape[0]):
        if lone[k, 0] <= low < lone[k, 1]:
            alone, high = k, min(high, lone[k, 1])
        elif low < lone[k, 0]:
            high = min(high, lone[k, 0])
    return alone, high


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
def write_mirrored(row: int, edge: int, mirrors: Mirrors, unknown: Array, out: MapArrays) -> None:
    """Complete a row that was traced up to column `edge`, and write the row that is its mirror image."""
    height, width = out.status.shape
    other = height - 1 - row
    if mirrors.in_x:
        n = width - edge  # a middle column is its own image
        mirror_row(n, True, mirrors.swap_x, part_of_row(out, row, 0, n), part_of_row(out, row, edge, width))
    if mirrors.in_y and other != row:
        source, image = part_of_row(out, row, 0, width), part_of_row(out, other, 0, width)
        mirror_row(width, False, mirrors.swap_y, source, image)
    if mirrors.in_y:
        unknown[other] = unknown[row]


@kernel
def sensor_rows(
    optics: tuple[Array, Array, Array], options: RowOptions, mirrors: Mirrors, first: int, last: int,
    scratch: RowScratch, unknown: Array, out: MapArrays,
) -> None:  # fmt: skip
    """Trace rows first..last-1, and with ``mirrors.in_y`` write those they are the mirror image of as well.

    `optics` are camera, balls and these with the R^2 of `lone_discs`; ``unknown`` (H,) int64 receives the pixels
    a row without a branch number.
    """
    camera, balls, discs = optics
    width, bodies = out.status.shape[1], balls.shape[0]
    flat_columns(options.flat, camera, scratch.x)
    edge = (width + 1) // 2 if mirrors.in_x else width
    for row in range(first, last):
        place_row(row, options.flat, camera, scratch.x, scratch.y[:1] if options.flat else scratch.y)
        count = silhouettes(options, camera, balls, width, scratch)
        lone_spans(options, camera, balls, discs, width, scratch)
        unknown[row] = 0
        low, j = 0, 0
        while low < edge:
            j, inside, high = next_span(low, edge, scratch.spans[bodies:], count, j)
            alone = NOTHING
            if inside:
                alone, high = lone_at(low, high, scratch.spans[2 * bodies : 3 * bodies])
            through = inside and alone == NOTHING
            high = min(high, low + LANES) if through else high
            part = part_of_row(out, row, low, high)
            if through:
                unknown[row] += glass_block(low, high - low, options, camera, balls, scratch)
                write_block(high - low, scratch.rays, scratch.trips, part)
            else:
                straight_span(alone, options.flat, low, camera, balls, scratch, part)
            low = high
        write_mirrored(row, edge, mirrors, unknown, out)
