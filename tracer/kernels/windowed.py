"""Many neighbouring rays at once through windows in front of a few spheres.

A window before everything is a pass of its own over the block (``tracer.kernels.chain``): both faces are parallel,
so a ray that enters at cosine c1 leaves at the one that the two media alone decide, and all that the plate adds is
a shift along it.  Behind the last window the block goes on as in a scene of spheres, with indices of that room.
No silhouette helps: where a window bends the rays a sphere's outline is no ellipse of the sensor, so every block
looks at every sphere.

What is not the usual case (a ray that looks past the window's plane, is totally reflected, or reaches the plane in
between) gets no branch number, and is traced again by ``march``, which knows it all.  So is what ends in front of
the back of the last window, which closes its room.
"""

import math

from ground.jit import Array, kernel, kernel_inlined, unowned
from tracer.kernels.branches import UNKNOWN
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
    place_row,
    whole_vectors,
)
from tracer.kernels.sensor import RowScratch, flat_columns, number_block
from tracer.kernels.straight import land_block
from tracer.kernels.window import BEHIND, GLASS, OPENING, THICKNESS
from tracer.kernels.world import BLOCKED, MISSED_PLANE, RECOVERED

OPEN, SHUT, UNUSUAL = 0, 1, 2


@kernel_inlined
def through_window(count: int, row: Array, rays: Array, fates: Array) -> None:
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
def windowed_rows(
    camera: Array,
    balls: Array,
    windows: Array,
    flat: bool,
    first: int,
    last: int,
    scratch: RowScratch,
    fates: Array,
    unknown: Array,
    point: Array,
    status: Array,
    branch: Array,
) -> None:
    """Trace rows first..last-1 as `sensor_rows` does; `windows` (K, 10) from the camera on, `fates` scratch."""
    camera, balls, windows = unowned(camera), unowned(balls), unowned(windows)
    x, y, spans, wanted = unowned(scratch.x), unowned(scratch.y), unowned(scratch.spans), unowned(scratch.wanted)
    rays, trips, fates = unowned(scratch.rays), unowned(scratch.trips), unowned(fates)
    point, status, branch = unowned(point), unowned(status), unowned(branch)
    _, width = status.shape
    inner = windows[windows.shape[0] - 1]
    flat_columns(flat, camera, x)
    for row in range(first, last):
        place_row(row, flat, camera, x, y)
        unknown[row] = 0
        for low in range(0, width, LANES):
            count = min(LANES, width - low)
            full = whole_vectors(count)
            begin_block(x[low : low + full], y[low : low + full], camera, rays, trips)
            for i in range(full):
                fates[i] = OPEN
            for k in range(windows.shape[0]):
                through_window(full, windows[k], rays, fates)
            follow_block(low, full, 0, balls, spans, rays, trips, wanted)
            land_block(full, rays)
            number_block(full, False, balls, trips)
            for i in range(count):
                px, py, number, fate = rays[PX + i], rays[PY + i], trips[PICK + i], fates[i]
                above = (px - inner[0]) * inner[3] + (py - inner[1]) * inner[4] - inner[2] * inner[5]
                lands = px == px
                again = fate == UNUSUAL or number == UNKNOWN or not lands or above + inner[THICKNESS] > 0.0
                if fate == SHUT:
                    status[row, low + i], branch[row, low + i] = BLOCKED, 0
                    px = py = math.nan
                elif again:
                    status[row, low + i], branch[row, low + i] = MISSED_PLANE, UNKNOWN
                    unknown[row] += 1
                else:
                    status[row, low + i], branch[row, low + i] = RECOVERED, number
                point[row, 2 * (low + i)], point[row, 2 * (low + i) + 1] = px, py
