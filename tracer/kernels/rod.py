"""A ray and an opaque rod with round ends."""

import math

from tracer.kernels._jit import Array, kernel

ROD = -2  # what a ray meets: the number of a sphere, a rod, or nothing (-1)


@kernel
def meets_rod(px: float, py: float, pz: float, dx: float, dy: float, dz: float, rod: Array) -> float:
    """Distance along the half-line p + t d, t >= 0, to its closest approach if that lies in the rod, else inf.

    Closest approach of a half-line and a segment: minimise |w + t d - s e|^2, w = p - start, e the axis,
    over t >= 0 and 0 <= s <= 1.  The function is convex, so clamping s and solving for t again suffices.
    """
    ex, ey, ez = rod[3] - rod[0], rod[4] - rod[1], rod[5] - rod[2]
    wx, wy, wz = px - rod[0], py - rod[1], pz - rod[2]
    ee = ex * ex + ey * ey + ez * ez
    de = dx * ex + dy * ey + dz * ez
    wd = wx * dx + wy * dy + wz * dz
    we = wx * ex + wy * ey + wz * ez
    across = ee - de * de
    s = 0.0
    if across > 1e-14 * ee:  # else parallel: either end will do
        s = (we - wd * de) / across
    s = min(max(s, 0.0), 1.0)
    t = s * de - wd
    if t < 0.0:
        t = 0.0
        if ee > 0.0:
            s = min(max(we / ee, 0.0), 1.0)
    gx, gy, gz = wx + t * dx - s * ex, wy + t * dy - s * ey, wz + t * dz - s * ez
    if gx * gx + gy * gy + gz * gz < rod[6] * rod[6]:
        return float(t)
    return math.inf
