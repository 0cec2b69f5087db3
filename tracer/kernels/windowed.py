"""Many neighbouring rays at once through windows in front of a few spheres.

A window before everything is a pass of its own over the block (``tracer.kernels.chain``).  Its faces are parallel:
with unit normal N towards the camera, m = -D . N, Q = |D|^2, indices n of the glass and n' of what lies behind (of
what lies before: 1), and

    w = sqrt((n^2 - 1) Q + m^2),   w' = sqrt((n'^2 - 1) Q + m^2),

a ray that begins at height h above the plate of thickness T goes on behind it along

    D' = D + (m - w') N,   |D'|^2 = n'^2 Q,   through   P' = P + (w' h/m + w' T/w - h - T) N,

which lies before the plate: nothing that stands behind it is met too early.  Between equal media w' = m, D' = D.

What spheres a block can meet first, and which pixels look past them all, is known from where they seem to stand
(``tracer.kernels.apparent``), and so is whether all rays of a block pass the openings.  Other blocks go to the
back of each window with care: a ray that looks past its plane, is totally reflected, or reaches the plane in
between gets no branch number, and is traced again by `trace_ray`, which knows it all.  What would end in front of
the back of the last window meets that wall: it closes its room.

Mirror images are copied as in ``tracer.kernels.sensor``.
"""

import math
from typing import NamedTuple

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.apparent import all_open, image_box, seem
from tracer.kernels.branches import UNKNOWN
from tracer.kernels.camera import EYE_X, EYE_Y, EYE_Z, axes_of
from tracer.kernels.chain import (
    DX,
    DY,
    DZ,
    IQ,
    LANES,
    PICK,
    PX,
    PY,
    PZ,
    QQ,
    begin_block,
    follow_block,
    land_block,
    place_row,
    whole_vectors,
)
from tracer.kernels.sensor import (
    Mirrors,
    RowScratch,
    flat_columns,
    next_span,
    number_block,
    silhouettes,
    write_block,
    write_mirrored,
)
from tracer.kernels.window import BEHIND, GLASS, OPENING, THICKNESS
from tracer.kernels.world import BLOCKED

OPEN, SHUT, UNUSUAL = 0, 1, 2


class WindowScratch(NamedTuple):
    """Memory of one thread beside `RowScratch`: ``fates`` of a block, ``box`` (4,), and what `seem` writes."""

    fates: Array
    box: Array
    faces: Array
    discs: Array


@kernel_inlined
def through_window(count: int, row: Array, rays: Array) -> None:
    """Take a block whose rays all come through to behind a window."""
    ox, oy, oz, nx, ny, nz = row[0], row[1], row[2], row[3], row[4], row[5]
    thickness, gain, behind = row[THICKNESS], (row[GLASS] - 1.0) * (row[GLASS] + 1.0), row[BEHIND]
    if behind == 1.0:
        for i in range(count):
            m = -(rays[DX + i] * nx + rays[DY + i] * ny + rays[DZ + i] * nz)
            moved = thickness * (m / math.sqrt(gain * rays[QQ + i] + m * m)) - thickness
            rays[PX + i] += moved * nx
            rays[PY + i] += moved * ny
            rays[PZ + i] += moved * nz
        return
    gain_behind, square, inverse = (behind - 1.0) * (behind + 1.0), behind * behind, 1.0 / (behind * behind)
    for i in range(count):
        dx, dy, dz, q = rays[DX + i], rays[DY + i], rays[DZ + i], rays[QQ + i]
        px, py, pz = rays[PX + i], rays[PY + i], rays[PZ + i]
        m = -(dx * nx + dy * ny + dz * nz)
        h = (px - ox) * nx + (py - oy) * ny + (pz - oz) * nz
        w, w_behind = math.sqrt(gain * q + m * m), math.sqrt(gain_behind * q + m * m)
        moved, turned = (h * w + thickness * m) / (m * w) * w_behind - h - thickness, m - w_behind
        rays[PX + i], rays[PY + i], rays[PZ + i] = px + moved * nx, py + moved * ny, pz + moved * nz
        rays[DX + i], rays[DY + i], rays[DZ + i] = dx + turned * nx, dy + turned * ny, dz + turned * nz
        rays[QQ + i] = square * q
        rays[IQ + i] *= inverse


@kernel
def direct_through(x: Array, y: Array, camera: Array, row: Array, rays: Array, trips: Array) -> None:
    """Trace a block (n,) through one window and by no sphere: `through_window` and `land_block` in one.

    All that it divides by is one product.
    """
    ox, oy, oz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    nx, ny, nz, thickness, behind = row[3], row[4], row[5], row[THICKNESS], row[BEHIND]
    gain, gain_behind = (row[GLASS] - 1.0) * (row[GLASS] + 1.0), (behind - 1.0) * (behind + 1.0)
    h = (ox - row[0]) * nx + (oy - row[1]) * ny + (oz - row[2]) * nz
    if behind == 1.0:
        for i in range(x.shape[0]):
            dx, dy, dz = c3 * x[i] + c6 * y[i] + c9, c4 * x[i] + c7 * y[i] + c10, c5 * x[i] + c8 * y[i] + c11
            m = -(dx * nx + dy * ny + dz * nz)
            w = math.sqrt(gain * (dx * dx + dy * dy + dz * dz) + m * m)
            r = 1.0 / (w * dz)
            moved = thickness * (m * dz * r) - thickness
            t = -(oz + moved * nz) * (w * r)
            tx, ty = ox + moved * nx + t * dx, oy + moved * ny + t * dy
            down = dz < 0.0
            rays[PX + i], rays[PY + i] = tx if down else math.nan, ty if down else math.nan
    else:
        for i in range(x.shape[0]):
            dx, dy, dz = c3 * x[i] + c6 * y[i] + c9, c4 * x[i] + c7 * y[i] + c10, c5 * x[i] + c8 * y[i] + c11
            m = -(dx * nx + dy * ny + dz * nz)
            q = dx * dx + dy * dy + dz * dz
            w, w_behind = math.sqrt(gain * q + m * m), math.sqrt(gain_behind * q + m * m)
            turned = m - w_behind
            dx, dy, dz = dx + turned * nx, dy + turned * ny, dz + turned * nz
            r = 1.0 / (m * w * dz)
            moved = (h * w + thickness * m) * (r * dz) * w_behind - h - thickness
            t = -(oz + moved * nz) * (m * w * r)
            tx, ty = ox + moved * nx + t * dx, oy + moved * ny + t * dy
            down = dz < 0.0
            rays[PX + i], rays[PY + i] = tx if down else math.nan, ty if down else math.nan
    for i in range(x.shape[0]):
        trips[PICK + i] = 0


@kernel_inlined
def through_window_carefully(count: int, row: Array, rays: Array, fates: Array) -> None:
    """Take a block through a window; `fates` (n,) becomes SHUT or UNUSUAL where a ray does not go on."""
    ox, oy, oz, nx, ny, nz = row[0], row[1], row[2], row[3], row[4], row[5]
    thickness, opening2 = row[THICKNESS], row[OPENING] * row[OPENING]
    e1, e2 = 1.0 / row[GLASS], row[GLASS] / row[BEHIND]
    gain1, gain2 = (e1 - 1.0) * (e1 + 1.0), (e2 - 1.0) * (e2 + 1.0)
    for i in range(count):
        scale = 1.0 / math.sqrt(rays[QQ + i])
        dx, dy, dz = scale * rays[DX + i], scale * rays[DY + i], scale * rays[DZ + i]
        px, py, pz = rays[PX + i], rays[PY + i], rays[PZ + i]
        c1 = -(dx * nx + dy * ny + dz * nz)
        t = ((px - ox) * nx + (py - oy) * ny + (pz - oz) * nz) / c1
        qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
        wx, wy, wz = qx - ox, qy - oy, qz - oz
        off2 = wx * wx + wy * wy + wz * wz
        square1 = 1.0 - e1 * e1 * (1.0 - c1 * c1)
        c2 = math.sqrt(max(square1, 0.0))
        k = gain1 / (e1 * c1 + c2)
        ex, ey, ez = e1 * dx + k * nx, e1 * dy + k * ny, e1 * dz + k * nz
        s = thickness / c2
        bx, by, bz = qx + s * ex, qy + s * ey, qz + s * ez
        wx, wy, wz = bx - ox, by - oy, bz - oz
        back2 = wx * wx + wy * wy + wz * wz - thickness * thickness
        square2 = 1.0 - e2 * e2 * (1.0 - c2 * c2)
        k = gain2 / (e2 * c2 + math.sqrt(max(square2, 0.0)))
        fx, fy, fz = e2 * ex + k * nx, e2 * ey + k * ny, e2 * ez + k * nz
        usual = (c1 > 0.0) & (t > 0.0) & (qz > 0.0) & (bz > 0.0) & (square1 > 0.0) & (square2 > 0.0)
        is_open = (off2 < opening2) & (back2 < opening2)
        fate = fates[i]
        now = (OPEN if is_open else SHUT) if usual else UNUSUAL
        fates[i] = now if fate == OPEN else fate
        goes = usual & is_open & (fate == OPEN)
        square = fx * fx + fy * fy + fz * fz
        px, py, pz = bx if goes else px, by if goes else py, bz if goes else pz
        dx, dy, dz = fx if goes else dx, fy if goes else dy, fz if goes else dz
        square = square if goes else 1.0
        rays[PX + i], rays[PY + i], rays[PZ + i] = px, py, pz
        rays[DX + i], rays[DY + i], rays[DZ + i] = dx, dy, dz
        rays[QQ + i], rays[IQ + i] = square, 1.0 / square


@kernel
def around(flat: bool, x: Array, y: Array, low: int, high: int, box: Array) -> None:
    """Box (4,) of the columns [low, high) of a row; see `image_box`."""
    if flat:
        box[0], box[1], box[2], box[3] = x[low], x[high - 1], y[0], y[0]
    else:
        image_box(x[low:high], y[low:high], box)


@kernel
def glass_behind(
    x: Array, y: Array, low: int, count: int, skips: int, paired: bool, careful: bool, camera: Array, balls: Array,
    windows: Array, scratch: RowScratch, fates: Array,
) -> None:  # fmt: skip
    """Trace `count` columns from `low` on through windows and spheres; `careful` ones get ``fates``."""
    spans, rays, trips, wanted = scratch.spans, scratch.rays, scratch.trips, scratch.wanted
    full = whole_vectors(count)
    begin_block(x[low : low + full], y[low : low + full], camera, rays, trips)
    if careful:
        for i in range(full):
            fates[i] = OPEN
        for k in range(windows.shape[0]):
            through_window_carefully(full, windows[k], rays, fates)
    else:
        for k in range(windows.shape[0]):
            through_window(full, windows[k], rays)
    follow_block(low, full, skips, balls, spans, rays, trips, wanted)
    land_block(full, rays)
    number_block(full, paired, balls, trips)


@kernel_inlined
def is_before(x: float, y: float, inner: Array) -> bool:
    """Whether a point of the investigation plane lies before the back of the last window."""
    along = (x - inner[0]) * inner[3] + (y - inner[1]) * inner[4]
    return bool(along > inner[2] * inner[5] - inner[THICKNESS])


@kernel
def end_block(
    count: int, careful: bool, inner: Array, rays: Array, trips: Array, fates: Array, point: Array, status: Array,
    branch: Array,
) -> int:  # fmt: skip
    """Write a block: point (2 n,), status (n,), branch (n,); how many have no branch number."""
    nx, ny, nz = inner[3], inner[4], inner[5]
    level = inner[2] * nz - inner[THICKNESS]
    unknown = 0
    for i in range(count):
        px, py = rays[PX + i], rays[PY + i]
        above = (px - inner[0]) * nx + (py - inner[1]) * ny > level
        rays[PX + i], rays[PY + i] = math.nan if above else px, math.nan if above else py
        unknown += trips[PICK + i] == UNKNOWN
    write_block(count, rays, trips, point, status, branch)
    if careful:
        unknown = 0
        for i in range(count):
            if fates[i] != OPEN:
                status[i], branch[i] = BLOCKED, UNKNOWN if fates[i] == UNUSUAL else 0
                point[2 * i], point[2 * i + 1] = math.nan, math.nan
            unknown += branch[i] == UNKNOWN
    return unknown


@kernel
def windowed_rows(
    camera: Array, balls: Array, windows: Array, flat: bool, paired: bool, skips: int, mirrors: Mirrors,
    first: int, last: int, scratch: RowScratch, beside: WindowScratch, unknown: Array, point: Array, status: Array,
    branch: Array,
) -> None:  # fmt: skip
    """Trace rows first..last-1 as `sensor_rows` does; `windows` (K, 10) from the camera on."""
    x, y, spans, rays, trips = scratch.x, scratch.y, scratch.spans, scratch.rays, scratch.trips
    fates, box, faces, discs = beside
    swap_x, swap_y = mirrors.swap_x, mirrors.swap_y
    width = status.shape[1]
    bodies, inner = balls.shape[0], windows[windows.shape[0] - 1]
    flat_columns(flat, camera, x)
    joined = spans[bodies:]
    edge = (width + 1) // 2 if mirrors.in_x else width
    for row in range(first, last):
        place_row(row, flat, camera, x, y)
        around(flat, x, y, 0, width, box)
        known = seem(box, camera, windows, balls, faces, discs)
        count = silhouettes(flat, skips if known else 0, camera, discs, x, y, width, spans)
        unknown[row] = 0
        low, j = 0, 0
        while low < edge:
            j, inside, high = next_span(low, edge, joined, count, j)
            high = min(high, low + LANES)
            around(flat, x, y, low, high, box)
            careful = not (known and all_open(box, camera, windows, faces))
            p, s, b = point[row, 2 * low : 2 * high], status[row, low:high], branch[row, low:high]
            if inside or careful or windows.shape[0] > 1:
                glass_behind(x, y, low, high - low, skips, paired, careful, camera, balls, windows, scratch, fates)
                unknown[row] += end_block(high - low, careful, inner, rays, trips, fates, p, s, b)
            else:
                full = low + whole_vectors(high - low)
                direct_through(x[low:full], y[low:full], camera, inner, rays, trips)
                write_block(high - low, rays, trips, p, s, b)
            low = high
        write_mirrored(row, edge, mirrors.in_x, mirrors.in_y, swap_x, swap_y, unknown, point, status, branch)
