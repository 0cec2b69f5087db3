"""The direct view: nodes that are seen past all glass, projected in closed form, row by row.

The grid arrives as (x0, y0, pitch): node (row, column) is (x0 + column pitch, y0 - row pitch).  Jacobians
are d pixel / d node, four numbers: du/dcolumn, du/drow, dv/dcolumn, dv/drow.

The lens formula takes an acquired pixel to the ideal one (``tracer.kernels.camera.undistort``); nodes are known
by their ideal image coordinates, so it is inverted here by Newton, block by block, with the derivatives of
acquired by ideal coordinates.  A node that has settled stays while others go on, so that its bits do not depend on
them.
"""

import math
from typing import NamedTuple

import numpy as np

from correction.node_status import BLOCKED, OUT_OF_FRAME, RECOVERED, RIM
from ground.jit import Array, kernel
from tracer.kernels.branches import NOTHING
from tracer.kernels.camera import (
    CENTRE_U,
    CENTRE_V,
    EYE_X,
    EYE_Y,
    EYE_Z,
    FOCAL,
    axes_of,
    eye_of,
    lens_of,
    undistort,
)
from tracer.kernels.chain import PICK, begin_block, clear_picks, glass_span, insert_span, intersect, place_row
from tracer.kernels.crossed import ends_before, reaches_through
from tracer.kernels.packets import LANES, STEP
from tracer.kernels.rooms import OUTERMOST
from tracer.kernels.sphere import CENTRE_Z, RADIUS
from tracer.kernels.world import Tables, is_stopped, next_body

MAX_STEPS = 25
SETTLED_PX = 1e-10
X, Y, XA, XB, YB, WANTED_X, WANTED_Y = (k * STEP for k in range(7))  # columns of a block
EDGE_PX = 1e-9  # beside the outermost pixel centre and still on it
FREE, BEHIND_GLASS, BEHIND_BODY = 0, 1, 2
WITHIN = 3  # `glass_span` is two nodes wider than a silhouette, at most: so far inside it is certain


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
            a, e, radial, slope = undistort(x, y, k1, k2, k3, p1, p2)
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


class DirectView(NamedTuple):
    """What is seen without glass.

    Parameters
    ----------
    place : (20,) float64
        Camera whose pixels are the nodes: it stands in the pinhole and looks straight down, so that a sphere's
        shadow on a row of nodes is the silhouette that ``tracer.kernels.chain`` knows.
    tables : Tables
        Camera and bodies.
    discs : (N, BALL) float64
        Centres and R^2 in the order of the sphere table.
    lockstep, only_spheres, glass_only, flat : bool
        Solid spheres of glass alone; no other kind of body; all bodies round and of glass; a camera without lens
        terms.
    frame : (3,) and (2,) float64
        Grid, and width and height of the sensor.
    """

    place: Array
    tables: Tables
    discs: Array
    lockstep: bool
    only_spheres: bool
    glass_only: bool
    flat: bool
    frame: tuple[Array, Array]


class DirectScratch(NamedTuple):
    """Memory of one thread: ``x``, ``y`` (w,), ``spans``, a block's, ``hidden`` (w,) uint8 and ``lens`` (6, w)."""

    x: Array
    y: Array
    spans: Array
    rays: Array
    trips: Array
    hidden: Array
    lens: Array


@kernel
def hide_within(
    first: int, last: int, through: bool, place: Array, disc: Array, x: Array, y: float, hidden: Array
) -> None:  # fmt: skip
    """Note which nodes first..last-1 of a row, deep within the silhouette of a sphere, it hides.

    If it reaches through the plane (`through`), it may stand behind a node X, which it hides only if X lies inside
    it or its centre c on the eye's side of X:  |X - c|^2 < R^2  or  (c - X) . (E - X) > 0.
    """
    cx, cy, cz, z = disc[0] - place[EYE_X], disc[1] - place[EYE_Y], disc[2] - place[EYE_Z], place[EYE_Z]
    outside = cx * cx + cy * cy + cz * cz - disc[3]
    for i in range(first, last):
        # X = E + z v with v = (x, -y, -1)
        beyond = z * (x[i] * x[i] + y * y + 1.0) - (cx * x[i] - cy * y - cz)
        inside = outside + z * (2.0 * beyond - z * (x[i] * x[i] + y * y + 1.0)) < 0.0
        hidden[i] = BEHIND_GLASS if (beyond > 0.0) | inside | (not through) else hidden[i]


@kernel
def hide_nodes(row: int, view: DirectView, scratch: DirectScratch) -> None:
    """Note in ``hidden`` what hides the nodes of a row from the pinhole: FREE, BEHIND_GLASS, ...

    Only nodes in shadows are asked for, and where all bodies are round and of glass only those at the shadows'
    rims: of what is deeper in one the sphere itself tells.
    """
    place, tables, discs, lockstep, only_spheres, glass_only, _, _ = view
    x, y, spans, rays, trips, hidden, _ = scratch
    camera, world = tables
    width, bodies = x.shape[0], discs.shape[0]
    walled = world.rooms.home.shape[0] > 0  # behind a wall nothing is seen straight
    for i in range(width):
        hidden[i] = BEHIND_GLASS if walled else FREE
    if walled:
        return
    place_row(row, True, place, x, y)
    count = 0
    joined = spans[bodies:]
    for k in range(bodies):
        low, high = glass_span(x, y, True, place, discs, k)
        if low < high:
            below = place[EYE_Z] - discs[k, 2]
            first, last = low + WITHIN, high - WITHIN
            if glass_only and below > 0.0 and below * below > discs[k, 3] and first < last:
                sphere = world.spheres[k]
                through = world.is_crossed and reaches_through(sphere[CENTRE_Z], sphere[RADIUS])
                hide_within(first, last, through, place, discs[k], x, y[0], hidden)
                count = insert_span(joined, count, low, first)  # its rims are left to be asked for
                count = insert_span(joined, count, last, high)
            else:
                count = insert_span(joined, count, low, high)
    if not only_spheres:
        joined[0, 0], joined[0, 1] = 0, width
        count = 1
    for j in range(count):
        low = joined[j, 0]
        while low < joined[j, 1]:
            while low < joined[j, 1] and hidden[low] != FREE:
                low += 1
            if low == joined[j, 1]:
                break
            high = min(low + LANES, joined[j, 1])
            if lockstep:
                begin_block(x[low:high], y[low:high], place, rays, trips)
                clear_picks(high - low, rays, trips)
                for k in range(bodies):
                    intersect(k, discs, high - low, rays, trips)
                for i in range(high - low):
                    hidden[low + i] = BEHIND_GLASS if trips[PICK + i] >= 0 else hidden[low + i]
            else:
                for i in range(low, high):
                    if hidden[i] != FREE:
                        continue
                    dx, dy = x[i], -y[i]
                    unit = 1.0 / math.sqrt(dx * dx + dy * dy + 1.0)
                    d, eye = (dx * unit, dy * unit, -unit), eye_of(camera)
                    body = next_body(eye, d, NOTHING, OUTERMOST, world)
                    if world.is_crossed and body > NOTHING and ends_before(eye, d, body, world):
                        body = NOTHING  # it stands behind the node
                    if body != NOTHING:
                        opaque = is_stopped(eye, d, body, world)
                        hidden[i] = BEHIND_BODY if opaque else BEHIND_GLASS
            low = high


@kernel
def direct_rows(view: DirectView, first: int, last: int, scratch: DirectScratch, maps: tuple[Array, ...]) -> None:
    """See the nodes of rows first..last-1 without glass: the first layer of all maps.

    Nodes behind a body are left to the glass with the status they keep if no glass shows them.  ``maps`` as in
    `ViewMaps`, but pixel (K, h, 2 w) and Jacobian (K, h, 4 w) with their numbers in turn; further layers are
    cleared.
    """
    status, pixel, jacobian, weight, transmittance, branch = maps
    camera, grid, lens = view.tables[0], view.frame[0], scratch.lens
    for row in range(first, last):
        hide_nodes(row, view, scratch)
        wy = grid[1] - row * grid[2] - camera[EYE_Y]
        if not view.flat:
            acquire_row(wy, grid, camera, scratch.rays, lens)
        place_pixels(wy, view.flat, view.frame, camera, lens, scratch.hidden, pixel[0, row], status[row])
        place_jacobians(wy, grid, camera, pixel[0, row], jacobian[0, row])
        if not view.flat:
            bend_jacobians(lens, jacobian[0, row])
        place_weights(pixel[0, row], jacobian[0, row], weight[0, row], transmittance[0, row])
        begin_views(row, pixel, jacobian, weight, transmittance, branch)


@kernel
def begin_views(
    row: int, pixel: Array, jacobian: Array, weight: Array, transmittance: Array, branch: Array
) -> None:
    """Number the direct view of a row and clear its further layers."""
    none, nothing = np.float32(0.0), np.float32(math.nan)
    branch[0, row, :] = 0
    for layer in range(1, pixel.shape[0]):
        pixel[layer, row, :] = math.nan
        jacobian[layer, row, :] = nothing
        weight[layer, row, :] = none
        transmittance[layer, row, :] = none
        branch[layer, row, :] = 0


@kernel
def place_pixels(
    wy: float, flat: bool, frame: tuple[Array, Array], camera: Array, lens: Array, hidden: Array, pixel: Array,
    status: Array,
) -> None:  # fmt: skip
    """Pixels (2 w,) and status (w,) of a row of nodes that lies wy from the pinhole.

    This and the next ones are loops of their own because each touches few arrays: the compiler vectorises only
    what it can prove disjoint by a handful of tests.
    """
    grid, size = frame
    px, pz, x0, pitch, right, bottom = camera[EYE_X], camera[EYE_Z], grid[0], grid[2], size[0] - 1.0, size[1] - 1.0
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    focal, u0, v0 = camera[FOCAL], camera[CENTRE_U], camera[CENTRE_V]
    lens_u, lens_v = lens[0], lens[1]
    for i in range(status.shape[0]):
        wx = x0 + i * pitch - px
        cz = c9 * wx + c10 * wy - c11 * pz
        inverse = 1.0 / cz
        u = u0 + focal * ((c3 * wx + c4 * wy - c5 * pz) * inverse)
        v = v0 + focal * ((c6 * wx + c7 * wy - c8 * pz) * inverse)
        bent_u, bent_v = lens_u[i], lens_v[i]
        u, v = u if flat else bent_u, v if flat else bent_v
        # Without lens terms the outermost nodes ARE the outermost pixels: rounding must not lose them.
        near_u, near_v = min(max(u, 0.0), right), min(max(v, 0.0), bottom)
        inside = (cz > 0.0) & (abs(u - near_u) <= EDGE_PX) & (abs(v - near_v) <= EDGE_PX)
        free = hidden[i] == FREE
        code = BLOCKED if hidden[i] == BEHIND_BODY else RIM
        code = RECOVERED if free else code
        status[i] = code if inside else OUT_OF_FRAME
        pixel[2 * i] = near_u if inside & free else math.nan
        pixel[2 * i + 1] = near_v if inside & free else math.nan


@kernel
def place_jacobians(wy: float, grid: Array, camera: Array, pixel: Array, jacobian: Array) -> None:
    """Jacobians (4 w,) of the ideal camera for a row of nodes; NaN where there is no pixel."""
    px, pz, x0, pitch, focal = camera[EYE_X], camera[EYE_Z], grid[0], grid[2], camera[FOCAL]
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    for i in range(pixel.shape[0] // 2):
        wx = x0 + i * pitch - px
        inverse = 1.0 / (c9 * wx + c10 * wy - c11 * pz)
        a, b = (c3 * wx + c4 * wy - c5 * pz) * inverse, (c6 * wx + c7 * wy - c8 * pz) * inverse
        step = focal * pitch * inverse
        step = step if pixel[2 * i] == pixel[2 * i] else math.nan
        jacobian[4 * i], jacobian[4 * i + 1] = np.float32((c3 - a * c9) * step), np.float32((a * c10 - c4) * step)
        jacobian[4 * i + 2] = np.float32((c6 - b * c9) * step)
        jacobian[4 * i + 3] = np.float32((b * c10 - c7) * step)


@kernel
def bend_jacobians(lens: Array, jacobian: Array) -> None:
    """Multiply the lens's derivatives into the Jacobians (4 w,) of a row, in place."""
    ua, ub, va, vb = lens[2], lens[3], lens[4], lens[5]
    for i in range(lens.shape[1]):
        uc, ur, vc, vr = jacobian[4 * i], jacobian[4 * i + 1], jacobian[4 * i + 2], jacobian[4 * i + 3]
        a, b, c, d = ua[i], ub[i], va[i], vb[i]
        jacobian[4 * i], jacobian[4 * i + 1] = np.float32(a * uc + b * vc), np.float32(a * ur + b * vr)
        jacobian[4 * i + 2], jacobian[4 * i + 3] = np.float32(c * uc + d * vc), np.float32(c * ur + d * vr)


@kernel
def place_weights(pixel: Array, jacobian: Array, weight: Array, transmittance: Array) -> None:
    """Weights and transmittances (w,) of a row seen directly; 0 where there is no pixel."""
    none, one = np.float32(0.0), np.float32(1.0)
    for i in range(weight.shape[0]):
        area = abs(jacobian[4 * i] * jacobian[4 * i + 3] - jacobian[4 * i + 1] * jacobian[4 * i + 2])
        worth = min(one, area)
        seen = pixel[2 * i] == pixel[2 * i]
        weight[i] = worth if seen else none
        transmittance[i] = one if seen else none
