"""Plane nodes to camera pixels: direct projection, starting points through glass, Newton on traced rays.

The grid arrives as (x0, y0, pitch): node (row, column) is (x0 + column pitch, y0 - row pitch).  Jacobians
are d pixel / d node, four numbers: du/dcolumn, du/drow, dv/dcolumn, dv/drow.
"""

import math

from correction.node_status import BLOCKED, FOLD, LOW_MAGNIFICATION, OUT_OF_FRAME, RECOVERED, RIM
from tracer.kernels._jit import Array, kernel
from tracer.kernels.camera import ideal_xy, pixel_ray_tangents
from tracer.kernels.march import ROD, land, march_pixel_tangents, next_body

MAX_STEPS = 25
TOLERANCE_PX = 1e-6  # last Newton step; it is still applied, which leaves about its square
SETTLED_PX = 1e-10


@kernel
def inverse_2x2(xu: float, xv: float, yu: float, yv: float) -> tuple[float, ...]:
    """Inverse of [[xu, xv], [yu, yv]] and its determinant's reciprocal; not finite where singular."""
    r = 1.0 / (xu * yv - xv * yu)
    return yv * r, -xv * r, -yu * r, xu * r


@kernel
def stretch(uc: float, ur: float, vc: float, vr: float) -> tuple[float, ...]:
    """Smallest and largest singular value of [[uc, ur], [vc, vr]]."""
    e, f = 0.5 * (uc + vr), 0.5 * (uc - vr)
    g, h = 0.5 * (vc + ur), 0.5 * (vc - ur)
    p, q = math.sqrt(e * e + h * h), math.sqrt(f * f + g * g)
    return abs(p - q), p + q


@kernel
def direct_rows(
    camera: Array,
    spheres: Array,
    rods: Array,
    grid: Array,
    first: int,
    last: int,
    width: int,
    height: int,
    pixel: Array,
    jacobian: Array,
    status: Array,
) -> None:
    """See the nodes of rows first..last-1 without glass: pixel (h, w, 2), Jacobian (h, w, 4), status (h, w).

    Nodes behind a body are left to the glass with the status they keep if no glass shows them.
    """
    px, py, pz = camera[0], camera[1], camera[2]
    for row in range(first, last):
        y = grid[1] - row * grid[2]
        for column in range(pixel.shape[1]):
            x = grid[0] + column * grid[2]
            wx, wy, wz = x - px, y - py, -pz
            cx = camera[3] * wx + camera[4] * wy + camera[5] * wz
            cy = camera[6] * wx + camera[7] * wy + camera[8] * wz
            cz = camera[9] * wx + camera[10] * wy + camera[11] * wz
            status[row, column] = OUT_OF_FRAME
            if not cz > 0.0:
                continue
            u, v = camera[13] + camera[12] * cx / cz, camera[14] + camera[12] * cy / cz
            u, v = acquired_pixel(u, v, cx / cz, cy / cz, camera)
            inside = 0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0
            length = math.sqrt(wx * wx + wy * wy + wz * wz)
            body = next_body(px, py, pz, wx / length, wy / length, wz / length, -1, spheres, rods)
            if body == -1:
                if inside:
                    status[row, column] = RECOVERED
                    pixel[row, column, 0], pixel[row, column, 1] = u, v
                    dx, dy, dz, ux, uy, uz, vx, vy, vz = pixel_ray_tangents(u, v, camera)
                    _, _, xu, xv, yu, yv = land(
                        px, py, pz, dx, dy, dz, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, ux, uy, uz, vx, vy, vz
                    )
                    ux_, uy_, vx_, vy_ = inverse_2x2(xu, xv, yu, yv)
                    jacobian[row, column, 0], jacobian[row, column, 1] = ux_ * grid[2], -uy_ * grid[2]
                    jacobian[row, column, 2], jacobian[row, column, 3] = vx_ * grid[2], -vy_ * grid[2]
            elif inside:
                status[row, column] = BLOCKED if body == ROD or spheres[body, 5] != 0.0 else RIM


@kernel
def acquired_pixel(u: float, v: float, x: float, y: float, camera: Array) -> tuple[float, ...]:
    """Acquired pixel of ideal image coordinates x, y; (u, v) is the ideal pixel.  Newton on the lens terms."""
    for _ in range(MAX_STEPS):
        a, b, au, av, bu, bv = ideal_xy(u, v, camera)
        if a == x and b == y:
            break
        ua, ub, va, vb = inverse_2x2(au, av, bu, bv)
        du, dv = ua * (x - a) + ub * (y - b), va * (x - a) + vb * (y - b)
        u, v = u + du, v + dv
        if abs(du) + abs(dv) < SETTLED_PX:
            break
    return u, v


@kernel
def pixel_tangents(
    camera: Array,
    spheres: Array,
    rods: Array,
    pixels: Array,
    first: int,
    last: int,
    out: Array,
) -> None:
    """Plane point and its derivatives of pixels (N, 2) int: out (N, 6) x, y, dx/du, dx/dv, dy/du, dy/dv."""
    for i in range(first, last):
        _, x, y, xu, xv, yu, yv, _, _, _ = march_pixel_tangents(
            float(pixels[i, 0]), float(pixels[i, 1]), camera, spheres, rods
        )
        out[i, 0], out[i, 1] = x, y
        out[i, 2], out[i, 3], out[i, 4], out[i, 5] = xu, xv, yu, yv


@kernel
def scatter_starts(
    pixels: Array, tangents: Array, grid: Array, row0: int, column0: int, least: float, start: Array, away: Array
) -> None:
    """Give each node the pixel of one sheet from which Newton starts.

    Every pixel covers, to first order, the parallelogram of the plane that its own square and half of its
    neighbours' squares see; nodes in there may start from it, and the nearest pixel wins.  At the border of
    a sheet this reaches one pixel beyond it; Newton decides whether the sheet really goes on there.
    Pixels whose smallest magnification is below `least` are left out: they would cover the whole plane.
    ``start`` (h, w, 2) and ``away`` (h, w, squared distance, inf where there is none) cover the nodes from
    (row0, column0) on.
    """
    for i in range(pixels.shape[0]):
        x, y = tangents[i, 0], tangents[i, 1]
        xu, xv, yu, yv = tangents[i, 2], tangents[i, 3], tangents[i, 4], tangents[i, 5]
        ux, uy, vx, vy = inverse_2x2(xu, xv, yu, yv)
        low, _ = stretch(ux * grid[2], uy * grid[2], vx * grid[2], vy * grid[2])
        if not low >= least:
            continue
        c, r = (x - grid[0]) / grid[2] - column0, (grid[1] - y) / grid[2] - row0
        c_half, r_half = (abs(xu) + abs(xv)) / grid[2], (abs(yu) + abs(yv)) / grid[2]
        c_first, c_last = max(0, math.ceil(c - c_half)), min(away.shape[1] - 1, math.floor(c + c_half))
        r_first, r_last = max(0, math.ceil(r - r_half)), min(away.shape[0] - 1, math.floor(r + r_half))
        for row in range(r_first, r_last + 1):
            ey = -(row - r) * grid[2]
            for column in range(c_first, c_last + 1):
                ex = (column - c) * grid[2]
                du, dv = ux * ex + uy * ey, vx * ex + vy * ey
                if abs(du) <= 1.0 and abs(dv) <= 1.0 and du * du + dv * dv < away[row, column]:
                    away[row, column] = du * du + dv * dv
                    start[row, column, 0] = pixels[i, 0] + du
                    start[row, column, 1] = pixels[i, 1] + dv


@kernel
def solve_rows(
    camera: Array,
    spheres: Array,
    rods: Array,
    grid: Array,
    row0: int,
    column0: int,
    first: int,
    last: int,
    width: int,
    height: int,
    key: int,
    sign: float,
    least: float,
    most: float,
    start: Array,
    away: Array,
    pixel: Array,
    jacobian: Array,
    quality: Array,
    status: Array,
) -> None:
    """Newton on traced rays for the nodes of one sheet that have a start.

    A sheet is a connected part of one branch with one sign of the Jacobian determinant.  Outputs cover the
    same nodes as ``start``: pixel (h, w, 2), Jacobian (h, w, 4), quality (h, w, 2) = transmittance and weight,
    status (h, w) = RECOVERED or why not.  The weight is T min(1, |det J|) / (1 + events).
    """
    for row in range(first, last):
        y = grid[1] - (row + row0) * grid[2]
        for column in range(start.shape[1]):
            if away[row, column] == math.inf:
                continue
            x = grid[0] + (column + column0) * grid[2]
            u, v = start[row, column, 0], start[row, column, 1]
            du = dv = 0.0
            status[row, column] = FOLD
            for _ in range(MAX_STEPS):
                s, a, b, au, av, bu, bv, passed, k, events = march_pixel_tangents(u, v, camera, spheres, rods)
                ux, uy, vx, vy = inverse_2x2(au, av, bu, bv)
                if s != RECOVERED or k != key or not (au * bv - av * bu) * sign > 0.0:
                    du, dv = 0.5 * du, 0.5 * dv  # stepped off the sheet: go half the way back
                    if abs(du) + abs(dv) < TOLERANCE_PX:
                        break
                    u, v = u - du, v - dv
                    continue
                du, dv = ux * (x - a) + uy * (y - b), vx * (x - a) + vy * (y - b)
                size = max(abs(du), abs(dv))
                if size > 2.0:
                    du, dv = 2.0 * du / size, 2.0 * dv / size
                u, v = u + du, v + dv
                if size <= TOLERANCE_PX:
                    status[row, column] = RECOVERED
                    break
            if status[row, column] != RECOVERED:
                continue
            uc, ur, vc, vr = ux * grid[2], -uy * grid[2], vx * grid[2], -vy * grid[2]
            low, high = stretch(uc, ur, vc, vr)
            if not (0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0):
                status[row, column] = OUT_OF_FRAME
            elif low < least:
                status[row, column] = LOW_MAGNIFICATION
            elif high > most:
                status[row, column] = FOLD
            else:
                pixel[row, column, 0], pixel[row, column, 1] = u, v
                jacobian[row, column, 0], jacobian[row, column, 1] = uc, ur
                jacobian[row, column, 2], jacobian[row, column, 3] = vc, vr
                quality[row, column, 0] = passed
                quality[row, column, 1] = passed * min(1.0, abs(uc * vr - ur * vc)) / (1.0 + events)
