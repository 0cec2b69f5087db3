"""From the starts of a sheet to the views that its nodes keep: solve in blocks, verify, judge.

What a block of Newton has solved is traced once more with all bodies, and only counts if the ray really takes the
sequence of the sheet: in lockstep where the scene fits it, ray by ray through the cells where it has many bodies.
Every other node is solved by itself, with care.  A view is then held against the limits of magnification and
sensor, weighed, and kept if it is among the best of its node.
"""

from typing import NamedTuple

from correction.inversion.kernels.inverse import (
    Tables,
    inverse_2x2,
    keep_view,
    solve_node,
    stretch,
    unowned_tables,
)
from correction.inversion.kernels.newton import (
    CONVERGED,
    FAILED,
    GROUP,
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
    solve_block,
)
from correction.node_status import FOLD, LOW_MAGNIFICATION, OUT_OF_FRAME, RECOVERED
from correction.resample.kernels.bspline import INDEX
from ground.jit import Array, kernel, kernel_inlined, unowned
from tracer.kernels.camera import CENTRE_U, CENTRE_V, FOCAL, lens_of, undistorted
from tracer.kernels.chain import SKIP_LEFT_BEHIND, TRIP, begin_block, follow_block, whole_vectors
from tracer.kernels.march import march_pixel_tangents
from tracer.kernels.world import RECOVERED as TRACED

ANOTHER = -2  # a trip that no ray takes

inverse_inlined = kernel_inlined(inverse_2x2.py_func)  # type: ignore[attr-defined]
stretch_inlined = kernel_inlined(stretch.py_func)  # type: ignore[attr-defined]


class NodeScratch(NamedTuple):
    """Memory of one thread: ``block`` (NEWTON_NUMBERS,), ``state`` (GROUP,), ``xy`` (2, GROUP), the chain's."""

    block: Array
    state: Array
    xy: Array
    spans: Array
    wanted: Array
    rays: Array
    trips: Array


@kernel
def solve_nodes(
    tables: Tables,
    grid: Array,
    balls: Array,
    sequence: Array,
    trip: int,
    solid: bool,
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

    ``sequence`` (E,) numbers the spheres of the branch in the sphere table, `trip` is the same in the order of
    ``balls`` (see ``tracer.kernels.chain``), -1 where a scene does not fit lockstep: then what a block has solved
    is verified ray by ray, and where not all spheres of the sequence are `solid` every node is solved by itself.
    `key` is the branch key of ``march``.  ``starts`` (N, 4) and ``nodes`` (N, 2) as from
    `scatter_sheet`; ``maps`` as in `keep_view`.
    """
    block, state, xy, spans, wanted, rays, trips = scratch
    status, pixel, jacobian, weight, transmittance, branch = maps  # once: taking one from a tuple is not free
    tables, sequence = unowned_tables(tables), unowned(sequence)
    camera, spheres = tables[0], tables[1].spheres
    status, pixel, jacobian, weight = unowned(status), unowned(pixel), unowned(jacobian), unowned(weight)
    transmittance, branch, starts, nodes = unowned(transmittance), unowned(branch), unowned(starts), unowned(nodes)
    block, xy, rays, trips = unowned(block), unowned(xy), unowned(rays), unowned(trips)
    state, balls, spans, wanted = unowned(state), unowned(balls), unowned(spans), unowned(wanted)
    kept = status, pixel, jacobian, weight, transmittance, branch
    for low in range(0, nodes.shape[0], GROUP):
        count = min(GROUP, nodes.shape[0] - low)
        group, of_group = starts[low : low + count], nodes[low : low + count]
        begin_group(count, grid, group, of_group, block, state)
        if trip > 0:
            solve_block(whole_vectors(count), camera, spheres, sequence, sign, block, state)
            verify(count, camera, balls, xy, spans, wanted, rays, trips, block)
        elif solid:
            solve_block(whole_vectors(count), camera, spheres, sequence, sign, block, state)
            verify_one_by_one(count, trip, key, tables, state, trips, block)
        careful_group(count, trip, key, sign, tables, group, trips, block, state)
        keep_group(count, grid[2], sequence.shape[0], number, limits, of_group, block, state, kept)


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
def careful_group(
    count: int, trip: int, key: int, sign: float, tables: Tables, starts: Array, trips: Array, block: Array,
    state: Array,
) -> None:  # fmt: skip
    """Solve by itself each node that has not converged to a ray of the trip."""
    for i in range(count):
        if not (state[i] == CONVERGED and trips[TRIP + i] == trip):
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
    """Judge the views of a block and keep the best of each node."""
    status, pixel, jacobian, weight, transmittance, branch = maps
    status, pixel, jacobian, weight = unowned(status), unowned(pixel), unowned(jacobian), unowned(weight)
    transmittance, branch = unowned(transmittance), unowned(branch)
    judge(count, pitch, events, limits, block, state)
    for i in range(count):
        row, column = nodes[i, 0] & INDEX, nodes[i, 1] & INDEX
        uc, ur, vc, vr = block[XU + i], block[XV + i], block[YU + i], block[YV + i]
        u, v, light, worth = block[U + i], block[V + i], block[KEPT + i], block[WORTH + i]
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
    count: int,
    camera: Array,
    balls: Array,
    xy: Array,
    spans: Array,
    wanted: Array,
    rays: Array,
    trips: Array,
    b: Array,
) -> None:
    """Trips that the pixels u, v of a block really take, all bodies asked."""
    scale, u0, v0 = 1.0 / camera[FOCAL], camera[CENTRE_U], camera[CENTRE_V]
    k1, k2, k3, p1, p2 = lens_of(camera)
    x, y = xy[0], xy[1]
    for i in range(count):
        a, e, _, _ = undistorted((b[U + i] - u0) * scale, (b[V + i] - v0) * scale, k1, k2, k3, p1, p2)
        x[i], y[i] = a, e
    begin_block(x[:count], y[:count], camera, rays, trips)
    follow_block(0, count, SKIP_LEFT_BEHIND, balls, spans, rays, trips, wanted)


@kernel
def verify_one_by_one(
    count: int, trip: int, key: int, tables: Tables, state: Array, trips: Array, b: Array
) -> None:
    """As `verify` for scenes of many bodies: `trip` for converged pixels whose ray has the branch key `key`."""
    for i in range(count):
        taken = ANOTHER
        if state[i] == CONVERGED:
            s, _, _, _, _, _, _, _, k, _ = march_pixel_tangents(b[U + i], b[V + i], *tables)
            taken = trip if s == TRACED and k == key else ANOTHER
        trips[TRIP + i] = taken
