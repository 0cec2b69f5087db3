"""Where the lens puts what an ideal camera would see elsewhere: Newton on the lens terms, block by block.

The lens formula takes an acquired pixel to the ideal one (``tracer.kernels.camera.undistorted``); nodes are known
by their ideal image coordinates, so it is inverted here, with the derivatives of acquired by ideal coordinates.  A
node that has settled stays while others go on, so that its bits do not depend on them.
"""

import math

from ground.jit import Array, kernel
from tracer.kernels.camera import (
    CENTRE_U,
    CENTRE_V,
    EYE_X,
    EYE_Z,
    FOCAL,
    axes_of,
    lens_of,
    undistorted,
)
from tracer.kernels.chain import LANES, STEP

MAX_STEPS = 25
SETTLED_PX = 1e-10
X, Y, XA, XB, YB, WANTED_X, WANTED_Y = (k * STEP for k in range(7))  # columns of a block


@kernel
def acquire_block(count: int, camera: Array, b: Array) -> None:
    """Turn ideal image coordinates X, Y into acquired ones, with derivatives XA, XB, YB; see `acquire_row`."""
    k1, k2, k3, p1, p2 = lens_of(camera)
    settled = SETTLED_PX / camera[FOCAL]
    for i in range(count):
        b[WANTED_X + i], b[WANTED_Y + i], b[XA + i] = b[X + i], b[Y + i], math.inf
    for _ in range(MAX_STEPS):
        moving = 0
        for i in range(count):
            x, y = b[X + i], b[Y + i]
            a, e, radial, slope = undistorted(x, y, k1, k2, k3, p1, p2)
            xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
            xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
            yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
            r = 1.0 / (xx * yy - xy * xy)
            a, e = b[WANTED_X + i] - a, b[WANTED_Y + i] - e
            dx, dy = (yy * a - xy * e) * r, (xx * e - xy * a) * r
            goes = b[XA + i] == math.inf
            done = abs(dx) + abs(dy) < settled
            new_x, new_y, xa, xb, yb = x + dx, y + dy, yy * r, -xy * r, xx * r
            xa = xa if done else math.inf
            b[X + i], b[Y + i] = new_x if goes else x, new_y if goes else y
            b[XA + i] = xa if goes else b[XA + i]
            b[XB + i], b[YB + i] = xb if goes else b[XB + i], yb if goes else b[YB + i]
            moving += goes & (not done)
        if moving == 0:
            break


@kernel
def ideal_block(first: int, count: int, wy: float, grid: Array, camera: Array, b: Array) -> None:
    """Ideal image coordinates X, Y of one block of nodes; see `acquire_row`."""
    px, pz, x0, pitch = camera[EYE_X], camera[EYE_Z], grid[0], grid[2]
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    for i in range(count):
        wx = x0 + (first + i) * pitch - px
        inverse = 1.0 / (c9 * wx + c10 * wy - c11 * pz)
        b[X + i], b[Y + i] = (c3 * wx + c4 * wy - c5 * pz) * inverse, (c6 * wx + c7 * wy - c8 * pz) * inverse


@kernel
def acquire_row(wy: float, grid: Array, camera: Array, block: Array, lens: Array) -> None:
    """Acquired pixels of the nodes of a row that lies wy from the pinhole: Newton on the lens terms.

    ``lens`` (6, w) receives u, v and the derivatives of acquired by ideal pixels (du/da, du/db, dv/da, dv/db);
    NaN where the lens formula does not settle.  A node that has settled stays while others go on.  ``block`` is
    scratch (RAY_NUMBERS,).
    """
    focal, u0, v0 = camera[FOCAL], camera[CENTRE_U], camera[CENTRE_V]
    width = lens.shape[1]
    for low in range(0, width, LANES):
        count = min(LANES, width - low)
        ideal_block(low, count, wy, grid, camera, block)
        acquire_block(count, camera, block)
        for i in range(count):
            lens[0, low + i] = u0 + focal * block[X + i] if block[XA + i] < math.inf else math.nan
            lens[1, low + i] = v0 + focal * block[Y + i]
        for i in range(count):
            lens[2, low + i] = block[XA + i]
            lens[3, low + i] = block[XB + i]
        for i in range(count):
            lens[4, low + i] = block[XB + i]
            lens[5, low + i] = block[YB + i]
