"""Find a sphere of which few corners are seen, when camera, glass and the other spheres are known.

In the search for the whole scene such a sphere has no say: its three or five corners drown among hundreds,
and saddles that are none (rims, ghosts) outnumber them.  Alone it is found by trying: from every place of a
raster the sphere is moved by Gauss-Newton steps to where its own candidates lie nearest to corners of their
kind, and what counts is how many lie on one, to SHARP_PX.  With three coordinates to please them and hundreds of
tries, two or three do so by chance; the best places are therefore measured, one after the other, until the
corners themselves are where the place shows them.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from correction.board import Chessboard
from correction.fit.candidates import Candidates, distances, paired_residuals
from correction.fit.measurement import MeasuredFrame
from correction.fit.solver import Corners, landed
from correction.fit.unknowns import Unknowns
from tracer.branches import branch_of
from tracer.sensitivity import SPHERE

FOUND = 0.5  # share of the corners to be seen through a sphere, measured and explained, from which it is not lost
SHARP_PX = 0.4  # saddles are good to 0.1-0.3 corrected px
KNEES_PX = (6.0, 6.0, 3.0, 3.0, 1.0, 1.0, 0.5, 0.5)  # of the loss, step by step
STRIDE, STRIDE_Z = 0.16, 0.6  # of the raster sideways and along z, in squares
REACH = 1.6  # of the raster, in sigmas of the prior
MOST = 7  # steps of the raster each way at most
SAME_MM = 0.05
TRIES = 6  # places that are measured


def lost_spheres(
    unknowns: Unknowns, frames: Sequence[MeasuredFrame], kept: Sequence[NDArray[np.bool_]]
) -> list[int]:
    """Numbers of the spheres that the scene shows corners through, and the frames do not."""
    lost = []
    for number, sphere in enumerate(unknowns.scene.spheres):
        expected = found = 0
        for frame, good in zip(frames, kept, strict=True):
            for branch_name, count in frame.expected.items():
                if sphere.is_on(branch_of(branch_name)):
                    expected += count
                    found += int(np.count_nonzero(good & (frame.branch_name == branch_name)))
        if expected and found < FOUND * expected:
            lost.append(number)
    return lost


def likely_places(
    unknowns: Unknowns,
    full: NDArray[np.float64],
    frames: Sequence[Candidates],
    board: Chessboard,
    pitch_mm: float,
    number: int,
) -> list[NDArray[np.float64]]:
    """Full vectors (F,) with one sphere where most of its own candidates lie on corners, the best first.

    Parameters
    ----------
    unknowns : Unknowns
        With the centres of the spheres free.
    full : (F,) float64
        Everything else is taken from here, and is trusted.
    frames : sequence of Candidates
        Frames with glass.
    board : Chessboard
    pitch_mm : float
        A corrected pixel on the plane.
    number : int
        Of the sphere.
    """
    name = unknowns.scene.spheres[number].name
    row = unknowns.glass.start + number * len(SPHERE)
    believed = np.array(full)
    believed[row : row + 3] = unknowns.start[row : row + 3]
    alone = unknowns.only([f"{name}.{axis}" for axis in "xyz"]).around(believed)
    if not alone.names:
        return []
    reach = REACH * alone.sigma
    wide = np.array(believed)
    wide[row + 3] += reach.max()
    own = [frame.take(_crosses(alone, wide, frame, number)) for frame in frames]
    stride = np.array([STRIDE, STRIDE, STRIDE_Z]) * board.square_mm
    raster = [np.linspace(-REACH, REACH, 2 * n + 1) for n in np.clip(np.ceil(reach / stride), 1, MOST).astype(int)]
    found: list[tuple[int, float, NDArray[np.float64]]] = []
    for place in product(*raster):
        x = np.array(place)
        for knee in KNEES_PX:
            x = x + _step(alone, x, own, board, pitch_mm, knee)
        vector = alone.full(x)
        found.append((-_on_corners(alone, vector, own, board, pitch_mm), float(x @ x), vector))
    found.sort(key=lambda one: one[:2])
    places: list[NDArray[np.float64]] = []
    for score, _, vector in found:
        apart = [np.linalg.norm((vector - other)[row : row + 2]) for other in places]
        if score < 0 and min(apart, default=np.inf) > SAME_MM and len(places) < TRIES:
            places.append(vector)
    return places


def _crosses(unknowns: Unknowns, full: NDArray[np.float64], frame: Candidates, number: int) -> NDArray[np.bool_]:
    """Candidates (N,) whose ray goes through a sphere."""
    rays = landed(unknowns, full, Corners(frame.height_number, True, frame.pixel, np.zeros_like(frame.pixel), 1.0))
    rate = rays.columns([f"{number}.x", f"{number}.y"])
    return np.asarray(rays.recovered & np.any(rate != 0.0, axis=(1, 2)))


def _on_corners(
    unknowns: Unknowns, full: NDArray[np.float64], frames: Sequence[Candidates], board: Chessboard, pitch_mm: float
) -> int:
    """How many candidates lie on a corner that the bare lattice does not explain."""
    count = 0
    for frame in frames:
        off, *_ = distances(unknowns, full, frame, board, pitch_mm)
        count += int(np.count_nonzero((np.hypot(*off.T) < SHARP_PX) & ~frame.bare))  # False for NaN
    return count


def _step(
    unknowns: Unknowns,
    x: NDArray[np.float64],
    frames: Sequence[Candidates],
    board: Chessboard,
    pitch_mm: float,
    knee: float,
) -> NDArray[np.float64]:
    """Gauss-Newton step with Cauchy weights; rays that land nowhere have no say."""
    normal, slope = np.eye(len(x)), x.copy()
    for frame in frames:
        part = paired_residuals(unknowns, x, frame, board, pitch_mm)
        square = (part.value**2).sum(axis=1)
        seen = np.isfinite(square) & ~frame.bare
        rate = part.rate[seen] / np.sqrt(1.0 + square[seen] / knee**2)[:, None, None]
        value = part.value[seen] / np.sqrt(1.0 + square[seen] / knee**2)[:, None]
        flat = rate.reshape(-1, len(x))
        normal += flat.T @ flat
        slope += flat.T @ value.ravel()
    return np.asarray(-np.linalg.solve(normal, slope))
