"""Balls that overlap because their places were measured: moved apart within what is known of their centres.

A ruler knows a centre to 0.2 mm, so balls that touch are written down as overlapping.  Each pair is moved apart
along its line of centres and each ball off the plane, round by round (Gauss-Seidel), every ball by its share of
the variance of the centres: the least sum of squares in their sigmas, to first order.  Where a ball would have to
move by more than the sigma of its centre, none is moved, and the scene is refused as it is.  A ball that reaches
through the plane by more than its sigma is meant to: it is not moved off the plane.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracer.bodies import CONTACT_TOL_MM, Body, Sphere
from tracer.scene.fit_section import FitTable

CLEARANCE_MM = 0.1 * CONTACT_TOL_MM
ROUNDS = 500


def separate_touching(bodies: Sequence[Body], priors: FitTable) -> tuple[tuple[Body, ...], dict[str, float]]:
    """Return bodies whose balls touch, and how far each was moved [mm]; unchanged where priors do not allow it.

    Parameters
    ----------
    bodies : sequence of Body
        As the file has them.
    priors : FitTable
        What is known of their centres.
    """
    balls = [ball for ball in Sphere.among(bodies) if ball.highest_mm > CONTACT_TOL_MM]
    if len({ball.name for ball in balls}) < max(len(balls), 1):
        return tuple(bodies), {}
    start = np.array([ball.centre_mm for ball in balls])
    low = np.array([ball.centre_mm[2] - ball.lowest_mm for ball in balls])
    widest = max(ball.radius_mm + ball.uneven_mm for ball in balls)
    variance = np.array([priors.sphere(ball.name).centre_mm ** 2 * (ball.medium is not None) for ball in balls])
    rests = (start[:, 2] >= low - np.sqrt(variance)) & (variance > 0.0)  # on this side of the plane
    centre = start.copy()
    for _ in range(ROUNDS):
        clean = True
        for sunk in np.flatnonzero((centre[:, 2] < low - CONTACT_TOL_MM) & rests):
            centre[sunk, 2], clean = low[sunk] + CLEARANCE_MM, False
        for one, other in _near_pairs(centre, 2.0 * widest):
            way = centre[other] - centre[one]
            distance, both = float(np.linalg.norm(way)), variance[one] + variance[other]
            if not distance > 0.0 or not both > 0.0:
                continue
            radii = balls[one].radius_towards_mm(way / distance) + balls[other].radius_towards_mm(-way / distance)
            depth = float(radii) - distance
            if depth > CONTACT_TOL_MM:
                step = (depth + CLEARANCE_MM) / distance / both * way
                centre[one] -= variance[one] * step
                centre[other] += variance[other] * step
                clean = False
        if clean:
            break
    steps = np.linalg.norm(centre - start, axis=1)
    if not clean or (steps > np.sqrt(variance)).any():
        return tuple(bodies), {}
    placed = {
        ball.name: replace(ball, centre_mm=tuple(place.tolist()))
        for ball, place, step in zip(balls, centre, steps, strict=True)
        if step > 0.0
    }
    moved = {ball.name: float(step) for ball, step in zip(balls, steps, strict=True) if step > 0.0}
    return tuple(placed.get(body.name, body) for body in bodies), moved


def _near_pairs(centre: NDArray[np.float64], reach_mm: float) -> list[tuple[int, int]]:
    """Return pairs of centres within reach, in order; a search along x, since scipy.spatial is slow to import."""
    order = np.argsort(centre[:, 0])
    x = centre[order, 0]
    pairs: list[tuple[int, int]] = []
    for at, end in enumerate(np.searchsorted(x, x + reach_mm, side="right")):
        one, others = int(order[at]), order[at + 1 : end]
        near = others[np.linalg.norm(centre[others] - centre[one], axis=1) <= reach_mm]
        pairs += [(min(one, other), max(one, other)) for other in near.tolist()]
    return sorted(pairs)
