"""From the starts of a sheet to the views that its nodes keep: solve in blocks, verify, judge.

What a block of Newton has solved is traced once more with all bodies, and only counts if the ray really takes the
sequence of the sheet: in lockstep where the scene fits it, ray by ray through the cells where it has many bodies.
Every other node for which there is hope is solved again, patiently.  Where a sequence is not one of spheres alone,
every node is solved by itself.  A view is then held against the limits of magnification and sensor, weighed, and
kept if it is among the best of its node.
"""

from typing import NamedTuple

import numpy as np

from correction.inversion.kernels.newton import (
    CONVERGED,
    FAILED,
    GROUP,
    HOPELESS,
    KEPT,
    WITHIN,
    WORTH,
    XU,
    XV,
    YU,
    YV,
    U,
    V,
    X,
    Y,
    inverse_2x2,
    solve_block,
    solve_node,
    solve_patiently,
    stretch,
)
from correction.node_status import FOLD, LOW_MAGNIFICATION, OUT_OF_FRAME, RECOVERED, UNLISTED
from ground.jit import Array, kernel, kernel_inlined
from piv.resampling.kernels.bspline import INDEX
from tracer.kernels.camera import CENTRE_U, CENTRE_V, FOCAL, lens_of, undistort
from tracer.kernels.chain import (
    PX,
    PY,
    SKIP_LEFT_BEHIND,
    TRIP,
    begin_block,
    follow_block,
    land_block,
    whole_vectors,
)
from tracer.kernels.rays import trace_pixel_tangents
from tracer.kernels.windowed import OPEN, is_before, through_window_carefully
from tracer.kernels.world import RECOVERED as TRACED
from tracer.kernels.world import Tables

ANOTHER, AGAIN = -2, -3  # trips that no ray takes; the second: of a node that is not given up
CLOSE_PX = 2.0  # from its start, which is within a pixel of the node or nearly so

inverse_inlined = kernel_inlined(inverse_2x2.py_func)  # type: ignore[attr-defined]
stretch_inlined = kernel_inlined(stretch.py_func)  # type: ignore[attr-defined]


class NodeScratch(NamedTuple):
    """Memory of one thread: ``block`` (NEWTON_NUMBERS,), ``state``, ``passed`` (GROUP,), ``xy`` (2, GROUP), ..."""

    block: Array
    state: Array
    xy: Array
    spans: Array
    wanted: Array
    rays: Array
    trips: Array
    passed: Array


@kernel
def solve_nodes(
    tables: Tables,
    grid: Array,
    balls: Array,
    windows: Array,
    sequence: Array,
    trip: int,
    solid: bool,
    every: bool,
    key: int,
    number: int,
    sign: float,
    limits: Array,
    starts: Array,
    nodes: Array,
    scratch: NodeScratch,
    maps: tuple[Array, ...],
) -> None:
    """Solve nodes of one sheet from their starts and keep the views.

    ``windows`` (K, 10) stand in front of everything, from the camera on.  ``sequence`` (E,) numbers the spheres of
    the branch in the sphere table, `trip` is the same in the order of ``balls`` (see ``tracer.kernels.chain``), -1
    where a scene does not fit lockstep: then what a block has solved is verified ray by ray, and where not all
    spheres of the sequence are `solid`, or stand behind other walls, every node is solved by itself.  `every`:
    hopeless ones too.  `key` is the branch key of `trace_ray`.  ``starts`` (N, 4) and ``nodes`` (N, 2) as from
    `scatter_sheet`; ``maps`` as in `keep_view`, then what is masked, see `keep_group`.
    """
    block, state, xy, spans, wanted, rays, trips, passed = scratch
    status, pixel, jacobian, weight, transmittance, branch, masked, ways = maps
    camera, spheres = tables[0], tables[1].spheres
    kept = status, pixel, jacobian, weight, transmittance, branch, masked, ways
    total, left, is_block = nodes.shape[0], 0, trip >= 0 or solid
    for patient in range(2 if is_block else 1):
        for low in range(0, total, GROUP):
            count = min(GROUP, total - low)
            group, of_group = starts[low : low + count], nodes[low : low + count]
            begin_group(count, grid, group, of_group, block, state)
            if patient:
                solve_patiently(whole_vectors(count), camera, windows, spheres, sequence, sign, block, state)
            elif is_block:
                solve_block(whole_vectors(count), camera, windows, spheres, sequence, sign, block, state)
            else:
                solve_carefully(count, key, sign, tables, group, block, state)
            if trip >= 0:
                verify(count, camera, balls, windows, xy, spans, wanted, rays, passed, trips, block)
            elif solid:
                verify_one_by_one(count, trip, key, tables, state, trips, block)
            if is_block:
                judge_trips(count, trip, every, group, trips, block, state)
            keep_group(count, grid[2], sequence.shape[0], number, limits, of_group, block, state, kept)
            if is_block:
                left = put_off(low, count, left, starts, nodes, trips)
        total, left = left, 0


@kernel
def begin_group(count: int, grid: Array, starts: Array, nodes: Array, block: Array, state: Array) -> None:
    """Put `count` nodes and their starts into the block, whole vectors."""
    for i in range(count):
        row, column = nodes[i, 0], nodes[i, 1]
        block[X + i], block[Y + i] = grid[0] + column * grid[2], grid[1] - row * grid[2]
        block[U + i], block[V + i], block[WITHIN + i] = starts[i, 0], starts[i, 1], starts[i, 3]
        state[i] = FAILED
    for i in range(count, whole_vectors(count)):
        block[X + i], block[Y + i] = block[X], block[Y]
        block[U + i], block[V + i], block[WITHIN + i] = block[U], block[V], block[WITHIN]


@kernel
def judge_trips(
    count: int, trip: int, every: bool, starts: Array, trips: Array, block: Array, state: Array
) -> None:
    """Let only nodes count whose ray takes the trip; mark others, `every` one or those with hope, as AGAIN.

    There is none where the start is off the sheet, nor where the node has been found close by, but along a ray
    that takes another trip: where derivatives are as good as a start needs, the node is seen only once around it.
    """
    for i in range(count):
        if state[i] == CONVERGED and trips[TRIP + i] == trip:
            continue
        away = max(abs(block[U + i] - starts[i, 0]), abs(block[V + i] - starts[i, 1]))
        hopeless = state[i] == HOPELESS or (state[i] == CONVERGED and away <= CLOSE_PX)
        trips[TRIP + i] = AGAIN if every or not hopeless else ANOTHER
        state[i] = FAILED


@kernel
def put_off(low: int, count: int, left: int, starts: Array, nodes: Array, trips: Array) -> int:
    """Move what is to be solved AGAIN behind the `left` ones at the front, before low; how many there are now."""
    for i in range(count):
        if trips[TRIP + i] == AGAIN:
            for c in range(4):
                starts[left, c] = starts[low + i, c]
            nodes[left, 0], nodes[left, 1] = nodes[low + i, 0], nodes[low + i, 1]
            left += 1
    return left


@kernel
def solve_carefully(
    count: int, key: int, sign: float, tables: Tables, starts: Array, block: Array, state: Array
) -> None:
    """Solve each node of a block by itself, where its sequence is not one of spheres alone."""
    for i in range(count):
        done, block[U + i], block[V + i], xu, xv, yu, yv, block[KEPT + i] = solve_node(
            block[X + i], block[Y + i], starts[i, 0], starts[i, 1], key, sign, tables
        )
        block[XU + i], block[XV + i], block[YU + i], block[YV + i] = xu, xv, yu, yv
        state[i] = CONVERGED if done > 0.0 else FAILED


@kernel
def keep_group(
    count: int, pitch: float, events: int, number: int, limits: Array, nodes: Array, block: Array, state: Array,
    maps: tuple[Array, ...],
) -> None:  # fmt: skip
    """Judge the views of a block and keep the best of each node.

    ``maps`` end with why pixels (H, W) and ways (B,) are masked, 0 where they are not; B = 0: nothing is.
    """
    status, pixel, jacobian, weight, transmittance, branch, masked, ways = maps
    judge(count, pitch, events, limits, block, state)
    for i in range(count):
        row, column = nodes[i, 0] & INDEX, nodes[i, 1] & INDEX
        uc, ur, vc, vr = block[XU + i], block[XV + i], block[YU + i], block[YV + i]
        u, v, light, worth = block[U + i], block[V + i], block[KEPT + i], block[WORTH + i]
        if state[i] == RECOVERED and ways.shape[0] > 0:
            state[i] = max(ways[number], masked[int(v + 0.5), int(u + 0.5)])  # RECOVERED where nothing is
        keep_view(
            state[i],
            u,
            v,
            uc,
            ur,
            vc,
            vr,
            light,
            worth,
            number,
            row,
            column,
            status,
            pixel,
            jacobian,
            weight,
            transmittance,
            branch,
        )


@kernel
def judge(count: int, pitch: float, events: int, limits: Array, b: Array, state: Array) -> None:
    """Turn d plane / d pixel (XU ...) into d pixel / d node, state into NodeStatus, and weigh the views.

    ``limits`` (4,): smallest and largest magnification, sensor width and height.
    """
    least, most, right, bottom = limits[0], limits[1], limits[2] - 1.0, limits[3] - 1.0
    share = 1.0 / (1.0 + events)
    for i in range(count):
        ux, uy, vx, vy = inverse_inlined(b[XU + i], b[XV + i], b[YU + i], b[YV + i])
        uc, ur, vc, vr = ux * pitch, -uy * pitch, vx * pitch, -vy * pitch
        low, high = stretch_inlined(uc, ur, vc, vr)
        u, v = b[U + i], b[V + i]
        inside = (u >= 0.0) & (u <= right) & (v >= 0.0) & (v <= bottom)
        verdict = FOLD if high > most else RECOVERED
        verdict = LOW_MAGNIFICATION if low < least else verdict
        verdict = verdict if inside else OUT_OF_FRAME
        state[i] = verdict if state[i] == CONVERGED else FOLD
        b[XU + i], b[XV + i], b[YU + i], b[YV + i] = uc, ur, vc, vr
        b[WORTH + i] = b[KEPT + i] * min(1.0, abs(uc * vr - ur * vc)) * share


@kernel
def verify(
    count: int, camera: Array, balls: Array, windows: Array, xy: Array, spans: Array, wanted: Array, rays: Array,
    passed: Array, trips: Array, b: Array,
) -> None:  # fmt: skip
    """Trips that the pixels u, v of a block really take, all bodies asked."""
    scale, u0, v0 = 1.0 / camera[FOCAL], camera[CENTRE_U], camera[CENTRE_V]
    k1, k2, k3, p1, p2 = lens_of(camera)
    x, y = xy[0], xy[1]
    for i in range(count):
        a, e, _, _ = undistort((b[U + i] - u0) * scale, (b[V + i] - v0) * scale, k1, k2, k3, p1, p2)
        x[i], y[i] = a, e
    begin_block(x[:count], y[:count], camera, rays, trips)
    if windows.shape[0] == 0:
        follow_block(0, count, SKIP_LEFT_BEHIND, balls, spans, rays, trips, wanted)
        return
    for i in range(count):
        passed[i] = OPEN
    for k in range(windows.shape[0]):
        through_window_carefully(count, windows[k], rays, passed)
    follow_block(0, count, SKIP_LEFT_BEHIND, balls, spans, rays, trips, wanted)
    land_block(count, rays)
    for i in range(count):
        lands = (rays[PX + i] == rays[PX + i]) & (passed[i] == OPEN)
        lands &= not is_before(rays[PX + i], rays[PY + i], windows[windows.shape[0] - 1])
        trips[TRIP + i] = trips[TRIP + i] if lands else ANOTHER


@kernel
def verify_one_by_one(
    count: int, trip: int, key: int, tables: Tables, state: Array, trips: Array, b: Array
) -> None:
    """As `verify` for scenes of many bodies: `trip` for converged pixels whose ray has the branch key `key`."""
    for i in range(count):
        taken = ANOTHER
        if state[i] == CONVERGED:
            s, _, _, _, _, _, _, _, k, _ = trace_pixel_tangents(b[U + i], b[V + i], *tables)
            taken = trip if s == TRACED and k == key else ANOTHER
        trips[TRIP + i] = taken


@kernel_inlined
def keep_view(
    verdict: int,
    u: float,
    v: float,
    uc: float,
    ur: float,
    vc: float,
    vr: float,
    passed: float,
    worth: float,
    number: int,
    row: int,
    column: int,
    status: Array,
    pixel: Array,
    jacobian: Array,
    weight: Array,
    transmittance: Array,
    branch: Array,
) -> None:
    """Insert one view of a node into its layers, best first, or note why it cannot be kept.

    What is masked stays so unless another view is kept.  Status is (h, w), pixel (K, h, w, 2), Jacobian
    (K, h, w, 4), weight, transmittance and branch (K, h, w).
    """
    if verdict != RECOVERED:
        if status[row, column] != RECOVERED and status[row, column] < UNLISTED:
            status[row, column] = verdict
        return
    layers = pixel.shape[0]
    stored = np.float32(worth)
    place = 0
    while place < layers and not stored > weight[place, row, column]:
        place += 1
    if place == layers:
        return
    for layer in range(layers - 1, place, -1):
        for k in range(2):
            pixel[layer, row, column, k] = pixel[layer - 1, row, column, k]
        for k in range(4):
            jacobian[layer, row, column, k] = jacobian[layer - 1, row, column, k]
        weight[layer, row, column] = weight[layer - 1, row, column]
        transmittance[layer, row, column] = transmittance[layer - 1, row, column]
        branch[layer, row, column] = branch[layer - 1, row, column]
    pixel[place, row, column, 0], pixel[place, row, column, 1] = u, v
    jacobian[place, row, column, 0], jacobian[place, row, column, 1] = uc, ur
    jacobian[place, row, column, 2], jacobian[place, row, column, 3] = vc, vr
    weight[place, row, column], transmittance[place, row, column] = stored, passed
    branch[place, row, column] = number
    status[row, column] = RECOVERED


@kernel
def join_weights(first: int, last: int, weight: Array) -> None:
    """Divide the weights (K, h, w) of rows first..last-1 by their sum over the layers, where there is any."""
    none, one = np.float32(0.0), np.float32(1.0)
    for row in range(first, last):
        if weight.shape[0] == 1:
            for column in range(weight.shape[2]):
                weight[0, row, column] = one if weight[0, row, column] > none else none
            continue
        for column in range(weight.shape[2]):
            total = none
            for layer in range(weight.shape[0]):
                total += weight[layer, row, column]
            total = total if total > none else one
            for layer in range(weight.shape[0]):
                weight[layer, row, column] = weight[layer, row, column] / total
