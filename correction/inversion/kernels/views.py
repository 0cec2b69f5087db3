"""From the starts of a sheet to the views that its nodes keep: solve in blocks, verify, judge.

Terms.  A sheet is a branch patch: a connected image region of one branch (sequence of bodies) on which the
Jacobian keeps its sign; it is not the light sheet.  A view is one pixel that shows a node; behind glass there may
be several.  A trip is the sequence of a ray as lockstep packs it into an integer
(``tracer.kernels.branches``).  Lockstep traces a block of rays together through a few spheres, bundles trace
neighbouring rays of a bed.

What a block of Newton has solved is traced once more with all bodies, and only counts if the ray really takes the
sequence of the sheet: in lockstep where the scene fits it, ray by ray through the cells where it has many bodies.
Every other node that may lie on the sheet is solved again, damped.  Where a sequence is not one of spheres alone,
every node is solved by itself.  A view is then compared with the limits of magnification and sensor, weighted, and
kept if it is among the K best of its node.

Columns of a block that are not explained here (`newton`): WITHIN, tolerance of the last step [px]; KEPT,
transmittance of the converged ray; WORTH, weight of the view.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from correction.inversion.kernels.newton import (
    CONVERGED,
    FAILED,
    GROUP,
    KEPT,
    OFF_BRANCH,
    WITHIN,
    WORTH,
    XU,
    XV,
    YU,
    YV,
    SheetPath,
    U,
    V,
    X,
    Y,
    inverse_2x2,
    solve_block,
    solve_node,
    stretch,
)
from correction.node_status import FOLD, LOW_MAGNIFICATION, OUT_OF_FRAME, RECOVERED, UNLISTED
from ground.jit import Array, kernel, kernel_composed, kernel_inlined
from piv.resampling.kernels.bspline import NON_NEGATIVE
from tracer.kernels.camera import CENTRE_U, CENTRE_V, FOCAL, lens_of, undistort
from tracer.kernels.chain import SKIP_LEFT_BEHIND, TRIP, begin_block, follow_block
from tracer.kernels.packets import PX, PY, hit_plane, whole_vectors
from tracer.kernels.rays import trace_pixel_tangents
from tracer.kernels.windowed import OPEN, is_before, through_window_carefully
from tracer.kernels.world import RECOVERED as TRACED
from tracer.kernels.world import Tables

# Trips that no ray takes: verified as not on the sheet, and to be solved again
OTHER_PATH, RETRY = -2, -3
# From its start, which lies within about a pixel of the solution
CLOSE_PX = 2.0

inverse_inlined = kernel_inlined(inverse_2x2.py_func)  # type: ignore[attr-defined]
stretch_inlined = kernel_inlined(stretch.py_func)  # type: ignore[attr-defined]


class InverseProblem(NamedTuple):
    """Camera and bodies, grid (3,), windows (K, 10) in front of all spheres, and what is asked.

    Parameters
    ----------
    every : bool
        True: solve again also nodes that cannot lie on the sheet (a test's reference).
    limits : (4,) float64
        Smallest and largest magnification, sensor width and height.
    """

    tables: Tables
    grid: Array
    windows: Array
    every: bool
    limits: Array


class ViewMaps(NamedTuple):
    """The arrays of a correction map, K views of each node (h, w), best first, and what is masked.

    Parameters
    ----------
    status, pixel, jacobian : (h, w), (K, h, w, 2), (K, h, w, 4)
        Node status, pixel and d pixel / d node.
    weight, transmittance, branch : (K, h, w) each
        Of each view.
    masked_pixels, masked_branches : (H, W), (B,)
        Status of masked pixels and branches, 0 where they are not; B = 0: nothing is masked.
    """

    status: Array
    pixel: Array
    jacobian: Array
    weight: Array
    transmittance: Array
    branch: Array
    masked_pixels: Array
    masked_branches: Array


class NodeScratch(NamedTuple):
    """Memory of one thread: ``block`` (NEWTON_NUMBERS,), ``state``, ``passed`` (GROUP,), ``xy`` (2, GROUP), ..."""

    block: Array
    state: Array
    trips: Array
    passed: Array
    xy: Array
    spans: Array
    wanted: Array
    rays: Array


@kernel_composed
def solve_sheet(
    problem: InverseProblem, path: SheetPath, starts: Array, nodes: Array,
    verify: Callable[..., None], tracer: Any, scratch: Any, maps: ViewMaps,  # noqa: ANN401
) -> None:  # fmt: skip
    """Solve nodes (N, 2) of one sheet in blocks from their starts (N, 4), as from `scatter_sheet`; keep the views.

    `verify` traces the pixels found with all bodies, by its `tracer`: the chain of lockstep or the bed of bundles.
    Nodes without a solution are gathered at the front of both arrays during the first round, and solved damped in
    the second.
    """
    block, state, trips = scratch.block, scratch.state, scratch.trips
    total, left = nodes.shape[0], 0
    for damped in (False, True):
        for low in range(0, total, GROUP):
            count = min(GROUP, total - low)
            group, of_group = starts[low : low + count], nodes[low : low + count]
            begin_group(count, problem.grid, group, of_group, block, state)
            solve_block(whole_vectors(count), damped, problem.tables, problem.windows, path, block, state)
            verify(count, problem, path, tracer, scratch)
            verify_paths(count, path.trip, problem.every, group, trips, block, state)
            keep_group(count, problem, path, of_group, block, state, maps)
            # Overwrites starts and nodes before low only: left <= low, and those have been solved.
            left = requeue(low, count, left, starts, nodes, trips)
        total, left = left, 0


@kernel
def solve_nodes(
    problem: InverseProblem, path: SheetPath, starts: Array, nodes: Array, balls: Array, scratch: NodeScratch,
    maps: ViewMaps,
) -> None:  # fmt: skip
    """Solve nodes of one sheet from their starts and keep the views.

    Solved is X(u, v) = node, X the point of the plane that the ray of pixel (u, v) meets along the path of the
    sheet, by Newton's method: (u, v) += (dX/d(u, v))^-1 (node - X(u, v)).  ``starts`` (N, 4): u, v, squared
    distance [px2] from the traced pixel that gave them, tolerance `WITHIN` of the last step [px]; ``nodes`` (N,
    2): row, column.  Blocks are verified in lockstep with the chain ``balls``, ray by ray where a scene does not
    fit it.  A path that is not `solid` (not of spheres alone) is solved node by node with all bodies, which
    verifies it.
    """
    block, state = scratch.block, scratch.state
    if path.solid:
        solve_sheet(problem, path, starts, nodes, verify_block, balls, scratch, maps)
        return
    for low in range(0, nodes.shape[0], GROUP):
        count = min(GROUP, nodes.shape[0] - low)
        group, of_group = starts[low : low + count], nodes[low : low + count]
        begin_group(count, problem.grid, group, of_group, block, state)
        solve_carefully(count, path, problem.tables, group, block, state)
        keep_group(count, problem, path, of_group, block, state, maps)


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
def verify_paths(
    count: int, trip: int, every: bool, starts: Array, trips: Array, block: Array, state: Array
) -> None:
    """Accept nodes whose ray takes the trip; mark others RETRY if a solution is still possible, or if `every`.

    It is not where the start is off the sheet, nor where a solution was found close to the start, but along a ray
    that takes another trip: near a start with usable derivatives there is only one solution.
    """
    for i in range(count):
        if state[i] == CONVERGED and trips[TRIP + i] == trip:
            continue
        away = max(abs(block[U + i] - starts[i, 0]), abs(block[V + i] - starts[i, 1]))
        cannot_be = state[i] == OFF_BRANCH or (state[i] == CONVERGED and away <= CLOSE_PX)
        trips[TRIP + i] = RETRY if every or not cannot_be else OTHER_PATH
        state[i] = FAILED


@kernel
def requeue(low: int, count: int, left: int, starts: Array, nodes: Array, trips: Array) -> int:
    """Move what is to be solved again behind the `left` ones at the front, before low; how many there are now."""
    for i in range(count):
        if trips[TRIP + i] == RETRY:
            for c in range(4):
                starts[left, c] = starts[low + i, c]
            nodes[left, 0], nodes[left, 1] = nodes[low + i, 0], nodes[low + i, 1]
            left += 1
    return left


@kernel
def solve_carefully(
    count: int, path: SheetPath, tables: Tables, starts: Array, block: Array, state: Array
) -> None:
    """Solve each node of a block by itself, where its path is not one of spheres alone."""
    for i in range(count):
        done, block[U + i], block[V + i], xu, xv, yu, yv, block[KEPT + i] = solve_node(
            block[X + i], block[Y + i], starts[i, 0], starts[i, 1], path.key, path.sign, tables
        )
        block[XU + i], block[XV + i], block[YU + i], block[YV + i] = xu, xv, yu, yv
        state[i] = CONVERGED if done > 0.0 else FAILED


@kernel
def keep_group(
    count: int, problem: InverseProblem, path: SheetPath, nodes: Array, block: Array, state: Array, maps: ViewMaps
) -> None:
    """Judge the views of a block and keep the best of each node."""
    judge(count, problem.grid[2], path.events.shape[0], problem.limits, block, state)
    for i in range(count):
        place = nodes[i, 0] & NON_NEGATIVE, nodes[i, 1] & NON_NEGATIVE
        u, v = block[U + i], block[V + i]
        if state[i] == RECOVERED and maps.masked_branches.shape[0] > 0:  # RECOVERED where nothing is masked
            state[i] = max(maps.masked_branches[path.number], maps.masked_pixels[int(v + 0.5), int(u + 0.5)])
        jacobian = block[XU + i], block[XV + i], block[YU + i], block[YV + i]
        keep_view(state[i], (u, v), jacobian, (block[WORTH + i], block[KEPT + i]), path.number, place, maps)


@kernel
def judge(count: int, pitch: float, events: int, limits: Array, b: Array, state: Array) -> None:
    """Replace d plane / d pixel (XU ...) by d pixel / d node and state by NodeStatus, and weight the views.

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
        # No convergence counts as a fold: Newton's method fails where the Jacobian becomes singular.
        state[i] = verdict if state[i] == CONVERGED else FOLD
        b[XU + i], b[XV + i], b[YU + i], b[YV + i] = uc, ur, vc, vr
        # The best view of a node is bright, covers a pixel (less loses detail, more adds none), and has met few
        # bodies, since each has an uncertain position: transmittance x min(1, px^2 per node) / (1 + bodies).
        b[WORTH + i] = b[KEPT + i] * min(1.0, abs(uc * vr - ur * vc)) * share


@kernel
def verify_block(count: int, problem: InverseProblem, path: SheetPath, balls: Array, scratch: NodeScratch) -> None:
    """Trace the pixels of a block with all bodies and store their trips; ray by ray where there is no chain."""
    b, rays, trips, passed = scratch.block, scratch.rays, scratch.trips, scratch.passed
    if path.trip < 0:
        for i in range(count):
            taken = OTHER_PATH
            if scratch.state[i] == CONVERGED:
                s, _, _, _, _, _, _, _, k, _ = trace_pixel_tangents(b[U + i], b[V + i], *problem.tables)
                taken = path.trip if s == TRACED and k == path.key else OTHER_PATH
            trips[TRIP + i] = taken
        return
    camera, windows, x, y = problem.tables[0], problem.windows, scratch.xy[0], scratch.xy[1]
    inverse, u0, v0 = 1.0 / camera[FOCAL], camera[CENTRE_U], camera[CENTRE_V]
    k1, k2, k3, p1, p2 = lens_of(camera)
    for i in range(count):
        a, e, _, _ = undistort((b[U + i] - u0) * inverse, (b[V + i] - v0) * inverse, k1, k2, k3, p1, p2)
        x[i], y[i] = a, e
    begin_block(x[:count], y[:count], camera, rays, trips)
    for i in range(count):
        passed[i] = OPEN
    for k in range(windows.shape[0]):
        through_window_carefully(count, windows[k], rays, passed)
    follow_block(0, count, SKIP_LEFT_BEHIND, balls, scratch.spans, rays, trips, scratch.wanted)
    if windows.shape[0] == 0:
        return
    hit_plane(count, rays)
    for i in range(count):
        lands = (rays[PX + i] == rays[PX + i]) & (passed[i] == OPEN)
        lands &= not is_before(rays[PX + i], rays[PY + i], windows[windows.shape[0] - 1])
        trips[TRIP + i] = trips[TRIP + i] if lands else OTHER_PATH


@kernel_inlined
def keep_view(
    verdict: int, uv: tuple[float, float], slopes: tuple[float, float, float, float], worth: tuple[float, float],
    number: int, place: tuple[int, int], maps: ViewMaps,
) -> None:  # fmt: skip
    """Insert one view of a node into its layers, best first, or record the reason why it is not kept.

    `worth` is weight and transmittance.  A masked node stays masked unless another view is kept.
    """
    (row, column), (status, pixel, jacobian, weight, transmittance, branch, _, _) = place, maps
    if verdict != RECOVERED:
        if status[row, column] != RECOVERED and status[row, column] < UNLISTED:
            status[row, column] = verdict
        return
    layers, stored, layer = pixel.shape[0], np.float32(worth[0]), 0
    while layer < layers and not stored > weight[layer, row, column]:
        layer += 1
    if layer == layers:
        return
    for k in range(layers - 1, layer, -1):
        for c in range(2):
            pixel[k, row, column, c] = pixel[k - 1, row, column, c]
        for c in range(4):
            jacobian[k, row, column, c] = jacobian[k - 1, row, column, c]
        weight[k, row, column] = weight[k - 1, row, column]
        transmittance[k, row, column] = transmittance[k - 1, row, column]
        branch[k, row, column] = branch[k - 1, row, column]
    pixel[layer, row, column, 0], pixel[layer, row, column, 1] = uv
    jacobian[layer, row, column, 0], jacobian[layer, row, column, 1] = slopes[0], slopes[1]
    jacobian[layer, row, column, 2], jacobian[layer, row, column, 3] = slopes[2], slopes[3]
    weight[layer, row, column], transmittance[layer, row, column] = stored, worth[1]
    branch[layer, row, column] = number
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
