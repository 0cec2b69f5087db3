"""A ray and a tube: a cylindrical wall of glass with another medium, and bodies, inside.

Row (11,): where the axis begins, its unit direction, length, outer and inner radius [mm], n of the wall and of
what fills the tube, both / n of what is around.  The ends are open.  Through them a ray comes and goes unbent
where inside and outside are of one medium; the surface of a liquid there has no shape that a file states, so such
a ray is lost, as is one that leaves the wall through its end faces.

From outside a ray goes   in          through the wall into the tube (or its open end), on way IN
                          beside      through the wall alone, on way 0
                          off         through the wall, totally reflected by the inside, on way OFF
and from inside           out         on way OUT.

The investigation plane may cut a tube.  What reaches it first ends there: seen in the tube if it is inside, lost
(MISSED_PLANE) in the wall, where nothing flows.  Each surface is a cylinder of ``tracer.kernels.refraction``; the
one that comes next is known from where the ray is, so no root is chosen by a tolerance.
"""

import math

from ground.jit import Array, kernel
from tracer.kernels.refraction import (
    across,
    on_cylinder_rates,
    on_plane_rates,
    outward,
    refracted,
    refracted_rates,
)
from tracer.kernels.rooms import IN, OUT, THROUGH
from tracer.kernels.sphere import transmittance
from tracer.kernels.world import BLOCKED, ENTERED, MISSED_PLANE, OFF_INSIDE, RECOVERED, TIR

START, AXIS, LENGTH, OUTER, INNER, WALL, FILLED = 0, 3, 6, 7, 8, 9, 10


@kernel
def reach(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[float, float, bool]:
    """Where a line goes into and out of the closed tube, and whether it goes in by the round side."""
    m, b2, e2, at = across(px, py, pz, dx, dy, dz, row[0], row[1], row[2], row[3], row[4], row[5])
    radius = row[OUTER]
    if not b2 < radius * radius:
        return math.inf, -math.inf, True
    near, far = -math.inf, math.inf
    if e2 > 0.0:
        h = math.sqrt((radius * radius - b2) / e2)
        near, far = m - h, m + h
    slope = dx * row[3] + dy * row[4] + dz * row[5]
    if slope == 0.0:
        return (near, far, True) if 0.0 < at < row[LENGTH] else (math.inf, -math.inf, True)
    one, two = m - at / slope, m + (row[LENGTH] - at) / slope
    first, last = min(one, two), max(one, two)
    return max(near, first), min(far, last), near >= first


@kernel
def meets_tube(px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array) -> float:
    """Distance to where the ray goes in; inf if it does not, or meets the investigation plane first."""
    first, last, _ = reach(px, py, pz, dx, dy, dz, row)
    return first if 0.0 < first < last and pz + first * dz > 0.0 else math.inf


@kernel
def to_ends(px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array) -> float:
    """Distance to where a ray from between the planes of the two ends passes one of them."""
    along = (px - row[0]) * row[3] + (py - row[1]) * row[4] + (pz - row[2]) * row[5]
    slope = dx * row[3] + dy * row[4] + dz * row[5]
    if slope == 0.0:
        return math.inf
    return float(max(-along / slope, (row[LENGTH] - along) / slope))


@kernel
def in_wall(px: float, py: float, pz: float, dx: float, dy: float, dz: float, t: float, row: Array) -> int:
    """What becomes of a ray in the wall before it has gone the distance t: RECOVERED if nothing."""
    end = to_ends(px, py, pz, dx, dy, dz, row)
    plane = -pz / dz if dz < 0.0 else math.inf
    if t < min(end, plane):
        return RECOVERED
    return BLOCKED if end < plane else MISSED_PLANE


@kernel
def to_round_side(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array, which: int, side: float
) -> float:
    """Distance to where a ray meets one surface of a tube, on the near (-1) or far (1) side."""
    m, b2, e2, _ = across(px, py, pz, dx, dy, dz, row[0], row[1], row[2], row[3], row[4], row[5])
    return m + side * math.sqrt(max(0.0, row[which] * row[which] - b2) / e2)


@kernel
def out_of_wall(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """From a point of the wall out through its round side: as `Kind.cross`, light of this surface alone.

    Who came through the same side leaves it at the same angle: totally reflected by rounding only, at a tangent.
    """
    n = row[WALL]
    t = to_round_side(px, py, pz, dx, dy, dz, row, OUTER, 1.0)
    lost = in_wall(px, py, pz, dx, dy, dz, t, row)
    if lost != RECOVERED:
        return lost, px, py, pz, dx, dy, dz, 0.0, 0.0
    qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
    nx, ny, nz = outward(qx, qy, qz, row[0], row[1], row[2], row[3], row[4], row[5], -row[OUTER])
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, n * t, 0.0
    return RECOVERED, qx, qy, qz, ex, ey, ez, n * t, transmittance(c1, c2, 1.0 / n)


@kernel
def cross_tube(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """From outside into the tube, or through its wall alone, as `Kind.cross`."""
    sx, sy, sz, kx, ky, kz = row[0], row[1], row[2], row[3], row[4], row[5]
    n, filled = row[WALL], row[FILLED]
    t, _, by_side = reach(px, py, pz, dx, dy, dz, row)
    qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
    if not by_side:
        _, b2, _, _ = across(qx, qy, qz, kx, ky, kz, sx, sy, sz, kx, ky, kz)
        open_end = b2 < row[INNER] * row[INNER] and filled == 1.0
        return ENTERED if open_end else BLOCKED, qx, qy, qz, dx, dy, dz, t, 1.0
    nx, ny, nz = outward(qx, qy, qz, sx, sy, sz, kx, ky, kz, row[OUTER])
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, 1.0 / n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, t, 0.0
    surface = transmittance(c1, c2, n)
    path, fate, light = t, RECOVERED, surface * surface
    m, b2, e2, _ = across(qx, qy, qz, ex, ey, ez, sx, sy, sz, kx, ky, kz)
    if b2 < row[INNER] * row[INNER]:
        t = m - math.sqrt((row[INNER] * row[INNER] - b2) / e2)
        lost = in_wall(qx, qy, qz, ex, ey, ez, t, row)
        if lost != RECOVERED:
            return lost, qx, qy, qz, ex, ey, ez, path, 0.0
        qx, qy, qz, path = qx + t * ex, qy + t * ey, qz + t * ez, path + n * t
        nx, ny, nz = outward(qx, qy, qz, sx, sy, sz, kx, ky, kz, row[INNER])
        ex, ey, ez, c1, c2 = refracted(ex, ey, ez, nx, ny, nz, n / filled)
        if c2 > 0.0:
            return ENTERED, qx, qy, qz, ex, ey, ez, path, surface * transmittance(c1, c2, filled / n)
        fate = OFF_INSIDE
    lost, qx, qy, qz, ex, ey, ez, more, _ = out_of_wall(qx, qy, qz, ex, ey, ez, row)
    return lost if lost != RECOVERED else fate, qx, qy, qz, ex, ey, ez, path + more, light


@kernel
def leave_tube(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """From inside out of the tube, as `Kind.leave`; paths are / n of what is around."""
    sx, sy, sz, kx, ky, kz = row[0], row[1], row[2], row[3], row[4], row[5]
    n, filled = row[WALL], row[FILLED]
    m, b2, e2, _ = across(px, py, pz, dx, dy, dz, sx, sy, sz, kx, ky, kz)
    t = m + math.sqrt(max(0.0, row[INNER] * row[INNER] - b2) / e2) if e2 > 0.0 else math.inf
    end = to_ends(px, py, pz, dx, dy, dz, row)
    s = min(t, end)
    qx, qy, qz, path = px + s * dx, py + s * dy, pz + s * dz, filled * s
    if not qz > 0.0:
        return RECOVERED, px, py, pz, dx, dy, dz, 0.0, 1.0
    if end < t:
        return ENTERED if filled == 1.0 else BLOCKED, qx, qy, qz, dx, dy, dz, path, 1.0
    nx, ny, nz = outward(qx, qy, qz, sx, sy, sz, kx, ky, kz, -row[INNER])
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, filled / n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, path, 0.0
    light = transmittance(c1, c2, n / filled)
    lost, qx, qy, qz, ex, ey, ez, more, surface = out_of_wall(qx, qy, qz, ex, ey, ez, row)
    return ENTERED if lost == RECOVERED else lost, qx, qy, qz, ex, ey, ez, path + more, light * surface


@kernel
def surface_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, t: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float,
    row: Array, rate: Array, which: int, side: float, e: float, e_rate: float,
) -> tuple[float, ...]:  # fmt: skip
    """Point and direction behind one surface of a tube, OUTER or INNER, at distance t, and their derivatives.

    `side` is 1 where the outward normal looks against the ray, else -1.
    """
    sx, sy, sz, kx, ky, kz = row[0], row[1], row[2], row[3], row[4], row[5]
    qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
    nx, ny, nz = outward(qx, qy, qz, sx, sy, sz, kx, ky, kz, row[which])
    fx, fy, fz, rx, ry, rz = on_cylinder_rates(
        qx, qy, qz, dx, dy, dz, t, nx, ny, nz, sx, sy, sz, kx, ky, kz, row[which], fx, fy, fz, ux, uy, uz,
        rate[0], rate[1], rate[2], rate[3], rate[4], rate[5], rate[which],
    )  # fmt: skip
    nx, ny, nz, rx, ry, rz = side * nx, side * ny, side * nz, side * rx, side * ry, side * rz
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, e)
    ux, uy, uz = refracted_rates(dx, dy, dz, nx, ny, nz, e, c1, c2, ux, uy, uz, rx, ry, rz, e_rate)
    return qx, qy, qz, ex, ey, ez, fx, fy, fz, ux, uy, uz


@kernel
def tube_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float, row: Array, rate: Array, way: int,
) -> tuple[float, ...]:  # fmt: skip
    """Derivatives of point and direction behind, on the way that the ray took, as `Kind.rates`."""
    n, filled = row[WALL], row[FILLED]
    n_rate = rate[WALL]
    into, out_of = 1.0 / n, n
    into_rate = -n_rate / (n * n)
    if way == OUT:
        t = to_round_side(px, py, pz, dx, dy, dz, row, INNER, 1.0)
        if to_ends(px, py, pz, dx, dy, dz, row) < t:  # through the open end
            return end_rates(px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, row, rate)
        e, e_rate = filled / n, (rate[FILLED] - filled / n * n_rate) / n
        px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz = surface_rates(
            px, py, pz, dx, dy, dz, t, fx, fy, fz, ux, uy, uz, row, rate, INNER, -1.0, e, e_rate
        )
        t = to_round_side(px, py, pz, dx, dy, dz, row, OUTER, 1.0)
        _, _, _, _, _, _, fx, fy, fz, ux, uy, uz = surface_rates(
            px, py, pz, dx, dy, dz, t, fx, fy, fz, ux, uy, uz, row, rate, OUTER, -1.0, out_of, n_rate
        )
        return fx, fy, fz, ux, uy, uz
    t, _, by_side = reach(px, py, pz, dx, dy, dz, row)
    if not by_side:
        return end_rates(px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, row, rate)
    px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz = surface_rates(
        px, py, pz, dx, dy, dz, t, fx, fy, fz, ux, uy, uz, row, rate, OUTER, 1.0, into, into_rate
    )
    if way != THROUGH:
        t = to_round_side(px, py, pz, dx, dy, dz, row, INNER, -1.0)
        e, e_rate = n / filled, (n_rate - n / filled * rate[FILLED]) / filled
        px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz = surface_rates(
            px, py, pz, dx, dy, dz, t, fx, fy, fz, ux, uy, uz, row, rate, INNER, 1.0, e, e_rate
        )
        if way == IN:
            return fx, fy, fz, ux, uy, uz
    t = to_round_side(px, py, pz, dx, dy, dz, row, OUTER, 1.0)
    _, _, _, _, _, _, fx, fy, fz, ux, uy, uz = surface_rates(
        px, py, pz, dx, dy, dz, t, fx, fy, fz, ux, uy, uz, row, rate, OUTER, -1.0, out_of, n_rate
    )
    return fx, fy, fz, ux, uy, uz


@kernel
def end_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float, row: Array, rate: Array,
) -> tuple[float, ...]:  # fmt: skip
    """Through an open end nothing is bent; only where the piece ends is set anew, which the ray does not feel."""
    along = (px - row[0]) * row[3] + (py - row[1]) * row[4] + (pz - row[2]) * row[5]
    slope = dx * row[3] + dy * row[4] + dz * row[5]
    low = along < 0.0 or (slope < 0.0 and not along > row[LENGTH])
    target = 0.0 if low else row[LENGTH]
    t = (target - along) / slope
    fx, fy, fz = on_plane_rates(dx, dy, dz, t, row[3], row[4], row[5], fx, fy, fz, ux, uy, uz, 0.0)
    return fx, fy, fz, ux, uy, uz
