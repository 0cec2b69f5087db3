"""Where the rays of a grid of pixels run behind the last glass, and where points are seen by inverting that grid.

A node holds the last straight way of its ray: x and y where it crosses z = 0, its slopes dx/dz and dy/dz, and the
light (transmittance times the solid angle that a pixel would subtend on the bare way, seen from a point at z = 0).
At height z a ray is at x + z dx/dz: one table serves the whole depth of a light sheet.
"""

import numpy as np

from ground.jit import Array, kernel, kernel_inlined
from sim.renderer.rays import camera_ray, last_way, may_meet

X, Y, DX, DY, LIGHT, NUMBERS = 0, 1, 2, 3, 4, 5
NOTHING, LINEAR, CUBIC = 0, 1, 2  # what a cell may be interpolated by
NO_GLASS_MM = 1e6


@kernel_inlined
def bare_light(u: float, v: float, lens_u: float, lens_v: float, camera: Array) -> float:
    """Area that a pixel covers at z = 0 without glass, across its ray [mm^2]."""
    _, _, oz, dx, dy, dz = camera_ray(u, v, lens_u, lens_v, camera)
    _, _, _, ax, ay, az = camera_ray(u + 0.5, v, lens_u, lens_v, camera)
    _, _, _, bx, by, bz = camera_ray(u - 0.5, v, lens_u, lens_v, camera)
    ax, ay, az = ax - bx, ay - by, az - bz
    _, _, _, ex, ey, ez = camera_ray(u, v + 0.5, lens_u, lens_v, camera)
    _, _, _, bx, by, bz = camera_ray(u, v - 0.5, lens_u, lens_v, camera)
    ex, ey, ez = ex - bx, ey - by, ez - bz
    solid = abs(dx * (ay * ez - az * ey) + dy * (az * ex - ax * ez) + dz * (ax * ey - ay * ex))
    way = oz / dz
    return solid * way * way


@kernel
def trace_nodes(
    first: int,
    last: int,
    start_px: float,
    step_px: float,
    lens_u: float,
    lens_v: float,
    camera: Array,
    spheres: Array,
    rods: Array,
    walls: Array,
    bounds: Array,
    plane: Array,
    ways: Array,
    tops: Array,
    chains: Array,
) -> None:
    """Trace rows first..last of the grid whose node (i, j) is pixel v = start + i step, u = start + j step.

    Out: `ways` (rows, columns, NUMBERS) float32; `tops` (rows, columns) float32, the height below which the way
    is straight; `chains` (rows, columns) int64, which bodies were passed, -1 for a ray that does not arrive.
    """
    clear_s, clear_r = spheres[:0], rods[:0]
    for i in range(first, last):
        for j in range(ways.shape[1]):
            u, v = start_px + step_px * j, start_px + step_px * i
            ox, oy, oz, dx, dy, dz = camera_ray(u, v, lens_u, lens_v, camera)
            if walls.shape[0] > 0 or (bounds.shape[0] > 0 and may_meet(u, v, camera, bounds)):
                ox, oy, oz, dx, dy, dz, part, chain = last_way(ox, oy, oz, dx, dy, dz, spheres, rods, walls, plane)
            else:
                ox, oy, oz, dx, dy, dz, part, chain = last_way(
                    ox, oy, oz, dx, dy, dz, clear_s, clear_r, walls, plane
                )
            chains[i, j] = chain if part > 0.0 and dz < 0.0 else -1
            if chains[i, j] < 0:
                ways[i, j, :] = 0.0
                tops[i, j] = -NO_GLASS_MM
                continue
            ways[i, j, DX], ways[i, j, DY] = dx / dz, dy / dz
            ways[i, j, X], ways[i, j, Y] = ox - oz * dx / dz, oy - oz * dy / dz
            ways[i, j, LIGHT] = part * bare_light(u, v, lens_u, lens_v, camera)
            tops[i, j] = oz if chain != 0 or walls.shape[0] > 0 else NO_GLASS_MM


@kernel
def judge_cells(chains: Array, cells: Array) -> None:
    """Say of every cell (rows - 1, columns - 1) how it may be interpolated: all its nodes on one chain."""
    rows, columns = chains.shape
    for i in range(rows - 1):
        for j in range(columns - 1):
            chain = chains[i, j]
            same = chain >= 0
            for k in range(2):
                for m in range(2):
                    same = same and chains[i + k, j + m] == chain
            cells[i, j] = LINEAR if same else NOTHING
            if same and 0 < i < rows - 2 and 0 < j < columns - 2:
                for k in range(-1, 3):
                    for m in range(-1, 3):
                        same = same and chains[i + k, j + m] == chain
                if same:
                    cells[i, j] = CUBIC


@kernel
def cell_bins(
    ways: Array, cells: Array, low_z: float, high_z: float, corner: Array, edge: float, counts: Array, out: Array
) -> None:
    """Enter every cell into the bins (of width `edge`, from `corner`) that it covers between two heights.

    With an empty `out` only `counts` (bins,) is filled.  Else `counts` holds where each bin's next entry goes.
    """
    rows, columns = int(corner[2]), int(corner[3])
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            if cells[i, j] == NOTHING:
                continue
            x0 = y0 = np.inf
            x1 = y1 = -np.inf
            for k in range(2):
                for m in range(2):
                    for side in range(2):
                        z = low_z if side == 0 else high_z
                        x = ways[i + k, j + m, X] + z * ways[i + k, j + m, DX]
                        y = ways[i + k, j + m, Y] + z * ways[i + k, j + m, DY]
                        x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
            # A curved cell bulges out of its corners.
            swell = 0.02 * max(x1 - x0, y1 - y0)
            c0 = max(int(np.floor(min(max((x0 - swell - corner[0]) / edge, -1.0), columns + 1.0))), 0)
            c1 = min(int(np.floor(min(max((x1 + swell - corner[0]) / edge, -1.0), columns + 1.0))), columns - 1)
            r0 = max(int(np.floor(min(max((y0 - swell - corner[1]) / edge, -1.0), rows + 1.0))), 0)
            r1 = min(int(np.floor(min(max((y1 + swell - corner[1]) / edge, -1.0), rows + 1.0))), rows - 1)
            for r in range(r0, r1 + 1):
                for c in range(c0, c1 + 1):
                    b = r * columns + c
                    if out.shape[0] > 0:
                        out[counts[b]] = i * cells.shape[1] + j
                    counts[b] += 1


@kernel_inlined
def cubic(t: float, k: int) -> float:
    """Lagrange's weight of node k = -1, 0, 1, 2 at t."""
    if k == -1:
        return -t * (t - 1.0) * (t - 2.0) / 6.0
    if k == 0:
        return (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0
    if k == 1:
        return -(t + 1.0) * t * (t - 2.0) / 2.0
    return (t + 1.0) * t * (t - 1.0) / 6.0


@kernel_inlined
def cubic_slope(t: float, k: int) -> float:
    """Derivative of `cubic`."""
    if k == -1:
        return -(3.0 * t * t - 6.0 * t + 2.0) / 6.0
    if k == 0:
        return (3.0 * t * t - 4.0 * t - 1.0) / 2.0
    if k == 1:
        return -(3.0 * t * t - 2.0 * t - 2.0) / 2.0
    return (3.0 * t * t - 1.0) / 6.0


@kernel_inlined
def place_in_cell(
    ways: Array, i: int, j: int, is_cubic: bool, z: float, a: float, b: float
) -> tuple[float, float, float, float, float, float]:
    """Where cell (i, j) is at height z for a along its columns and b along its rows: x, y, and their slopes."""
    x = y = xa = ya = xb = yb = 0.0
    if is_cubic:
        for k in range(-1, 3):
            px = py = sx = sy = 0.0
            for m in range(-1, 3):
                w, s = cubic(a, m), cubic_slope(a, m)
                nx = ways[i + k, j + m, X] + z * ways[i + k, j + m, DX]
                ny = ways[i + k, j + m, Y] + z * ways[i + k, j + m, DY]
                px, py, sx, sy = px + w * nx, py + w * ny, sx + s * nx, sy + s * ny
            w, s = cubic(b, k), cubic_slope(b, k)
            x, y, xa, ya = x + w * px, y + w * py, xa + w * sx, ya + w * sy
            xb, yb = xb + s * px, yb + s * py
        return x, y, xa, ya, xb, yb
    for k in range(2):
        for m in range(2):
            nx = ways[i + k, j + m, X] + z * ways[i + k, j + m, DX]
            ny = ways[i + k, j + m, Y] + z * ways[i + k, j + m, DY]
            wa, wb = a if m == 1 else 1.0 - a, b if k == 1 else 1.0 - b
            sa, sb = 1.0 if m == 1 else -1.0, 1.0 if k == 1 else -1.0
            x, y = x + wa * wb * nx, y + wa * wb * ny
            xa, ya = xa + sa * wb * nx, ya + sa * wb * ny
            xb, yb = xb + wa * sb * nx, yb + wa * sb * ny
    return x, y, xa, ya, xb, yb


@kernel
def find_images(
    points: Array,
    shine: Array,
    ways: Array,
    tops: Array,
    cells: Array,
    starts: Array,
    entries: Array,
    corner: Array,
    edge: float,
    camera_z: float,
    start_px: float,
    step_px: float,
    brightest: float,
    out: Array,
) -> int:
    """Find all images of points (N, 3) [mm]; `out` (capacity, 3) gets u, v [px] and light, the number is returned.

    Cells are cut into two triangles each, whose edges belong to one of them only: no image is found twice.  Newton
    steps in the cubic cell correct the place.  A number beyond the capacity says that `out` was too short.
    """
    rows, columns = int(corner[2]), int(corner[3])
    found = 0
    for n in range(points.shape[0]):
        px, py, z = points[n, 0], points[n, 1], points[n, 2]
        c, r = int(np.floor((px - corner[0]) / edge)), int(np.floor((py - corner[1]) / edge))
        if not (0 <= c < columns and 0 <= r < rows) or shine[n] <= 0.0:
            continue
        b0 = r * columns + c
        for entry in range(starts[b0], starts[b0 + 1]):
            i, j = entries[entry] // cells.shape[1], entries[entry] % cells.shape[1]
            if tops[i, j] < z:
                continue
            x00, y00 = ways[i, j, X] + z * ways[i, j, DX] - px, ways[i, j, Y] + z * ways[i, j, DY] - py
            x01, y01 = (
                ways[i, j + 1, X] + z * ways[i, j + 1, DX] - px,
                ways[i, j + 1, Y] + z * ways[i, j + 1, DY] - py,
            )
            x10, y10 = (
                ways[i + 1, j, X] + z * ways[i + 1, j, DX] - px,
                ways[i + 1, j, Y] + z * ways[i + 1, j, DY] - py,
            )
            x11, y11 = (
                ways[i + 1, j + 1, X] + z * ways[i + 1, j + 1, DX] - px,
                ways[i + 1, j + 1, Y] + z * ways[i + 1, j + 1, DY] - py,
            )
            if min(x00, x01, x10, x11) > 0.0 or max(x00, x01, x10, x11) < 0.0:
                continue
            if min(y00, y01, y10, y11) > 0.0 or max(y00, y01, y10, y11) < 0.0:
                continue
            for half in range(2):
                # p = p00 + a ea + b eb: 0 <= b <= a < 1 in the upper triangle, 0 <= a < b < 1 in the lower one.
                if half == 0:
                    eax, eay, ebx, eby = x01 - x00, y01 - y00, x11 - x01, y11 - y01
                else:
                    eax, eay, ebx, eby = x11 - x10, y11 - y10, x10 - x00, y10 - y00
                det = eax * eby - eay * ebx
                if det == 0.0:
                    continue
                a, b = (-x00 * eby + y00 * ebx) / det, (-eax * y00 + eay * x00) / det
                if half == 0 and not (b >= 0.0 and b <= a and a < 1.0):
                    continue
                if half == 1 and not (a >= 0.0 and a < b and b < 1.0):
                    continue
                is_cubic = cells[i, j] == CUBIC
                size = abs(det)
                start_a, start_b = a, b
                for _ in range(2):
                    x, y, xa, ya, xb, yb = place_in_cell(ways, i, j, is_cubic, z, a, b)
                    det = xa * yb - ya * xb
                    if abs(det) < 0.05 * size:
                        break  # on a fold: the linear place is as good as any
                    ex, ey = x - px, y - py
                    a, b = a - (ex * yb - ey * xb) / det, b - (xa * ey - ya * ex) / det
                if not (abs(a - start_a) < 0.5 and abs(b - start_b) < 0.5):
                    a, b, det = start_a, start_b, size
                w = light = dx = dy = 0.0
                for k in range(2):
                    for m in range(2):
                        w = (a if m == 1 else 1.0 - a) * (b if k == 1 else 1.0 - b)
                        light += w * ways[i + k, j + m, LIGHT]
                        dx += w * ways[i + k, j + m, DX]
                        dy += w * ways[i + k, j + m, DY]
                # Solid angle towards the pupil against that on the bare way: areas across the rays, inversely.
                nearer = 1.0 - z / camera_z
                gain = light * nearer * nearer * np.sqrt(1.0 + dx * dx + dy * dy) * step_px * step_px / abs(det)
                if found < out.shape[0]:
                    out[found, 0] = start_px + step_px * (j + a)
                    out[found, 1] = start_px + step_px * (i + b)
                    out[found, 2] = shine[n] * min(gain, brightest)
                found += 1
    return found
