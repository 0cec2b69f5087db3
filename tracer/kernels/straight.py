"""Blocks whose way is known beforehand: straight to the plane, or through the only sphere there is.

They hold what a block of ``tracer.kernels.chain`` holds when it is finished: the plane point in columns PX, PY
(NaN: the ray does not go down).
"""

import math

from ground.jit import Array, kernel
from tracer.kernels.camera import (
    EYE_X,
    EYE_Y,
    EYE_Z,
    axes_of,
)
from tracer.kernels.chain import COS_I, COS_T, DX, DY, DZ, IQ, NEAR, PICK, PX, PY, PZ, QQ, foot_of


@kernel
def direct_block(x: Array, y: Array, camera: Array, rays: Array, trips: Array) -> None:
    """Trace a block (n,) that no glass touches."""
    ox, oy, oz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    for i in range(x.shape[0]):
        dx = c3 * x[i] + c6 * y[i] + c9
        dy = c4 * x[i] + c7 * y[i] + c10
        dz = c5 * x[i] + c8 * y[i] + c11
        t = -oz / dz
        tx, ty = ox + t * dx, oy + t * dy
        down = dz < 0.0
        rays[PX + i], rays[PY + i] = tx if down else math.nan, ty if down else math.nan
    for i in range(x.shape[0]):
        trips[PICK + i] = 0


@kernel
def lone_block(x: Array, y: Array, camera: Array, balls: Array, rays: Array, trips: Array) -> None:
    """Trace a block (n,) through the only sphere there is: what `begin_block`, `turn` and `land_block` calculate.

    In four passes: a chain of operations through to the plane is longer than the processor looks ahead, and the
    unit for roots would wait.
    """
    count = x.shape[0]
    ox, oy, oz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    cx, cy, cz, r2, ir2, kt = balls[0, 0], balls[0, 1], balls[0, 2], balls[0, 3], balls[0, 4], balls[0, 5]
    nu, gk, ir = balls[0, 6], balls[0, 7], balls[0, 8]
    wx, wy, wz = ox - cx, oy - cy, oz - cz
    for i in range(count):
        dx = c3 * x[i] + c6 * y[i] + c9
        dy = c4 * x[i] + c7 * y[i] + c10
        dz = c5 * x[i] + c8 * y[i] + c11
        square = dx * dx + dy * dy + dz * dz
        inverse = 1.0 / square
        m, ax, ay, az, b2 = foot_of(wx, wy, wz, dx, dy, dz, inverse)
        rays[DX + i], rays[DY + i], rays[DZ + i] = dx, dy, dz
        rays[PX + i], rays[PY + i], rays[PZ + i] = ax, ay, az
        rays[QQ + i], rays[IQ + i], rays[NEAR + i] = square, inverse, b2
        trips[PICK + i] = 1 if (b2 < r2) & (m > 0.0) else 0
    for i in range(count):
        b2, square = rays[NEAR + i], rays[QQ + i]
        rays[COS_I + i] = math.sqrt(max((r2 - b2) * ir2, 0.0) * square)
        rays[COS_T + i] = math.sqrt(max(1.0 - b2 * kt, 0.0) * square)
    for i in range(count):
        ax, ay, az = rays[PX + i], rays[PY + i], rays[PZ + i]
        dx, dy, dz = rays[DX + i], rays[DY + i], rays[DZ + i]
        square, inverse, b2 = rays[QQ + i], rays[IQ + i], rays[NEAR + i]
        cos_i, cos_t, hit = rays[COS_I + i], rays[COS_T + i], trips[PICK + i] != 0
        chi = b2 * ir2
        g = gk * square / (cos_t + cos_i * nu)
        gi = g * inverse
        cosine = 1.0 - 2.0 * chi * g * gi
        q = 2.0 * gi * (cos_i * cos_t + chi * nu * square) * ir
        along = b2 * q * inverse
        px, py, pz = cx + ax * cosine + dx * along, cy + ay * cosine + dy * along, cz + az * cosine + dz * along
        ex, ey, ez = dx * cosine - ax * q, dy * cosine - ay * q, dz * cosine - az * q
        px, py, pz = px if hit else ox, py if hit else oy, pz if hit else oz
        ex, ey, ez = ex if hit else dx, ey if hit else dy, ez if hit else dz
        rays[PX + i], rays[PY + i], rays[PZ + i] = px, py, pz
        rays[DX + i], rays[DY + i], rays[DZ + i] = ex, ey, ez
    land_block(count, rays)


@kernel
def land_block(count: int, rays: Array) -> None:
    """Take the rays to the plane; their points are its points from then on."""
    for i in range(count):
        dz = rays[DZ + i]
        t = -rays[PZ + i] / dz
        tx, ty = rays[PX + i] + t * rays[DX + i], rays[PY + i] + t * rays[DY + i]
        down = dz < 0.0
        rays[PX + i], rays[PY + i] = tx if down else math.nan, ty if down else math.nan
