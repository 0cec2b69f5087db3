"""Parts of a sensor: only where glass can be met, only what a moved sphere touches (``tracer.kernels.sensor``)."""

from tracer.kernels._jit import Array, kernel, unowned
from tracer.kernels.chain import LANES, SKIP_LEFT_BEHIND, SKIP_SILHOUETTES, VECTOR, glass_span, insert_span
from tracer.kernels.sensor import (
    flat_columns,
    glass_block,
    mirror_left_right,
    mirror_up_down,
    silhouettes,
    write_block,
)


@kernel
def list_spans(
    camera: Array, balls: Array, flat: bool, first: int, last: int, x: Array, y: Array, found: Array, counts: Array
) -> None:
    """List the columns of rows first..last-1 in which glass can be met.

    Outputs: ``found`` (H, 2 N + 1, 2) int64, whose rows from N on hold the joined spans, ``counts`` (H,) of them.
    Scratch: ``x``, ``y`` (W + VECTOR,).
    """
    camera, balls, x, y, found = unowned(camera), unowned(balls), unowned(x), unowned(y), unowned(found)
    flat_columns(flat, camera, x)
    for row in range(first, last):
        width = x.shape[0] - VECTOR
        counts[row] = silhouettes(row, flat, SKIP_SILHOUETTES, camera, balls, x, y, width, found[row])


@kernel
def trace_runs(
    camera: Array,
    balls: Array,
    flat: bool,
    paired: bool,
    mirror_x: bool,
    swap_x: Array,
    swap_y: Array,
    width: int,
    runs: Array,
    twins: Array,
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
    """Trace runs first..last-1 (R, 4) int64: row, columns from and to, and where they go in the flat outputs.

    ``twins`` (R,) int64: the run that is the mirror image in y and is written with this one, or -1.
    Outputs: ``unknown`` (R,) int64, pixels a run without a branch number, ``point`` (2 P,), ``status`` and
    ``branch`` (P,).  The pixels have the bits that `sensor_rows` gives them.
    """
    camera, balls, runs, x, y = unowned(camera), unowned(balls), unowned(runs), unowned(x), unowned(y)
    spans, wanted, rays, trips = unowned(spans), unowned(wanted), unowned(rays), unowned(trips)
    point, status, branch = unowned(point), unowned(status), unowned(branch)
    swap_x, swap_y = unowned(swap_x), unowned(swap_y)
    flat_columns(flat, camera, x)
    placed, skips = -1, SKIP_SILHOUETTES | SKIP_LEFT_BEHIND
    for r in range(first, last):
        row, low, high, at = runs[r, 0], runs[r, 1], runs[r, 2], runs[r, 3]
        count = high - low
        p, s, b = point[2 * at : 2 * (at + count)], status[at : at + count], branch[at : at + count]
        if row != placed:
            silhouettes(row, flat, skips, camera, balls, x, y, width, spans)
            placed = row
        unknown[r] = 0
        half = (count + 1) // 2 if mirror_x and low + high == width else count
        done = 0
        while done < half:
            n = min(LANES, half - done)
            unknown[r] += glass_block(
                x, y, low + done, n, skips, paired, camera, balls, spans, rays, trips, wanted
            )
            write_block(n, rays, trips, p[2 * done : 2 * (done + n)], s[done : done + n], b[done : done + n])
            done += n
        if half < count:
            n = count - half
            mirror_left_right(n, swap_x, p[: 2 * n], s[:n], b[:n], p[2 * half :], s[half:], b[half:])
        twin = twins[r]
        if twin >= 0:
            at = runs[twin, 3]
            q = point[2 * at : 2 * (at + count)]
            mirror_up_down(count, swap_y, p, s, b, q, status[at : at + count], branch[at : at + count])


@kernel
def mark_near(
    point: Array, cx: float, cy: float, cz: float, wx: float, wy: float, wz: float, reach: float, mark: Array
) -> None:
    """Mark the plane points (2 n,) whose line to c passes c + w at less than `reach`."""
    limit = 1.0000001 * reach * reach
    for i in range(mark.shape[0]):
        vx, vy, vz = point[2 * i] - cx, point[2 * i + 1] - cy, -cz
        t = (wx * vx + wy * vy + wz * vz) / (vx * vx + vy * vy + vz * vz)
        t = max(0.0, min(1.0, t))
        ux, uy, uz = wx - t * vx, wy - t * vy, wz - t * vz
        far = ux * ux + uy * uy + uz * uz > limit  # never for NaN: that ray goes anywhere
        mark[i] = mark[i] if far else 1


@kernel
def mark_touched(
    low: int, high: int, moved: Array, balls: Array, legs: Array, point: Array, branch: Array, mark: Array
) -> None:
    """Mark the pixels low..high-1 of a row of an earlier map whose rays a moved sphere may have touched.

    ``moved`` (M,) int64 numbers of the spheres in ``balls``, where they are now; ``legs`` (branches, 5) what is
    known of each branch: 0 clear, 1 touched, 2 look; centre and radius of the last sphere left.  The last leg of a
    ray runs inside the hull of that sphere and the plane point.
    """
    while low < high:
        b, end = branch[low], low + 1
        while end < high and branch[end] == b:  # they come in long runs
            end += 1
        if legs[b, 0] == 1.0:
            mark[low:end] = 1
        elif legs[b, 0] == 2.0:
            cx, cy, cz = legs[b, 1], legs[b, 2], legs[b, 3]
            for k in moved:
                reach = legs[b, 4] + 1.0 / balls[k, 8]
                wx, wy, wz = balls[k, 0] - cx, balls[k, 1] - cy, balls[k, 2] - cz
                mark_near(point[2 * low : 2 * end], cx, cy, cz, wx, wy, wz, reach, mark[low:end])
        low = end


@kernel
def retrace_rows(
    camera: Array,
    old: Array,
    balls: Array,
    flat: bool,
    paired: bool,
    moved: Array,
    legs: Array,
    first: int,
    last: int,
    mark: Array,
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
    """Trace again what moved spheres touch in rows first..last-1 of the map of the spheres ``old``.

    Arguments as `sensor_rows` and `mark_touched`; ``mark`` (W,) uint8 is scratch.
    """
    camera, old, balls, moved, legs = unowned(camera), unowned(old), unowned(balls), unowned(moved), unowned(legs)
    mark, x, y, spans, wanted = unowned(mark), unowned(x), unowned(y), unowned(spans), unowned(wanted)
    rays, trips = unowned(rays), unowned(trips)
    point, status, branch = unowned(point), unowned(status), unowned(branch)
    width, bodies = status.shape[1], balls.shape[0]
    skips = SKIP_SILHOUETTES | SKIP_LEFT_BEHIND
    flat_columns(flat, camera, x)
    for row in range(first, last):
        unknown[row] = 0
        mark[:] = 0
        low, end = width, 0
        p, s, b = point[row], status[row], branch[row]
        count = silhouettes(row, flat, skips, camera, balls, x, y, width, spans)
        for k in moved:
            from_here, to_here = glass_span(x[:width], y[:width], flat, camera, old, k)
            if from_here < to_here:
                count = insert_span(spans[bodies:], count, from_here, to_here)
        for j in range(count):
            low, end = min(low, spans[bodies + j, 0]), max(end, spans[bodies + j, 1])
            mark_touched(spans[bodies + j, 0], spans[bodies + j, 1], moved, balls, legs, p, b, mark)
        for k in moved:
            mark[spans[k, 0] : spans[k, 1]] = 1
        while low < end:
            if mark[low] == 0:
                low += 1
                continue
            high, seen = low + 1, low + 1
            while high < end and high - seen < VECTOR:  # a gap shorter than a vector costs nothing
                high += 1
                if mark[high - 1]:
                    seen = high
            while low < seen:
                n = min(LANES, seen - low)
                unknown[row] += glass_block(x, y, low, n, skips, paired, camera, balls, spans, rays, trips, wanted)
                write_block(n, rays, trips, p[2 * low : 2 * (low + n)], s[low : low + n], b[low : low + n])
                low += n
