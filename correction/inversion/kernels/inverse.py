"""Plane nodes to camera pixels through glass: Newton for one node, and which views a node keeps.

The grid arrives as (x0, y0, pitch): node (row, column) is (x0 + column pitch, y0 - row pitch).  Jacobians
are d pixel / d node, four numbers: du/dcolumn, du/drow, dv/dcolumn, dv/drow.
"""

import math

import numpy as np

from correction.node_status import RECOVERED, UNLISTED
from ground.jit import Array, kernel, kernel_inlined, unowned
from tracer.kernels.march import march_pixel_tangents
from tracer.kernels.world import RECOVERED as TRACED
from tracer.kernels.world import World, unowned_world

Tables = tuple[Array, World]  # camera and bodies

MAX_STEPS = 25
TOLERANCE_PX = 1e-6  # last Newton step; it is still applied, which leaves about its square


@kernel
def inverse_2x2(xu: float, xv: float, yu: float, yv: float) -> tuple[float, ...]:
    """Inverse of [[xu, xv], [yu, yv]] and its determinant's reciprocal; not finite where singular."""
    r = 1.0 / (xu * yv - xv * yu)
    return yv * r, -xv * r, -yu * r, xu * r


@kernel
def stretch(uc: float, ur: float, vc: float, vr: float) -> tuple[float, ...]:
    """Smallest and largest singular value of [[uc, ur], [vc, vr]]."""
    e, f = 0.5 * (uc + vr), 0.5 * (uc - vr)
    g, h = 0.5 * (vc + ur), 0.5 * (vc - ur)
    p, q = math.sqrt(e * e + h * h), math.sqrt(f * f + g * g)
    return abs(p - q), p + q


@kernel_inlined
def unowned_tables(tables: Tables) -> Tables:
    """Return the tables of a scene, camera and bodies, as `unowned`."""
    return unowned(tables[0]), unowned_world(tables[1])


@kernel
def solve_node(x: float, y: float, u: float, v: float, key: int, sign: float, tables: Tables) -> tuple[float, ...]:
    """Careful Newton for one node: converged, u, v, Jacobian d plane / d pixel, transmittance.

    It steps back where it has left the sheet, a connected part of one branch with one sign of the determinant.
    """
    du = dv = 0.0
    for _ in range(MAX_STEPS):
        s, a, b, au, av, bu, bv, passed, k, _ = march_pixel_tangents(u, v, *tables)
        if s != TRACED or k != key or not (au * bv - av * bu) * sign > 0.0:
            du, dv = 0.5 * du, 0.5 * dv  # stepped off the sheet: go half the way back
            if abs(du) + abs(dv) < TOLERANCE_PX:
                break
            u, v = u - du, v - dv
            continue
        ux, uy, vx, vy = inverse_2x2(au, av, bu, bv)
        du, dv = ux * (x - a) + uy * (y - b), vx * (x - a) + vy * (y - b)
        size = max(abs(du), abs(dv))
        if size > 2.0:
            du, dv = 2.0 * du / size, 2.0 * dv / size
        u, v = u + du, v + dv
        if size <= TOLERANCE_PX:
            return 1.0, u, v, au, av, bu, bv, passed
    return 0.0, u, v, 0.0, 0.0, 0.0, 0.0, 0.0


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
