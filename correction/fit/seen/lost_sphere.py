"""Find a sphere of which few corners are seen, when camera, glass and the other spheres are known.

In the search for the whole scene such a sphere has no say: its three or five corners drown among hundreds,
and saddles that are none (rims, ghosts) outnumber them.  Alone it is found by trying: from every place of a
raster the sphere is moved by Gauss-Newton steps to where its own candidates lie nearest to corners of their
kind, and what counts is how many more lie on one, to SHARP_PX, than if it were not there at all: a place beside
all saddles explains none, and one before a neighbour's hides what that explains.  Places that fall behind on the
way are left (successive halving), by how much dearer or cheaper they make their candidates: the right one is
begun from a dozen neighbours, so that it is never the only one of its kind.  With three coordinates to please them
and hundreds of tries, two or three do so by chance; the best places are therefore measured, one after the other,
until the corners themselves are where the place shows them.

First of all comes the place that was believed: where squares fill a ball, most saddles on it are of its rim, and
the search for the whole scene has taken it away from where its few corners would have been found.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from correction.fit.seen.measurement import MeasuredFrame
from correction.fit.seen.pairing import Candidates, distances, pairing_residuals
from correction.fit.solve.solver import LOST, Corners, land_corners
from correction.fit.solve.unknowns import Unknowns
from correction.target import Chessboard
from tracer.strategies.branches import branch_of
from tracer.strategies.sensitivity import SPHERE

# Share of the corners to be seen through a sphere, measured and explained, from which it is not lost
MIN_EXPLAINED_SHARE = 0.5
SHARP_PX = 0.4  # saddles are good to 0.1-0.3 corrected px
KNEES_PX = (6.0, 6.0, 3.0, 3.0, 1.0, 1.0, 0.5, 0.5)  # of the loss, step by step
LEFT = (1.0, 0.4, 1.0, 0.5, 1.0, 1.0, 1.0, 1.0)  # share of the places that go on after each step, the cheaper ones
# Of the raster sideways and along z, in squares
STRIDE = 0.16
STRIDE_Z = 0.6
REACH = 1.6  # of the raster, in sigmas of the prior
CANDIDATE_SLACK = 0.5  # squares that a place may move by while it has the same candidates
MAX_RASTER_STEPS = 7  # steps of the raster each way at most
SAME_MM = 0.05  # places that are one
NOTHING_MM = 1e-6  # radius of a sphere that is not there
TRIES = 6  # places that are measured


def find_lost_spheres(
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
        if expected and found < MIN_EXPLAINED_SHARE * expected:
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
    """Full vectors (F,) with one sphere where it was believed, then where most of its candidates lie on corners.

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
    stride = np.array([STRIDE, STRIDE, STRIDE_Z]) * board.square_mm
    raster = [
        np.linspace(-REACH, REACH, 2 * n + 1)
        for n in np.clip(np.ceil(reach / stride), 1, MAX_RASTER_STEPS).astype(int)
    ]
    tries: list[_Try] = []
    for across in product(*raster[:2]):
        own = _own(alone, np.array([*across, 0.0]), frames, number, CANDIDATE_SLACK * board.square_mm)
        bare = [_squares_without(alone, one, board, pitch_mm, number) for one in own]
        tries += [_Try(np.array([*across, along]), own, bare) for along in raster[2]]
    for knee, left in zip(KNEES_PX, LEFT, strict=True):
        tries = [one.step(alone, board, pitch_mm, knee) for one in tries]
        if left < 1.0:
            tries = sorted(tries, key=lambda one: one.cost)[: int(np.ceil(left * len(tries)))]
    found: list[tuple[int, float, NDArray[np.float64]]] = []
    for one in tries:
        vector = alone.full(one.x)
        more = sum(
            _on_corners(_squares(alone, vector, frame, board, pitch_mm), frame) - _on_corners(square, frame)
            for frame, square in zip(one.own, one.without, strict=True)
        )
        found.append((-more, float(one.x @ one.x), vector))
    found.sort(key=lambda one: one[:2])
    places = [believed]
    for score, _, vector in found:
        apart = [np.linalg.norm((vector - other)[row : row + 2]) for other in places]
        if score < 0 and min(apart, default=np.inf) > SAME_MM and len(places) <= TRIES:
            places.append(vector)
    return places


@dataclass(frozen=True)
class _Try:
    """A place on its way: the free vector (3,), the candidates that may be seen through the sphere there.

    Their squares `without` the sphere are those of `_squares`.  The cost, above that without it, is that of the
    place before the last step.
    """

    x: NDArray[np.float64]
    own: Sequence[Candidates]
    without: Sequence[NDArray[np.float64]]
    cost: float = np.inf

    def step(self, unknowns: Unknowns, board: Chessboard, pitch_mm: float, knee: float) -> "_Try":
        """One Gauss-Newton step on."""
        move, cost = _step(unknowns, self.x, self.own, board, pitch_mm, knee)
        alone = sum(_cost(square, frame, knee) for square, frame in zip(self.without, self.own, strict=True))
        return replace(self, x=self.x + move, cost=cost - alone)


def _own(
    unknowns: Unknowns, x: NDArray[np.float64], frames: Sequence[Candidates], number: int, beyond_mm: float
) -> list[Candidates]:
    """Candidates that are seen through a sphere which stands at x, or by so much beside it."""
    wide = unknowns.full(x)
    wide[unknowns.glass.start + number * len(SPHERE) + 3] += beyond_mm
    return [frame.take(_crosses(unknowns, wide, frame, number)) for frame in frames]


def _crosses(unknowns: Unknowns, full: NDArray[np.float64], frame: Candidates, number: int) -> NDArray[np.bool_]:
    """Candidates (N,) whose ray goes through a sphere."""
    rays = land_corners(
        unknowns, full, Corners(frame.height_number, True, frame.pixel, np.zeros_like(frame.pixel), 1.0)
    )
    rate = rays.columns([f"{number}.x", f"{number}.y"])
    return np.asarray(rays.recovered & np.any(rate != 0.0, axis=(1, 2)))


def _squares(
    unknowns: Unknowns, full: NDArray[np.float64], frame: Candidates, board: Chessboard, pitch_mm: float
) -> NDArray[np.float64]:
    """Squared distances (N,) [px^2] of candidates from their corners; NaN where a ray lands nowhere."""
    off, *_ = distances(unknowns, full, frame, board, pitch_mm)
    return np.asarray((off**2).sum(axis=1))


def _squares_without(
    unknowns: Unknowns, frame: Candidates, board: Chessboard, pitch_mm: float, number: int
) -> NDArray[np.float64]:
    """Squared distances as `_squares`, as if the sphere were not there."""
    absent = np.array(unknowns.start)
    absent[unknowns.glass.start + number * len(SPHERE) + 3] = NOTHING_MM
    return _squares(unknowns, absent, frame, board, pitch_mm)


def _on_corners(square: NDArray[np.float64], frame: Candidates) -> int:
    """Count the candidates that lie on a corner which the bare lattice does not explain."""
    return int(np.count_nonzero((square < SHARP_PX**2) & ~frame.bare))  # False for NaN


def _cost(square: NDArray[np.float64], frame: Candidates, knee: float) -> float:
    """Cauchy loss of all candidates of a frame; what lands nowhere costs as if it lay LOST beside its corner."""
    seen = np.isfinite(square) & ~frame.bare
    nowhere = int(np.count_nonzero(~seen & ~frame.bare))
    return knee**2 * float(np.sum(np.log1p(square[seen] / knee**2)) + nowhere * np.log1p(LOST**2 / knee**2))


def _step(
    unknowns: Unknowns,
    x: NDArray[np.float64],
    frames: Sequence[Candidates],
    board: Chessboard,
    pitch_mm: float,
    knee: float,
) -> tuple[NDArray[np.float64], float]:
    """Gauss-Newton step with Cauchy weights, and the cost before it; rays that land nowhere only cost."""
    normal, slope, cost = np.eye(len(x)), x.copy(), float(x @ x)
    for frame in frames:
        part = pairing_residuals(unknowns, x, frame, board, pitch_mm)
        square = (part.value**2).sum(axis=1)
        seen = np.isfinite(square) & ~frame.bare
        cost += _cost(square, frame, knee)
        rate = part.rate[seen] / np.sqrt(1.0 + square[seen] / knee**2)[:, None, None]
        value = part.value[seen] / np.sqrt(1.0 + square[seen] / knee**2)[:, None]
        flat = rate.reshape(-1, len(x))
        normal += flat.T @ flat
        slope += flat.T @ value.ravel()
    return np.asarray(-np.linalg.solve(normal, slope)), cost
