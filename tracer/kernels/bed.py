"""Many spheres: which one a ray meets next, by walking through a grid of cells.

Space is cut into equal cubes; each lists the spheres whose box, grown by GROW cells, reaches into it.  A ray walks
from cell to cell and asks the spheres listed there by the very test of ``next_sphere``: what it finds has the same
bits.  When may it stop?  A sphere B that comes before the best one A has its foot point, which lies
inside B, at m_B < m_A: in a cell that the walk enters before m_A.  So the walk goes on until it enters a cell
beyond m_A, and finds the nearest for certain.  Growing the boxes makes the rounding of the walk harmless: it adds
candidates, and no tolerance enters the decision whether a sphere is hit.

``frame`` (7,): lowest corner of the grid, side of a cell, numbers of cells along x, y, z; ``begin`` (cells + 1,)
and ``items`` int32: the spheres of cell c are items[begin[c]:begin[c + 1]].
"""

import math

from ground.jit import Array, kernel
from tracer.kernels.branches import NOTHING
from tracer.kernels.sphere import CENTRE_X, CENTRE_Y, CENTRE_Z, RADIUS

GROW = 1e-6  # cells; the walk is off by a few 1e-16 of the distance walked


@kernel
def enter_axis(p: float, d: float, low: float, high: float) -> tuple[float, float]:
    """Distances along p + t d at which one coordinate lies between low and high; (inf, -inf) for never."""
    if d == 0.0:
        return (-math.inf, math.inf) if low <= p <= high else (math.inf, -math.inf)
    a, b = (low - p) / d, (high - p) / d
    return min(a, b), max(a, b)


@kernel
def next_in_bed(
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    last: int,
    spheres: Array,
    frame: Array,
    begin: Array,
    items: Array,
    room: int,
    home: Array,
) -> tuple[int, float]:
    """Number of the sphere met next, or NOTHING, and the distance to its foot point, as ``world.next_sphere``."""
    best, nearest = NOTHING, math.inf
    x0, y0, z0, side = frame[0], frame[1], frame[2], frame[3]
    nx, ny, nz = int(frame[4]), int(frame[5]), int(frame[6])
    ax, bx = enter_axis(px, dx, x0, x0 + nx * side)
    ay, by = enter_axis(py, dy, y0, y0 + ny * side)
    az, bz = enter_axis(pz, dz, z0, z0 + nz * side)
    t, end = max(0.0, max(ax, max(ay, az))), min(bx, min(by, bz))
    if t <= end:
        i = min(nx - 1, max(0, int((px + t * dx - x0) / side)))
        j = min(ny - 1, max(0, int((py + t * dy - y0) / side)))
        k = min(nz - 1, max(0, int((pz + t * dz - z0) / side)))
        si, sj, sk = 1 if dx > 0.0 else -1, 1 if dy > 0.0 else -1, 1 if dz > 0.0 else -1
        tx = (x0 + (i + (1 if si > 0 else 0)) * side - px) / dx if dx != 0.0 else math.inf
        ty = (y0 + (j + (1 if sj > 0 else 0)) * side - py) / dy if dy != 0.0 else math.inf
        tz = (z0 + (k + (1 if sk > 0 else 0)) * side - pz) / dz if dz != 0.0 else math.inf
        while t <= nearest:
            cell = (k * ny + j) * nx + i
            for e in range(begin[cell], begin[cell + 1]):
                s = items[e]
                if s != last:
                    wx, wy, wz = px - spheres[s, CENTRE_X], py - spheres[s, CENTRE_Y], pz - spheres[s, CENTRE_Z]
                    m = -(wx * dx + wy * dy + wz * dz)
                    if 0.0 < m < nearest:
                        fx, fy, fz = wx + m * dx, wy + m * dy, wz + m * dz
                        near = fx * fx + fy * fy + fz * fz < spheres[s, RADIUS] * spheres[s, RADIUS]
                        if near and (home.shape[0] == 0 or home[s] == room):
                            best, nearest = s, m
            if tx <= ty and tx <= tz:
                t, i = tx, i + si
                tx += side / abs(dx)
                if i < 0 or i >= nx:
                    break
            elif ty <= tz:
                t, j = ty, j + sj
                ty += side / abs(dy)
                if j < 0 or j >= ny:
                    break
            else:
                t, k = tz, k + sk
                tz += side / abs(dz)
                if k < 0 or k >= nz:
                    break
    return best, nearest
