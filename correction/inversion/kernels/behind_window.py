"""The direct view through one window: which ray leads to a node has one unknown, not two.

The faces are parallel, N is their unit normal towards the camera.  From the pinhole E to the node X it is

    along = -(X - E) . N = h + T + d,   L = (X - E) + along N,   r = |L|

with h before the plate, T in it (index n) and d behind it (index n', both in units of the medium before).  The ray
stays in the plane of N and L.  If it leaves E at an angle theta to N, t = tan theta, it has moved sideways by

    r = t F(t^2),   F(q) = h + T/a + d/b,   a = sqrt(n^2 + (n^2 - 1) q),   b = sqrt(n'^2 + (n'^2 - 1) q)

as Snell's law has it (tan of the angle in the plate: t/a; behind it: t/b).  For n, n' >= 1 the right side grows
and is concave, so Newton goes up to the root from t = r/F(0), which is too small, and never past it:

    dr/dt = S = h + T n^2/a^3 + d n'^2/b^3.

A step ds leaves at most c ds^2 with c = 0.43 (T sqrt(n^2 - 1)/n^2 + d sqrt(n'^2 - 1)/n'^2)/h, because the second
derivative of t/a is at most 0.86 sqrt(n^2 - 1)/n^2 and S >= h: behind a plate alone the first step is the last.

The direction in the medium before is D = -N + G L with G = t/r = 1/F(t^2), which needs no division by r.  If the
node moves by dX: dalong = -dX . N = dd, dL = dX - (dX . N) N, and from dr = S dt + (t/b) dd

    d(t^2) = 2 (G L . dX - (t^2/b) dd) / S,
    dG = G^2 (K d(t^2) - dd/b),   K = (T (n^2 - 1)/a^3 + d (n'^2 - 1)/b^3) / 2.

The node is seen if both faces are met within the opening, the node lies behind the plate, and the ray behind the
plate, from (h + T/a) G L beside the foot of E and along -N + (G/b) L, meets no sphere.  Anything else that stands
behind the window (many spheres, opaque ones, another window) is left to the sheets, which find the same view.
"""

import math
from typing import NamedTuple

import numpy as np

from correction.inversion.kernels.direct import (
    BEHIND_BODY,
    BEHIND_GLASS,
    FREE,
    XA,
    XB,
    YB,
    X,
    Y,
    acquire_block,
    begin_views,
    place_pixels,
)
from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.camera import CENTRE_U, CENTRE_V, EYE_X, EYE_Y, EYE_Z, FOCAL, axes_of
from tracer.kernels.chain import IQ, PICK, TRIP, clear_picks, intersect
from tracer.kernels.packets import DX, DY, DZ, LANES, PX, PY, PZ, STEP
from tracer.kernels.window import BEHIND, GLASS, OPENING, THICKNESS

LX, LY, LZ, ASIDE, DEEP, TANGENT, A, B, G, SLOPE, U, V, UC, UR, VC, VR = (k * STEP for k in range(16))
BLOCK_NUMBERS = 16 * STEP
MAX_STEPS = 25
EXACT = 1e-15  # of tan theta, what a last step may leave
USUAL = 0.01  # a start is not taken further past the root than Newton comes back from at once


@kernel_inlined
def plate_of(window: Array) -> tuple[float, ...]:
    """Normal, thickness, n, n', and n^2, n'^2, n^2 - 1, n'^2 - 1 of a window."""
    nx, ny, nz, thickness = window[3], window[4], window[5], window[THICKNESS]
    n, behind = window[GLASS], window[BEHIND]
    gain, gain_behind = (n - 1.0) * (n + 1.0), (behind - 1.0) * (behind + 1.0)
    return nx, ny, nz, thickness, n, behind, n * n, behind * behind, gain, gain_behind


@kernel
def aim_block(first: int, count: int, wy: float, grid: Array, camera: Array, window: Array, b: Array) -> None:
    """Tangents of the rays to `count` nodes from column `first` on, of a row that lies wy from the pinhole."""
    px, py, pz, x0, pitch = camera[EYE_X], camera[EYE_Y], camera[EYE_Z], grid[0], grid[2]
    nx, ny, nz, thickness, n, behind, n2, m2, gain, gain_behind = plate_of(window)
    h = (px - window[0]) * nx + (py - window[1]) * ny + (pz - window[2]) * nz
    bent, bent_behind = 0.5 * thickness * gain / (n * n2), 0.5 * gain_behind / (behind * m2)
    for i in range(count):
        wx = x0 + (first + i) * pitch - px
        along = pz * nz - wx * nx - wy * ny
        lx, ly, lz = wx + along * nx, wy + along * ny, along * nz - pz
        deep = max(along - h - thickness, 0.0)
        aside = math.sqrt(lx * lx + ly * ly + lz * lz)
        b[LX + i], b[LY + i], b[LZ + i], b[DEEP + i], b[ASIDE + i] = lx, ly, lz, deep, aside
        inverse = 1.0 / (h + thickness / n + deep / behind)
        t = aside * inverse
        more = t * t * (bent + deep * bent_behind) * inverse  # of the next order: mostly, one step is then enough
        b[TANGENT + i], b[A + i] = t + (t * more if more < USUAL else 0.0), math.inf
    deepest = max(b[DEEP], b[DEEP + count - 1])  # the nodes stand in a line
    most_bent = 0.43 * (thickness * math.sqrt(gain) / n2 + deepest * math.sqrt(gain_behind) / m2)
    settled = math.sqrt(EXACT * h / (most_bent + EXACT * h))
    for _ in range(MAX_STEPS):
        moving = 0
        for i in range(count):
            t, deep, last = b[TANGENT + i], b[DEEP + i], b[A + i]
            q = t * t
            ia, ib = 1.0 / math.sqrt(n2 + gain * q), 1.0 / math.sqrt(m2 + gain_behind * q)
            in_glass, beyond = thickness * ia, deep * ib
            slope = h + in_glass * ia * ia * n2 + beyond * ib * ib * m2
            step = (b[ASIDE + i] - t * (h + in_glass + beyond)) / slope
            goes = last > settled
            b[TANGENT + i], b[A + i] = t + step if goes else t, abs(step) if goes else last
            moving += goes & (abs(step) > settled)
        if moving == 0:
            break


@kernel
def leave_block(count: int, grid: Array, camera: Array, window: Array, b: Array) -> None:
    """Ideal image coordinates U, V of a block's nodes, and how they change with the node."""
    px, py, pz, pitch = camera[EYE_X], camera[EYE_Y], camera[EYE_Z], grid[2]
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    nx, ny, nz, thickness, _, _, n2, m2, gain, gain_behind = plate_of(window)
    h = (px - window[0]) * nx + (py - window[1]) * ny + (pz - window[2]) * nz
    for i in range(count):
        q, deep = b[TANGENT + i] * b[TANGENT + i], b[DEEP + i]
        ia, ib = 1.0 / math.sqrt(n2 + gain * q), 1.0 / math.sqrt(m2 + gain_behind * q)
        ia3, ib3 = thickness * ia * ia * ia, deep * ib * ib * ib
        slope = h + ia3 * n2 + ib3 * m2
        inverse = 1.0 / ((h + thickness * ia + deep * ib) * slope)
        g = inverse * slope
        b[A + i], b[B + i], b[G + i] = ia, ib, g
        b[SLOPE + i] = (ia3 * gain + ib3 * gain_behind) * inverse * (h + thickness * ia + deep * ib)
    for i in range(count):
        lx, ly, lz, ib, g = b[LX + i], b[LY + i], b[LZ + i], b[B + i], b[G + i]
        q = b[TANGENT + i] * b[TANGENT + i]
        rate, turned = g * g * b[SLOPE + i] * pitch, g * g * ib * pitch
        g_c, g_r = rate * (g * lx + q * ib * nx) + turned * nx, -rate * (g * ly + q * ib * ny) - turned * ny
        side, down = g * pitch, -g * pitch
        dx, dy, dz = g * lx - nx, g * ly - ny, g * lz - nz
        xc, yc, zc = side * (1.0 - nx * nx) + g_c * lx, g_c * ly - side * nx * ny, g_c * lz - side * nx * nz
        xr, yr, zr = g_r * lx - down * ny * nx, down * (1.0 - ny * ny) + g_r * ly, g_r * lz - down * ny * nz
        inverse = 1.0 / (c9 * dx + c10 * dy + c11 * dz)
        u, v = (c3 * dx + c4 * dy + c5 * dz) * inverse, (c6 * dx + c7 * dy + c8 * dz) * inverse
        away_c, away_r = c9 * xc + c10 * yc + c11 * zc, c9 * xr + c10 * yr + c11 * zr
        b[U + i], b[V + i] = u, v
        b[UC + i] = (c3 * xc + c4 * yc + c5 * zc - u * away_c) * inverse
        b[UR + i] = (c3 * xr + c4 * yr + c5 * zr - u * away_r) * inverse
        b[VC + i] = (c6 * xc + c7 * yc + c8 * zc - v * away_c) * inverse
        b[VR + i] = (c6 * xr + c7 * yr + c8 * zr - v * away_r) * inverse


@kernel
def pass_block(count: int, window: Array, b: Array, light: Array) -> None:
    """What passes both faces, ``light`` (n,) float32: `transmittance` of each, with one division for both."""
    _, _, _, _, n, behind, n2, _, gain, gain_behind = plate_of(window)
    inverse_n, inverse_behind, turn, scale = 1.0 / n, 1.0 / behind, behind / n, 4.0 / n2
    for i in range(count):
        cosine2 = 1.0 / (1.0 + b[TANGENT + i] * b[TANGENT + i])
        m, w, w2 = math.sqrt(cosine2), math.sqrt(gain + cosine2), math.sqrt(gain_behind + cosine2)
        s, p = m + w, n * m + w * inverse_n
        s2, p2 = (w + w2) * inverse_n, turn * inverse_n * w + w2 * inverse_behind
        product = s * p * s2 * p2
        both = (s * s + p * p) * (s2 * s2 + p2 * p2)
        light[i] = np.float32(scale * m * w * w * w2 * both / (product * product))


@kernel
def hide_block(
    count: int, camera: Array, window: Array, balls: Array, b: Array, rays: Array, trips: Array, hidden: Array
) -> None:
    """Note in ``hidden`` (n,) what hides the nodes of a block: the wall around the opening, or a sphere."""
    px, py, pz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    nx, ny, nz, thickness, _, _, _, _, _, _ = plate_of(window)
    sx, sy, sz = px - window[0], py - window[1], pz - window[2]
    h, opening2 = sx * nx + sy * ny + sz * nz, window[OPENING] * window[OPENING]
    sx, sy, sz = sx - h * nx, sy - h * ny, sz - h * nz
    depth = h + thickness
    for i in range(count):
        lx, ly, lz, t, ib, g = b[LX + i], b[LY + i], b[LZ + i], b[TANGENT + i], b[B + i], b[G + i]
        front, back, beyond = h * g, (h + thickness * b[A + i]) * g, g * ib
        fx, fy, fz = sx + front * lx, sy + front * ly, sz + front * lz
        bx, by, bz = back * lx, back * ly, back * lz
        ex, ey, ez = sx + bx, sy + by, sz + bz
        is_open = (fx * fx + fy * fy + fz * fz < opening2) & (ex * ex + ey * ey + ez * ez < opening2)
        hidden[i] = FREE if is_open & (b[DEEP + i] > 0.0) else BEHIND_BODY
        rays[PX + i], rays[PY + i], rays[PZ + i] = px - depth * nx + bx, py - depth * ny + by, pz - depth * nz + bz
        rays[DX + i], rays[DY + i], rays[DZ + i] = beyond * lx - nx, beyond * ly - ny, beyond * lz - nz
        rays[IQ + i] = 1.0 / (1.0 + t * t * ib * ib)
    clear_picks(count, rays, trips)
    for i in range(count):
        trips[TRIP + i] = 0
    for k in range(balls.shape[0]):
        intersect(k, balls, count, rays, trips)
    for i in range(count):
        hidden[i] = BEHIND_GLASS if (hidden[i] == FREE) & (trips[PICK + i] >= 0) else hidden[i]


@kernel
def see_block(low: int, count: int, flat: bool, camera: Array, b: Array, work: Array, lens: Array) -> None:
    """Acquired pixels of a block and their derivatives by column and row, into ``lens`` (6, w) from `low` on."""
    focal, u0, v0 = camera[FOCAL], camera[CENTRE_U], camera[CENTRE_V]
    if flat:
        for i in range(count):
            lens[0, low + i], lens[1, low + i] = u0 + focal * b[U + i], v0 + focal * b[V + i]
            lens[2, low + i], lens[3, low + i] = focal * b[UC + i], focal * b[UR + i]
            lens[4, low + i], lens[5, low + i] = focal * b[VC + i], focal * b[VR + i]
        return
    for i in range(count):
        work[X + i], work[Y + i] = b[U + i], b[V + i]
    acquire_block(count, camera, work)
    for i in range(count):
        xa, xb, yb = focal * work[XA + i], focal * work[XB + i], focal * work[YB + i]
        lens[0, low + i] = u0 + focal * work[X + i] if work[XA + i] < math.inf else math.nan
        lens[1, low + i] = v0 + focal * work[Y + i]
        lens[2, low + i] = xa * b[UC + i] + xb * b[VC + i]
        lens[3, low + i] = xa * b[UR + i] + xb * b[VR + i]
        lens[4, low + i] = xb * b[UC + i] + yb * b[VC + i]
        lens[5, low + i] = xb * b[UR + i] + yb * b[VR + i]


@kernel
def keep_row(lens: Array, pixel: Array, jacobian: Array, weight: Array, light: Array) -> None:
    """Jacobians (4 w,), weights and what passes (w,) of a row; NaN and 0 where there is no pixel."""
    none, nan = np.float32(0.0), math.nan
    for i in range(weight.shape[0]):
        seen = pixel[2 * i] == pixel[2 * i]
        uc, ur, vc, vr = lens[2, i], lens[3, i], lens[4, i], lens[5, i]
        worth = np.float32(min(1.0, abs(uc * vr - ur * vc)) * light[i])
        weight[i] = worth if seen else none
        light[i] = light[i] if seen else none
        uc, ur, vc, vr = uc if seen else nan, ur if seen else nan, vc if seen else nan, vr if seen else nan
        jacobian[4 * i], jacobian[4 * i + 1] = np.float32(uc), np.float32(ur)
        jacobian[4 * i + 2], jacobian[4 * i + 3] = np.float32(vc), np.float32(vr)


class BehindScratch(NamedTuple):
    """Memory of one thread: a block's, ``hidden`` (w,) uint8, ``lens`` (6, w) and ``block`` (BLOCK_NUMBERS,)."""

    rays: Array
    trips: Array
    hidden: Array
    lens: Array
    block: Array


@kernel
def direct_rows_behind(
    optics: tuple[Array, Array, Array], flat: bool, frame: tuple[Array, Array], first: int, last: int,
    scratch: BehindScratch, maps: tuple[Array, ...],
) -> None:  # fmt: skip
    """As `direct_rows`, through one window (10,) in front of transparent spheres.

    `optics`: camera, window and balls (N, BALL); `frame`: grid (3,) and size (2,) of the sensor.
    """
    (camera, window, balls), (rays, trips, hidden, lens, b), grid = optics, scratch, frame[0]
    status, pixel, jacobian, weight, transmittance, branch = maps
    width = status.shape[1]
    for row in range(first, last):
        wy = grid[1] - row * grid[2] - camera[EYE_Y]
        for low in range(0, width, LANES):
            count = min(LANES, width - low)
            aim_block(low, count, wy, grid, camera, window, b)
            leave_block(count, grid, camera, window, b)
            pass_block(count, window, b, transmittance[0, row, low : low + count])
            hide_block(count, camera, window, balls, b, rays, trips, hidden[low : low + count])
            see_block(low, count, flat, camera, b, rays, lens)
        place_pixels(wy, False, frame, camera, lens, hidden, pixel[0, row], status[row])
        keep_row(lens, pixel[0, row], jacobian[0, row], weight[0, row], transmittance[0, row])
        begin_views(row, pixel, jacobian, weight, transmittance, branch)
