"""Corners on a board that is bent, or has moved, in ways that no pose of a height says.

The piece of the board at each corner is moved by v = ways b, as the pose of its height would move it.  With p the
landing point on the plane of the pose and dp/dv its derivative by that pose, the residual is

    r = W J^-1 (p + dp/dv v - X),        dr/dx = W J^-1 (dp/dx + v_z d/dz dp/dx),        dr/db = W J^-1 dp/dv ways,

X the corner, J = dp/dpixel.  Rays are straight beyond the glass: p, J and dp/dx change in proportion with the
height of the plane, and two planes say how.  Without v_z d/dz dp/dx no step along derivatives, which are wrong,
lowers the squares, and a fit stands still: where the camera had gone 5 mm aside for a board bent by 2 mm, it found
a bend of 0.2 mm, and the camera stayed there.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.solver import Corners, Residuals, free_rates, land_corners
from correction.fit.solve.unknowns import Unknowns, rotation_jacobian
from tracer.strategies.sensitivity import SPHERE, TARGET

RISE_MM = 1.0  # between the two planes; any does
RISE = TARGET.index("z")


def motion_as_board(unknowns: Unknowns, full: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the change (F, 6) of a full vector where camera and balls move as a board would by its six numbers.

    Frames show camera and board against each other.  Where a board seems to have moved by v, the camera may have
    moved by -v, and the balls, whose place behind it is seen, with it.
    """
    moves = np.zeros((len(full), len(TARGET)))
    for at in (0, *range(unknowns.glass.start, unknowns.glass.stop, len(SPHERE))):
        x, y, z = full[at : at + 3]
        moves[at : at + 3, :3] = np.eye(3)
        moves[at : at + 3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]  # turn x place
    moves[3:6, 3:] = np.linalg.inv(rotation_jacobian(full[3:6]))
    return moves


def on_moved_board(
    unknowns: Unknowns,
    x: NDArray[np.float64],
    by: NDArray[np.float64],
    ways: NDArray[np.float64],
    corners: Corners,
) -> Residuals:
    """Residuals (N, 2) with derivatives (N, 2, P + q) by the free vector and by q numbers of the board.

    Parameters
    ----------
    unknowns : Unknowns
        Of the fit.
    x : (P,) float64
        The free vector.
    by : (q,) float64
        The board's numbers.
    ways : (N, 6, q) float64
        How they move each corner's piece of the board [mm, rad].
    corners : Corners
        With weights (N, 2, 2).
    """
    place = unknowns.place(corners.height_number)
    columns = np.column_stack((unknowns.columns, np.eye(len(unknowns.start))[:, place]))
    posed = replace(unknowns, names=(*unknowns.names, *TARGET), columns=columns)
    full = unknowns.full(x)
    above = full.copy()
    above[place.start + RISE] += RISE_MM
    low, high = (land_corners(posed, at, corners) for at in (full, above))
    rate, higher = free_rates(posed, full, corners, low), free_rates(posed, above, corners, high)
    by_board = rate[:, :, len(x) :] @ ways
    risen = (ways @ by)[:, RISE, None, None] / RISE_MM
    by_pixel = low.pixel_rate + risen * (high.pixel_rate - low.pixel_rate)
    rate = (rate + risen * (higher - rate))[:, :, : len(x)]
    off = low.point_mm + by_board @ by - unknowns.mark_places_mm(full, corners.node_mm, corners.depth_mm)
    to_sigma = np.full_like(by_pixel, np.nan)
    seen = np.isfinite(by_pixel).all(axis=(1, 2))
    to_sigma[seen] = np.asarray(corners.whiten)[seen] @ np.linalg.inv(by_pixel[seen])
    return Residuals((to_sigma @ off[:, :, None])[:, :, 0], to_sigma @ np.concatenate((rate, by_board), axis=2))
