"""The renderer's loops over millions of rays: textbook optics, written apart from the tracer on purpose.

A pixel is sampled by n x n rays.  Sample (i, j) lies at ((i + (j + 1/2)/n)/n, (j + (i + 1/2)/n)/n) of the
pixel: one in each of the n x n cells and one in each of the n^2 columns and rows, so edges along the pixel
rows are resolved as finely as slanted ones.  Every pixel shifts that pattern by its own random vector
(with wrap-around), drawn from a hash of seed, row and column: the error of an edge is noise, never a bias,
and the same for any number of threads.

How a ray goes on from body to body stands in ``sim.renderer.kernels.surfaces``.

Vectors are three scalars each: numba keeps them in registers.
"""

import numpy as np
from numpy.typing import NDArray

from ground.jit import kernel, kernel_inlined
from sim.renderer.kernels.surfaces import (
    BLOCKED,
    SOLID,
    Float64,
    World,
    entry_rod,
    entry_sphere,
    far_side,
    snell,
    through_cores,
)
from sim.renderer.kernels.uneven import crossing, is_uneven, normal_at
from sim.renderer.kernels.walls import FACET, INSIDE, LOST, next_wall

Float32 = NDArray[np.float32]
Int64 = NDArray[np.int64]
Place = tuple[float, float, float]

NOTHING, WALL, STOP = -1, -2, -3  # what a ray meets that is no ball
SURFACES = 8  # most crossings of one wall
BEHIND_MM = 1e-3  # rounding at a body that touches the sheet is far less
GOLDEN_ANGLE_RAD = np.pi * (3.0 - np.sqrt(5.0))


@kernel
def pixel_shift(seed: int, row: int, column: int) -> tuple[float, float, float]:
    """Three numbers in [0, 1) that belong to a pixel (splitmix64 of seed, row and column)."""
    state = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15)
    state ^= np.uint64(row) * np.uint64(0xC2B2AE3D27D4EB4F) + np.uint64(column) * np.uint64(0x165667B19E3779F9)
    first = second = third = 0.0
    for turn in range(3):
        state += np.uint64(0x9E3779B97F4A7C15)
        word = state
        word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        word ^= word >> np.uint64(31)
        number = float(word >> np.uint64(11)) * 2.0**-53
        if turn == 0:
            first = number
        elif turn == 1:
            second = number
        else:
            third = number
    return first, second, third


@kernel_inlined
def pass_body(
    o: Place, d: Place, power: float, last: int, in_glass: bool, farthest: float, world: World
) -> tuple[Place, Place, float, int, bool, float, int]:
    """Follow one ray to the body that it meets first and through it: a whole ball, or one surface of a wall.

    Returns point and direction behind it, power (0: stopped), the ball just left, whether the ray is in a wall,
    the path up to the body, and what was met: a ball, WALL, STOP (opaque) or NOTHING nearer than `farthest`.
    """
    _, spheres, rods, walls, _, _ = world
    (ox, oy, oz), (dx, dy, dz) = o, d
    nearest = farthest
    body = NOTHING
    if walls.shape[0] > 0:
        t, nx, ny, nz, before, behind, beyond, which = next_wall(ox, oy, oz, dx, dy, dz, walls)
        if t < nearest:
            nearest, body = t, WALL
    for index in range(spheres.shape[0] if not in_glass else 0):
        if index != last:
            s = spheres[index]
            if is_uneven(s):
                t = crossing(ox, oy, oz, dx, dy, dz, s, True)
            else:
                t = entry_sphere(ox, oy, oz, dx, dy, dz, s, s[3])
            if t < nearest:
                nearest, body = t, index
    for index in range(rods.shape[0]):
        t = entry_rod(ox, oy, oz, dx, dy, dz, rods[index])
        if t < nearest:
            nearest, body = t, STOP
    if body == STOP:
        return o, d, BLOCKED, last, in_glass, nearest, STOP
    if body == NOTHING:
        return o, d, power, last, in_glass, nearest, NOTHING
    if body == WALL:
        if which == LOST:
            return o, d, BLOCKED, last, in_glass, nearest, WALL
        ox, oy, oz = ox + nearest * dx, oy + nearest * dy, oz + nearest * dz
        ex, ey, ez, part = snell(dx, dy, dz, nx, ny, nz, before / behind)
        if part > 0.0:
            return (ox, oy, oz), (ex, ey, ez), power * part, -1, beyond, nearest, WALL
        if which not in (INSIDE, FACET) or beyond:
            return o, d, BLOCKED, last, in_glass, nearest, WALL
        along = 2.0 * (
            dx * nx + dy * ny + dz * nz
        )  # in the wall of a tube, off its inside; in a block, off any face
        d = (dx - along * nx, dy - along * ny, dz - along * nz)
        return (ox, oy, oz), d, power, last, in_glass, nearest, WALL
    s = spheres[body]
    if s[5] != 0.0:
        return o, d, BLOCKED, last, in_glass, nearest, STOP
    # In: the outward normal is against the ray.
    ox, oy, oz = ox + nearest * dx, oy + nearest * dy, oz + nearest * dz
    nx, ny, nz = (ox - s[0]) / s[3], (oy - s[1]) / s[3], (oz - s[2]) / s[3]
    if is_uneven(s):
        nx, ny, nz = normal_at(ox, oy, oz, s)
    dx, dy, dz, part = snell(dx, dy, dz, nx, ny, nz, 1.0 / s[4])
    power *= part
    if s.shape[0] > SOLID:
        ox, oy, oz, dx, dy, dz, part = through_cores(ox, oy, oz, dx, dy, dz, s)
        power *= part
    # Out: far root of the same quadratic, inward normal.
    if is_uneven(s):
        t = crossing(ox, oy, oz, dx, dy, dz, s, False)
        ox, oy, oz = ox + t * dx, oy + t * dy, oz + t * dz
        nx, ny, nz = normal_at(ox, oy, oz, s)
        nx, ny, nz = -nx, -ny, -nz
    else:
        ox, oy, oz = far_side(ox, oy, oz, dx, dy, dz, s, s[3])
        nx, ny, nz = (s[0] - ox) / s[3], (s[1] - oy) / s[3], (s[2] - oz) / s[3]
    dx, dy, dz, part = snell(dx, dy, dz, nx, ny, nz, s[4])
    return (ox, oy, oz), (dx, dy, dz), power * part, body, in_glass, nearest, body


@kernel
def last_way(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, world: World
) -> tuple[float, float, float, float, float, float, float, int]:
    """Follow one ray to the straight way on which it meets the plane: its origin, direction, transmittance, chain.

    T = 0 if it does not arrive.  `chain` differs between rays that went through other bodies or in another order;
    0 went through none.
    """
    _, spheres, _, walls, _, plane = world
    o, d = (ox, oy, oz), (dx, dy, dz)
    transmittance = 1.0
    last = -1
    chain = 0
    in_glass = False
    for _ in range(2 * spheres.shape[0] + 2 + SURFACES * walls.shape[0]):
        fall = d[0] * plane[3, 0] + d[1] * plane[3, 1] + d[2] * plane[3, 2]
        height = (
            (o[0] - plane[0, 0]) * plane[3, 0]
            + (o[1] - plane[0, 1]) * plane[3, 1]
            + (o[2] - plane[0, 2]) * plane[3, 2]
        )
        if last >= 0 and height < -BEHIND_MM:  # out of a body that stands beside the sheet, and past it
            return o[0], o[1], o[2], d[0], d[1], d[2], BLOCKED, chain
        farthest = max(-height / fall, 0.0) if fall < 0.0 else np.inf
        if in_glass:  # a face that lies on the sheet is met before it
            farthest += BEHIND_MM
        o, d, transmittance, last, in_glass, t, body = pass_body(
            o, d, transmittance, last, in_glass, farthest, world
        )
        if body == NOTHING:
            arrives = t < np.inf and not in_glass
            return o[0], o[1], o[2], d[0], d[1], d[2], transmittance if arrives else BLOCKED, chain
        if transmittance <= 0.0:
            return o[0], o[1], o[2], d[0], d[1], d[2], BLOCKED, chain
        if body >= 0:
            chain = chain * (spheres.shape[0] + 1) + body + 1
    return o[0], o[1], o[2], d[0], d[1], d[2], BLOCKED, chain


@kernel
def to_plane(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, world: World
) -> tuple[float, float, float]:
    """Follow one ray to the plane: (x, y, transmittance) in the plane's own axes, arguments as of `last_way`."""
    ox, oy, oz, dx, dy, dz, transmittance, _ = last_way(ox, oy, oz, dx, dy, dz, world)
    plane = world.plane
    if transmittance <= 0.0:
        return 0.0, 0.0, BLOCKED
    x, y, z = ox - plane[0, 0], oy - plane[0, 1], oz - plane[0, 2]
    fall = dx * plane[3, 0] + dy * plane[3, 1] + dz * plane[3, 2]
    t = max(-(x * plane[3, 0] + y * plane[3, 1] + z * plane[3, 2]) / fall, 0.0)
    x, y, z = x + t * dx, y + t * dy, z + t * dz
    u = x * plane[1, 0] + y * plane[1, 1] + z * plane[1, 2]
    v = x * plane[2, 0] + y * plane[2, 1] + z * plane[2, 2]
    return u, v, transmittance


@kernel_inlined
def straight_to_plane(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, plane: Float64
) -> tuple[float, float, float]:
    """Follow a ray that meets no body to the plane, as `to_plane`; BLOCKED if it goes the other way."""
    fall = dx * plane[3, 0] + dy * plane[3, 1] + dz * plane[3, 2]
    if not fall < 0.0:
        return 0.0, 0.0, BLOCKED
    x, y, z = ox - plane[0, 0], oy - plane[0, 1], oz - plane[0, 2]
    t = max(-(x * plane[3, 0] + y * plane[3, 1] + z * plane[3, 2]) / fall, 0.0)
    x, y, z = x + t * dx, y + t * dy, z + t * dz
    u = x * plane[1, 0] + y * plane[1, 1] + z * plane[1, 2]
    v = x * plane[2, 0] + y * plane[2, 1] + z * plane[2, 2]
    return u, v, 1.0


@kernel_inlined
def camera_ray(
    u: float, v: float, lens_u: float, lens_v: float, camera: Float64
) -> tuple[float, float, float, float, float, float]:
    """Origin and unit direction in the world of the ray through an acquired pixel and a point of the pupil.

    `camera`: focal_px, c_u, c_v, pinhole (3), rotation (9), k1, k2, k3, p1, p2, pupil radius and focus depth [mm];
    of a tilted sensor also its axes in the frame of the lens (6), 1 / image distance and the nearest focus [mm].
    """
    x, y = (u - camera[1]) / camera[0], (v - camera[2]) / camera[0]
    focus = camera[21]
    if camera[24] != 0.0 or camera[27] != 0.0:
        # A pixel that lies farther behind the lens is sharp nearer to it: 1/focus + 1/image distance = 1/f.
        back = 1.0 + x * camera[24] + y * camera[27]
        x, y = (x * camera[22] + y * camera[25]) / back, (x * camera[23] + y * camera[26]) / back
        focus /= 1.0 + focus * camera[28] * (1.0 - 1.0 / back)
    r2 = x * x + y * y
    gain = 1.0 + camera[15] * r2 + camera[16] * r2 * r2 + camera[17] * r2 * r2 * r2
    right = x * gain + 2.0 * camera[18] * x * y + camera[19] * (r2 + 2.0 * x * x)
    down = y * gain + camera[18] * (r2 + 2.0 * y * y) + 2.0 * camera[19] * x * y
    # A pupil point moves the origin sideways; all rays of a pixel meet again in the focus plane.
    right -= lens_u / focus
    down -= lens_v / focus
    length = np.sqrt(right * right + down * down + 1.0)
    return (
        camera[3] + lens_u * camera[6] + lens_v * camera[9],
        camera[4] + lens_u * camera[7] + lens_v * camera[10],
        camera[5] + lens_u * camera[8] + lens_v * camera[11],
        (right * camera[6] + down * camera[9] + camera[12]) / length,
        (right * camera[7] + down * camera[10] + camera[13]) / length,
        (right * camera[8] + down * camera[11] + camera[14]) / length,
    )


@kernel
def may_meet(u: float, v: float, camera: Float64, bounds: Float64) -> bool:
    """Return whether a ray of this pixel may meet a ball of `bounds` (x, y, z, radius); errs on the safe side."""
    ox, oy, oz, dx, dy, dz = camera_ray(u, v, 0.0, 0.0, camera)
    for index in range(bounds.shape[0]):
        x, y, z = bounds[index, 0] - ox, bounds[index, 1] - oy, bounds[index, 2] - oz
        depth = dx * x + dy * y + dz * z
        off2 = x * x + y * y + z * z - depth * depth
        far = depth + bounds[index, 3]
        # Twice the pixel's half diagonal, and the pupil at its widest between camera and body.
        reach = bounds[index, 3] + 1.5 * far / camera[0] + camera[20] * (1.0 + far / camera[29])
        if far > 0.0 and off2 < reach * reach:
            return True
    return False


@kernel
def trace_pixels(
    pixels: Int64,
    n: int,
    seed: int,
    world: World,
    pupil_order: Int64,
    points: Float64,
    transmittance: Float32,
    spread: Float64,
) -> None:
    """Trace n x n rays for each pixel (row, column); `pupil_order` is a permutation of n*n.

    Out: `points` (N, n*n, 2) in the plane's axes [mm], `transmittance` (N, n*n), and `spread` (N,), the extent
    of the arriving points [mm], infinite if only some arrive.
    """
    count = n * n
    camera, _, _, walls, bounds, plane = world
    for index in range(pixels.shape[0]):
        row, column = pixels[index, 0], pixels[index, 1]
        shift_u, shift_v, turn = pixel_shift(seed, row, column)
        # Behind a wall no ray is straight, so that none may be passed over.
        meets = walls.shape[0] > 0 or (bounds.shape[0] > 0 and may_meet(float(column), float(row), camera, bounds))
        low_x = low_y = np.inf
        high_x = high_y = -np.inf
        arrived = 0
        for i in range(n):
            for j in range(n):
                k = i * n + j
                su = (i + (j + 0.5) / n) / n + shift_u
                sv = (j + (i + 0.5) / n) / n + shift_v
                u, v = column - 0.5 + su - np.floor(su), row - 0.5 + sv - np.floor(sv)
                lens_u = lens_v = 0.0
                if camera[20] > 0.0:
                    # Vogel's disc; the shuffle unties the place in the pupil from the place in the pixel.
                    radius = camera[20] * np.sqrt((pupil_order[k] + turn) / count)
                    angle = GOLDEN_ANGLE_RAD * pupil_order[k] + 2.0 * np.pi * turn
                    lens_u, lens_v = radius * np.cos(angle), radius * np.sin(angle)
                ox, oy, oz, dx, dy, dz = camera_ray(u, v, lens_u, lens_v, camera)
                if meets:
                    x, y, part = to_plane(ox, oy, oz, dx, dy, dz, world)
                else:
                    x, y, part = straight_to_plane(ox, oy, oz, dx, dy, dz, plane)
                points[index, k, 0], points[index, k, 1] = x, y
                transmittance[index, k] = part
                if part > 0.0:
                    arrived += 1
                    low_x, high_x = min(low_x, x), max(high_x, x)
                    low_y, high_y = min(low_y, y), max(high_y, y)
        spread[index] = max(high_x - low_x, high_y - low_y) if arrived == count else (np.inf if arrived else 0.0)


@kernel
def average_weighted(values: Float32, weights: Float32, out: Float32) -> None:
    """Mean over the samples of a pixel, (N, S) -> (N,): light that does not arrive counts as dark."""
    for index in range(values.shape[0]):
        total = 0.0
        for k in range(values.shape[1]):
            total += values[index, k] * weights[index, k]
        out[index] = total / values.shape[1]
