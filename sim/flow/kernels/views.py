"""Images of points of light: the rays of a grid of pixels lead near each image, rays of its own to it.

A node holds the last straight way of its ray: x and y where it crosses z = 0 and its slopes dx/dz and dy/dz.  At
height z a ray is at x + z dx/dz: one table serves the whole depth of a light sheet.

A grid is one or many patches of equally many nodes, below each other in the arrays.  The first grid is one patch,
the whole sensor.  Its cells that are *rough* - next to a change of the bodies that rays pass, or bent - are cut
finer: each is a patch of the second grid, and left out of the first.

A cell tells nothing but where Newton's method starts, which then follows rays of its own and ends within the cell
or not at all.  So images lie where the rays say, however coarse the grid is, and no two cells find the same one.
"""

from typing import NamedTuple

import numpy as np

from ground.jit import Array, kernel, kernel_inlined
from sim.renderer.kernels.rays import camera_ray, last_way, may_meet
from sim.renderer.kernels.surfaces import World

X, Y, DX, DY, NUMBERS = 0, 1, 2, 3, 4
NOTHING, WHOLE, ROUGH = 0, 1, 2  # cells without a ray, cells to look in, cells to be cut finer
NO_GLASS_MM = 1e6
BENT = 0.1  # of a cell: what the middle of two nodes may lie beside the one between them
NEWTON = 8
FINEST = 1e6  # parts of a cell that are distinguished
CLOSE_PX, APART_PX = 1e-3, 0.01  # the last step of Newton's method, and what derivatives are taken over


class Patches(NamedTuple):
    """Nodes of a grid: pixels u, v (patches, 2) of the first node of each patch, rows of a patch, pupil point."""

    corners: Array
    rows: int
    step_px: float
    lens_u: float
    lens_v: float


class Cells(NamedTuple):
    """Rays of a grid's nodes, and the bins that find its cells; see `trace_nodes` and `cell_bins`."""

    ways: Array
    tops: Array
    chains: Array
    starts: Array
    entries: Array
    corner: Array
    edge: float
    margin: float


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
def way_of(
    u: float, v: float, lens_u: float, lens_v: float, world: World
) -> tuple[float, float, float, float, float, float, int]:
    """Last straight way of a ray: x, y at z = 0, dx/dz, dy/dz, its top, its transmittance, and the bodies passed.

    The top is the height below which the way is straight.  A ray that does not arrive passes -1.
    """
    camera, spheres, rods, walls, bounds, plane = world
    ox, oy, oz, dx, dy, dz = camera_ray(u, v, lens_u, lens_v, camera)
    if walls.shape[0] > 0 or (bounds.shape[0] > 0 and may_meet(u, v, camera, bounds)):
        ox, oy, oz, dx, dy, dz, part, chain = last_way(ox, oy, oz, dx, dy, dz, world)
    else:
        clear = World(camera, spheres[:0], rods[:0], walls, bounds, plane)
        ox, oy, oz, dx, dy, dz, part, chain = last_way(ox, oy, oz, dx, dy, dz, clear)
    if not (part > 0.0 and dz < 0.0):
        return 0.0, 0.0, 0.0, 0.0, -NO_GLASS_MM, 0.0, -1
    top = oz if chain != 0 or walls.shape[0] > 0 else NO_GLASS_MM
    return ox - oz * dx / dz, oy - oz * dy / dz, dx / dz, dy / dz, top, part, chain


@kernel
def trace_nodes(
    first: int, last: int, patches: Patches, world: World, ways: Array, tops: Array, chains: Array
) -> None:
    """Trace rows first..last of a grid.

    Out: `ways` (rows, columns, NUMBERS) float32, `tops` (rows, columns) float32, `chains` (rows, columns) int64.
    """
    corners, patch_rows, step_px, lens_u, lens_v = patches
    for i in range(first, last):
        u, v = corners[i // patch_rows, 0], corners[i // patch_rows, 1] + step_px * (i % patch_rows)
        for j in range(ways.shape[1]):
            x, y, dx, dy, top, _, chain = way_of(u + step_px * j, v, lens_u, lens_v, world)
            ways[i, j, X], ways[i, j, Y], ways[i, j, DX], ways[i, j, DY] = x, y, dx, dy
            tops[i, j], chains[i, j] = top, chain


@kernel_inlined
def bend(ways: Array, i: int, j: int, down: int, right: int, z: float) -> tuple[float, float]:
    """Half the second difference of the places of three nodes in a row at height z."""
    x, y = -ways[i, j, X] - z * ways[i, j, DX], -ways[i, j, Y] - z * ways[i, j, DY]
    for side in range(-1, 2, 2):
        k, m = i + side * down, j + side * right
        x += 0.5 * (ways[k, m, X] + z * ways[k, m, DX])
        y += 0.5 * (ways[k, m, Y] + z * ways[k, m, DY])
    return x, y


@kernel
def judge_cells(chains: Array, ways: Array, z: float, patch_rows: int, widest: float, cells: Array) -> None:
    """Say of every cell (rows - 1, columns - 1) what it is at height z; see the constants.

    A finite `widest` [mm^2] is that of the last grid, whose cells are not cut: where rays pass different bodies
    there is nothing to find, nor in a wider cell, where points are too dim.
    """
    is_last = widest < np.inf
    rows, columns = chains.shape
    for i in range(rows - 1):
        for j in range(columns - 1):
            chain = chains[i, j]
            within = (i + 1) % patch_rows != 0  # not between two patches
            same, any_ray = True, False
            for k in range(2):
                for m in range(2):
                    same = same and chains[i + k, j + m] == chain
                    any_ray = any_ray or chains[i + k, j + m] >= 0
            ax = ways[i, j + 1, X] - ways[i, j, X] + z * (ways[i, j + 1, DX] - ways[i, j, DX])
            ay = ways[i, j + 1, Y] - ways[i, j, Y] + z * (ways[i, j + 1, DY] - ways[i, j, DY])
            bx = ways[i + 1, j, X] - ways[i, j, X] + z * (ways[i + 1, j, DX] - ways[i, j, DX])
            by = ways[i + 1, j, Y] - ways[i, j, Y] + z * (ways[i + 1, j, DY] - ways[i, j, DY])
            det = abs(ax * by - ay * bx)
            if is_last:
                cells[i, j] = WHOLE if within and same and any_ray and det < widest else NOTHING
                continue
            for k in range(-1, 3):
                for m in range(-1, 3):
                    row, column = min(max(i + k, 0), rows - 1), min(max(j + m, 0), columns - 1)
                    same = same and chains[row, column] == chain
                    any_ray = any_ray or chains[row, column] >= 0
            cells[i, j] = (WHOLE if same else ROUGH) if any_ray else NOTHING
            if cells[i, j] == WHOLE and 0 < i < rows - 2 and 0 < j < columns - 2:
                for k in range(2):
                    for down in range(2):
                        x, y = bend(ways, i + k, j + k, down, 1 - down, z)
                        # In cells: the bend's place seen along either edge.
                        if max(abs(x * by - y * bx), abs(ax * y - ay * x)) > BENT * det:
                            cells[i, j] = ROUGH


@kernel_inlined
def _bins(low: float, high: float, start: float, edge: float, count: int) -> tuple[int, int]:
    """First and last of the bins between two places; none if the last is less."""
    first = min(max((low - start) / edge, -1.0), count + 1.0)
    last = min(max((high - start) / edge, -1.0), count + 1.0)
    return max(int(np.floor(first)), 0), min(int(np.floor(last)), count - 1)


@kernel
def cell_bins(
    ways: Array,
    cells: Array,
    margin: float,
    corner: Array,
    edge: float,
    counts: Array,
    out: Array,
) -> None:
    """Enter every cell into the bins (of width `edge`) that it covers at the heights of each layer of bins.

    `corner`: x and y where bins begin, their rows and columns, lowest z, depth of a layer, layers.  A cell
    is `margin` larger on either side than its nodes.  With an empty `out` only `counts` (bins,) is filled.  Else
    `counts` holds where each bin's next entry goes.
    """
    rows, columns, layers = int(corner[2]), int(corner[3]), int(corner[6])
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            if cells[i, j] != WHOLE:
                continue
            for layer in range(layers):
                x0 = y0 = np.inf
                x1 = y1 = -np.inf
                for k in range(2):
                    for m in range(2):
                        for side in range(2):
                            z = corner[4] + (layer + side) * corner[5]
                            x = ways[i + k, j + m, X] + z * ways[i + k, j + m, DX]
                            y = ways[i + k, j + m, Y] + z * ways[i + k, j + m, DY]
                            x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
                swell = margin * max(x1 - x0, y1 - y0)
                c0, c1 = _bins(x0 - swell, x1 + swell, corner[0], edge, columns)
                r0, r1 = _bins(y0 - swell, y1 + swell, corner[1], edge, rows)
                for r in range(r0, r1 + 1):
                    for c in range(c0, c1 + 1):
                        b = (layer * rows + r) * columns + c
                        if out.shape[0] > 0:
                            out[counts[b]] = i * cells.shape[1] + j
                        counts[b] += 1


@kernel
def find_images(
    points: Array, shine: Array, cells: Cells, patches: Patches, world: World, brightest: float, out: Array
) -> int:
    """Find all images of points (N, 3) [mm]; `out` (capacity, 3) gets u, v [px] and light, the number is returned.

    Cells are cut into two triangles each, whose edges belong to one of them only: no image is found twice.  A
    number beyond the capacity says that `out` was too short.
    """
    ways, tops, chains, starts, entries, corner, edge, margin = cells
    corners, patch_rows, step_px, lens_u, lens_v = patches
    camera = world.camera
    rows, columns = int(corner[2]), int(corner[3])
    wide = ways.shape[1] - 1
    found = 0
    for n in range(points.shape[0]):
        px, py, z = points[n, 0], points[n, 1], points[n, 2]
        c, r = int(np.floor((px - corner[0]) / edge)), int(np.floor((py - corner[1]) / edge))
        if not (0 <= c < columns and 0 <= r < rows) or shine[n] <= 0.0:
            continue
        layer = min(max(int(np.floor((z - corner[4]) / corner[5])), 0), int(corner[6]) - 1)
        b0 = (layer * rows + r) * columns + c
        for entry in range(starts[b0], starts[b0 + 1]):
            i, j = entries[entry] // wide, entries[entry] % wide
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
            u0, v0 = corners[i // patch_rows, 0] + step_px * j, corners[i // patch_rows, 1]
            v0 += step_px * (i % patch_rows)
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
                over = b - a if half == 0 else a - b
                if max(-a, -b, over, a - 1.0, b - 1.0) > margin:
                    continue
                is_there = False
                light = dx = dy = 0.0
                for _ in range(NEWTON):
                    u, v = u0 + step_px * a, v0 + step_px * b
                    x, y, dx, dy, _, part, chain = way_of(u, v, lens_u, lens_v, world)
                    # Derivatives are taken towards the middle of the cell, never out of it.
                    hu, hv = APART_PX if a < 0.5 else -APART_PX, APART_PX if b < 0.5 else -APART_PX
                    ux, uy, ud, ue, _, _, chain_u = way_of(u + hu, v, lens_u, lens_v, world)
                    vx, vy, vd, ve, _, _, chain_v = way_of(u, v + hv, lens_u, lens_v, world)
                    if chain != chains[i, j] or chain_u != chain or chain_v != chain:
                        break
                    x, y = x + z * dx, y + z * dy
                    ux, uy = (ux + z * ud - x) / hu, (uy + z * ue - y) / hu
                    vx, vy = (vx + z * vd - x) / hv, (vy + z * ve - y) / hv
                    det = ux * vy - uy * vx
                    if det == 0.0:
                        break
                    ex, ey = x - px, y - py
                    da, db = (ex * vy - ey * vx) / det / step_px, (ux * ey - uy * ex) / det / step_px
                    a, b = a - min(max(da, -0.5), 0.5), b - min(max(db, -0.5), 0.5)
                    if max(abs(a - 0.5), abs(b - 0.5)) > 0.5 + margin:
                        break
                    if step_px * max(abs(da), abs(db)) < CLOSE_PX:
                        is_there, light = True, part
                        break
                if not is_there:
                    continue
                a, b = (
                    np.rint(a * FINEST) / FINEST,
                    np.rint(b * FINEST) / FINEST,
                )  # of two cells one has the border
                if half == 0 and not (b >= 0.0 and b <= a and a < 1.0):
                    continue
                if half == 1 and not (a >= 0.0 and a < b and b < 1.0):
                    continue
                # Solid angle towards the pupil against that on the bare way: areas across the rays, inversely.
                nearer = 1.0 - z / camera[5]
                gain = light * bare_light(u, v, lens_u, lens_v, camera) * nearer * nearer
                gain *= np.sqrt(1.0 + dx * dx + dy * dy) / abs(det)
                if found < out.shape[0]:
                    out[found, 0], out[found, 1] = u0 + step_px * a, v0 + step_px * b
                    out[found, 2] = shine[n] * min(gain, brightest)
                found += 1
    return found
