"""Only where glass can be met: the spans of the rows, one after the other (``tracer.kernels.sensor``)."""

from tracer.kernels._jit import Array, kernel, unowned
from tracer.kernels.chain import LANES, SKIP_LEFT_BEHIND, SKIP_SILHOUETTES, VECTOR
from tracer.kernels.mirror import mirror_left_right, mirror_up_down
from tracer.kernels.sensor import flat_columns, glass_block, silhouettes, write_block


@kernel
def list_spans(
    camera: Array, balls: Array, flat: bool, first: int, last: int, x: Array, y: Array, found: Array, counts: Array
) -> None:
    """List the columns of rows first..last-1 in which glass can be met.

    Outputs: ``found`` (H, 2 N + 1, 2) int64, whose rows from N on hold the joined spans, ``counts`` (H,) of them.
    Scratch: ``x``, ``y`` (W + VECTOR,), `flat` ``y`` (1,).
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
