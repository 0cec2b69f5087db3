"""Find a packing that stands elsewhere than its file has it: as one rigid body, before each ball by itself.

Balls in contact are off together: a packing has one place and one turn.  Each ball alone has a dozen wrong places
one square aside; twenty that share six numbers have one place that explains the frame.  Shifts of a raster are
compared by the Cauchy loss of `pairing` over some of the saddles; the best ones are refined with turns, and the
search for each ball begins where most saddles are explained.  A tube that the glass carries goes with its packing.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from correction.fit.seen.pairing import Candidates, Start, distances, pair_from
from correction.fit.solve.other_bodies import NUMBER_STEP
from correction.fit.solve.solver import LOST
from correction.fit.solve.unknowns import Unknowns
from correction.target import Chessboard
from tracer.bodies import Body
from tracer.strategies.sensitivity import SPHERE

PACKING_TURN_RAD = 0.01  # standard deviation of the turn of a packing about each axis: 1 mm over 100 mm
PACKING_REACH = 3.0  # sigmas of the place of a ball by which its packing is looked for
PACKING_STRIDES = np.array((0.2, 0.2, 0.8))  # of the raster along x, y, z, in squares
PACKING_KNEE_PX = 4.0  # of the loss in the raster, corrected px
COMPARED_SADDLES = 400  # saddles at most for which places are compared
REFINED_PLACES = 6  # places of the raster that are refined
# Share of saddles that a found packing explains: right ones 0.56 to 0.93, wrong ones to 0.26
PACKING_FOUND = 0.4


def rigid_motion(unknowns: Unknowns, sigma_mm: float) -> Unknowns:
    """Six unknowns in place of all others: shift and turn of the balls in contact and what goes with them."""
    balls = sorted({ball for pair in unknowns.packing.values() for ball in pair})
    centres = unknowns.start[unknowns.glass].reshape(-1, len(SPHERE))[:, :3]
    middle = centres[balls].mean(axis=0)
    columns = np.zeros((len(unknowns.start), 6))
    for place in range(6):
        axis = np.eye(3)[place % 3]

        def move(
            point: NDArray[np.float64], axis: NDArray[np.float64] = axis, turns: bool = place > 2
        ) -> NDArray[np.float64]:
            return PACKING_TURN_RAD * np.cross(axis, point - middle) if turns else sigma_mm * axis

        for ball in balls:
            row = unknowns.glass.start + len(SPHERE) * ball
            columns[row : row + 3, place] = move(centres[ball])
        first = unknowns.others.start
        for body, numbers in unknowns.other_bodies.bodies:
            own = slice(first, first := first + len(numbers))
            if not body.stays:
                columns[own, place] = _numbers_moved(body, unknowns.start[own], unknowns.scene.wavelength_nm, move)
    names = tuple(f"packing.{name}" for name in ("x", "y", "z", "rx", "ry", "rz"))
    return replace(unknowns, names=names, columns=columns)


def _numbers_moved(
    body: Body,
    values: NDArray[np.float64],
    wavelength_nm: float,
    move: Callable[[NDArray[np.float64]], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Change (K,) of the numbers of a body that moves both ends of its axis most nearly as asked."""

    def ends(at: NDArray[np.float64]) -> NDArray[np.float64]:
        start, end, _ = body.with_numbers(at.tolist(), wavelength_nm).capsule
        return np.array((*start, *end))

    steps = NUMBER_STEP * np.eye(len(values))
    rate = np.stack([(ends(values + by) - ends(values - by)) / (2.0 * NUMBER_STEP) for by in steps], axis=1)
    asked = np.concatenate([move(end) for end in ends(values).reshape(2, 3)])
    return np.asarray(np.linalg.lstsq(rate, asked, rcond=1e-6)[0])


def find_packing(
    unknowns: Unknowns, candidates: Candidates, board: Chessboard, pitch_mm: float, sigma_mm: float
) -> tuple[NDArray[np.float64], float]:
    """Full vector (F,) with the packing where the saddles of a frame show it, and the share of them explained.

    Parameters
    ----------
    unknowns : Unknowns
        Around the camera as fitted, with balls that are known to touch.
    candidates : Candidates
        Of a frame with glass.
    board : Chessboard
    pitch_mm : float
        A corrected pixel on the plane.
    sigma_mm : float
        How well the place of a ball is known.
    """
    rigid = rigid_motion(unknowns, sigma_mm)
    some = candidates.take(~candidates.bare)
    chosen = np.zeros(len(some.pixel), np.bool_)
    chosen[:: max(len(chosen) // COMPARED_SADDLES, 1)] = True
    some = some.take(chosen)

    def refine(x: NDArray[np.float64]) -> Start:
        return pair_from(rigid, x, [some], board, pitch_mm)

    best = refine(np.zeros(6))
    if best.share < PACKING_FOUND:
        strides = PACKING_STRIDES * board.square_mm / sigma_mm
        raster = [
            np.linspace(-PACKING_REACH, PACKING_REACH, 2 * int(np.ceil(PACKING_REACH / stride)) + 1)
            for stride in strides
        ]
        places = [np.array((*place, 0.0, 0.0, 0.0)) for place in product(*raster)]
        costs = [_cost(rigid, place, some, board, pitch_mm) for place in places]
        for one in np.argsort(costs)[:REFINED_PLACES]:
            best = max(best, refine(places[one]), key=lambda start: start.inliers)
            if best.share >= PACKING_FOUND:
                break
    return rigid.full(best.solution.x), best.share


def _cost(
    unknowns: Unknowns, x: NDArray[np.float64], candidates: Candidates, board: Chessboard, pitch_mm: float
) -> float:
    """Cauchy loss of the candidates at a place; what lands nowhere costs as if it lay LOST beside its corner."""
    off, *_ = distances(unknowns, unknowns.full(x), candidates, board, pitch_mm)
    square = (off**2).sum(axis=1)
    return float(np.log1p(np.where(np.isfinite(square), square, LOST**2) / PACKING_KNEE_PX**2).sum())
