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
from tracer.kernels.apparent import all_open, apparent_positions, image_box
from tracer.kernels.branches import UNKNOWN
from tracer.kernels.camera import axes_of, eye_of
from tracer.kernels.chain import IQ, PICK, QQ, begin_block, follow_block, image_ray, place_row
from tracer.kernels.packets import DX, DY, DZ, LANES, PX, PY, PZ, hit_plane, whole_vectors
from tracer.kernels.sensor import (
    MapArrays,
    Mirrors,
    RowOptions,
    RowScratch,
    flat_columns,
    next_span,
    number_block,
    part_of_row,
    silhouettes,
    write_block,
    write_mirrored,
)
from tracer.kernels.vectors import combine, dot, move, subtract, vector_at
from tracer.kernels.window import BEHIND, GLASS, OPENING, THICKNESS
from tracer.kernels.world import BLOCKED

OPEN, SHUT, UNUSUAL = 0, 1, 2
Optics = tuple[Array, Array, Array]  # camera, balls, windows


class WindowScratch(NamedTuple):
    """Memory of one thread: rows, ``fates`` of a block, ``box`` (4,), and results of `apparent_positions`."""

    row: RowScratch
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
    """Trace a block (n,) through one window and by no sphere: `through_window` and `hit_plane` in one.

    All that it divides by is one product.
    """
    eye, axes, normal, thickness, behind = (
        eye_of(camera),
        axes_of(camera),
        vector_at(row, 3),
        row[THICKNESS],
        row[BEHIND],
    )
    gain, gain_behind = (row[GLASS] - 1.0) * (row[GLASS] + 1.0), (behind - 1.0) * (behind + 1.0)
    h = dot(subtract(eye, vector_at(row, 0)), normal)
    if behind == 1.0:
        for i in range(x.shape[0]):
            d = image_ray(x[i], y[i], axes)
            m = -dot(d, normal)
            w = math.sqrt(gain * dot(d, d) + m * m)
            r = 1.0 / (w * d[2])
            moved = thickness * (m * d[2] * r) - thickness
            p = move(eye, moved, normal)
            t = -p[2] * (w * r)
            down = d[2] < 0.0
            tx, ty = p[0] + t * d[0], p[1] + t * d[1]
            rays[PX + i], rays[PY + i] = tx if down else math.nan, ty if down else math.nan
    else:
        for i in range(x.shape[0]):
            d = image_ray(x[i], y[i], axes)
            m, q = -dot(d, normal), dot(d, d)
            w, w_behind = math.sqrt(gain * q + m * m), math.sqrt(gain_behind * q + m * m)
            d = move(d, m - w_behind, normal)
            r = 1.0 / (m * w * d[2])
            moved = (h * w + thickness * m) * (r * d[2]) * w_behind - h - thickness
            p = move(eye, moved, normal)
            t = -p[2] * (m * w * r)
            down = d[2] < 0.0
            tx, ty = p[0] + t * d[0], p[1] + t * d[1]
            rays[PX + i], rays[PY + i] = tx if down else math.nan, ty if down else math.nan
    for i in range(x.shape[0]):
        trips[PICK + i] = 0


@kernel_inlined
def through_window_carefully(count: int, row: Array, rays: Array, fates: Array) -> None:
    """Take a block through a window; `fates` (n,) becomes SHUT or UNUSUAL where a ray does not go on."""
    start, normal, thickness, opening2 = (
        vector_at(row, 0),
        vector_at(row, 3),
        row[THICKNESS],
        row[OPENING] * row[OPENING],
    )
    e1, e2 = 1.0 / row[GLASS], row[GLASS] / row[BEHIND]
    gain1, gain2 = (e1 - 1.0) * (e1 + 1.0), (e2 - 1.0) * (e2 + 1.0)
    for i in range(count):
        norm = 1.0 / math.sqrt(rays[QQ + i])
        d = norm * rays[DX + i], norm * rays[DY + i], norm * rays[DZ + i]
        p = rays[PX + i], rays[PY + i], rays[PZ + i]
        c1 = -dot(d, normal)
        t = dot(subtract(p, start), normal) / c1
        q = move(p, t, d)
        w = subtract(q, start)
        off2 = dot(w, w)
        square1 = 1.0 - e1 * e1 * (1.0 - c1 * c1)
        c2 = math.sqrt(max(square1, 0.0))
        e = combine(e1, d, gain1 / (e1 * c1 + c2), normal)
        b = move(q, thickness / c2, e)
        w = subtract(b, start)
        back2 = dot(w, w) - thickness * thickness
        square2 = 1.0 - e2 * e2 * (1.0 - c2 * c2)
        f = combine(e2, e, gain2 / (e2 * c2 + math.sqrt(max(square2, 0.0))), normal)
        usual = (c1 > 0.0) & (t > 0.0) & (q[2] > 0.0) & (b[2] > 0.0) & (square1 > 0.0) & (square2 > 0.0)
        is_open = (off2 < opening2) & (back2 < opening2)
        fate = fates[i]
        now = (OPEN if is_open else SHUT) if usual else UNUSUAL
        fates[i] = now if fate == OPEN else fate
        goes = usual & is_open & (fate == OPEN)
        square = dot(f, f)
        px, py, pz = b[0] if goes else p[0], b[1] if goes else p[1], b[2] if goes else p[2]
        dx, dy, dz = f[0] if goes else d[0], f[1] if goes else d[1], f[2] if goes else d[2]
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
    low: int, count: int, careful: bool, options: RowOptions, optics: Optics, scratch: WindowScratch
) -> None:
    """Trace `count` columns from `low` on through windows and spheres; `careful` ones get ``fates``."""
    (camera, balls, windows), (x, y, spans, wanted, rays, trips), fates = optics, scratch.row, scratch.fates
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
    follow_block(low, full, options.skips, balls, spans, rays, trips, wanted)
    hit_plane(full, rays)
    number_block(full, options.paired, balls, trips)


@kernel_inlined
def is_before(x: float, y: float, inner: Array) -> bool:
    """Return whether a point of the investigation plane lies before the back of the last window."""
    along = (x - inner[0]) * inner[3] + (y - inner[1]) * inner[4]
    return bool(along > inner[2] * inner[5] - inner[THICKNESS])


@kernel
def end_block(count: int, careful: bool, inner: Array, scratch: WindowScratch, out: MapArrays) -> int:
    """Write a block; return how many of its pixels have no branch number."""
    rays, trips, fates = scratch.row.rays, scratch.row.trips, scratch.fates
    nx, ny, nz = inner[3], inner[4], inner[5]
    level = inner[2] * nz - inner[THICKNESS]
    unknown = 0
    for i in range(count):
        px, py = rays[PX + i], rays[PY + i]
        above = (px - inner[0]) * nx + (py - inner[1]) * ny > level
        rays[PX + i], rays[PY + i] = math.nan if above else px, math.nan if above else py
        unknown += trips[PICK + i] == UNKNOWN
    write_block(count, rays, trips, out)
    if careful:
        unknown = 0
        for i in range(count):
            if fates[i] != OPEN:
                out.status[i], out.branch[i] = BLOCKED, UNKNOWN if fates[i] == UNUSUAL else 0
                out.point[2 * i], out.point[2 * i + 1] = math.nan, math.nan
            unknown += out.branch[i] == UNKNOWN
    return unknown


@kernel
def rows_behind_windows(
    optics: Optics, options: RowOptions, mirrors: Mirrors, first: int, last: int, scratch: WindowScratch,
    unknown: Array, out: MapArrays,
) -> None:  # fmt: skip
    """Trace rows first..last-1 as `sensor_rows` does; windows (K, 10) from the camera on."""
    (camera, balls, windows), (x, y, spans, _, rays, trips), box = optics, scratch.row, scratch.box
    faces, discs = scratch.faces, scratch.discs
    width, bodies, inner = out.status.shape[1], balls.shape[0], windows[windows.shape[0] - 1]
    flat_columns(options.flat, camera, x)
    edge = (width + 1) // 2 if mirrors.in_x else width
    for row in range(first, last):
        place_row(row, options.flat, camera, x, y)
        around(options.flat, x, y, 0, width, box)
        known = apparent_positions(box, camera, windows, balls, faces, discs)
        visible = RowOptions(options.flat, options.paired, options.skips if known else 0)
        count = silhouettes(visible, camera, discs, width, scratch.row)
        unknown[row] = 0
        low, j = 0, 0
        while low < edge:
            j, inside, high = next_span(low, edge, spans[bodies:], count, j)
            high = min(high, low + LANES)
            around(options.flat, x, y, low, high, box)
            careful = not (known and all_open(box, camera, windows, faces))
            part = part_of_row(out, row, low, high)
            if inside or careful or windows.shape[0] > 1:
                glass_behind(low, high - low, careful, options, optics, scratch)
                unknown[row] += end_block(high - low, careful, inner, scratch, part)
            else:
                full = low + whole_vectors(high - low)
                direct_through(x[low:full], y[low:full], camera, inner, rays, trips)
                write_block(high - low, rays, trips, part)
            low = high
        write_mirrored(row, edge, mirrors, unknown, out)
