"""Find out which lattice corner each saddle shows, when nothing is known but a rough scene.

The cost, the distance of every candidate to its nearest corner (`candidates`) through a Cauchy loss, is a
continuous function of the scene and is minimised as it is, pairing anew at every step, with the knee of the
loss drawn in from rough to fine.  Several starts escape from pairings shifted by a corner; such a scene
bends light so differently elsewhere that it never gathers the inliers of the right one.  What this leaves
behind are spheres that show few corners (`lost_sphere`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from correction.fit.seen.candidates import Candidates, paired_residuals
from correction.fit.solve.contact import pushed_apart
from correction.fit.solve.solver import Residuals, Solution, minimise
from correction.fit.solve.unknowns import Unknowns
from correction.target import Chessboard
from tracer.strategies.sensitivity import SPHERE

KNEES_PX = (12.0, 4.0, 1.0)  # of the loss, in corrected pixels, from rough to fine
INLIER_PX = 1.0
ENOUGH = 0.9  # share of inliers at which no further start is tried
TWICE = 0.6  # the same, if two starts have ended at the same scene
SAME_MM = 0.05
MANY = 4  # spheres, of which half may have gone astray in two starts that ended alike: they are found later
RANDOM_STARTS = 64


@dataclass(frozen=True)
class Start:
    """Outcome of one start.

    Parameters
    ----------
    solution : Solution
        Where it ended.
    inliers, candidates : int
        Candidates within INLIER_PX of their corner, and all whose ray lands where squares can be seen; those
        on the bare lattice are not counted, as they are explained without any glass.
    rms_px : float
        Root mean square distance of the inliers, corrected px, both axes together.
    """

    solution: Solution
    inliers: int
    candidates: int
    rms_px: float

    @property
    def share(self) -> float:
        """Share of inliers."""
        return self.inliers / max(self.candidates, 1)


def pair_from(
    unknowns: Unknowns,
    x: NDArray[np.float64],
    frames: Sequence[Candidates],
    board: Chessboard,
    pitch_mm: float,
    knees_px: Sequence[float] = KNEES_PX,
) -> Start:
    """Minimise the distance to the nearest corners from one start."""

    def evaluate(at: NDArray[np.float64]) -> list[Residuals]:
        return [paired_residuals(unknowns, at, frame, board, pitch_mm) for frame in frames]

    for knee in knees_px:
        solution = minimise(unknowns, evaluate, x, knee=knee, steps=25, tolerance=1e-2)
        x = solution.x
    square = np.concatenate([(part.value**2).sum(axis=1) for part in evaluate(x)])
    square = square[np.isfinite(square) & ~np.concatenate([frame.bare for frame in frames])]
    near = square[square < INLIER_PX**2]
    return Start(solution, len(near), len(square), float(np.sqrt(near.mean())) if len(near) else float("nan"))


def group_starts(unknowns: Unknowns, full: NDArray[np.float64], board: Chessboard) -> list[NDArray[np.float64]]:
    """Full vectors to start from: as given, then the glass as one, moved by half a square along each axis."""
    moves = [np.zeros(3), *(0.5 * sign * np.eye(3)[axis] for axis in range(3) for sign in (1.0, -1.0))]
    everything = np.ones(len(unknowns.scene.spheres), bool)
    return [moved(unknowns, full, board.square_mm * np.where(everything[:, None], move, 0.0)) for move in moves]


def random_starts(unknowns: Unknowns, full: NDArray[np.float64], board: Chessboard) -> list[NDArray[np.float64]]:
    """Full vectors with every sphere moved by up to 0.4 squares (fixed seed: same frames, same fit)."""
    rng = np.random.default_rng(0)
    count = len(unknowns.scene.spheres)
    moves = rng.uniform(-0.4, 0.4, (RANDOM_STARTS, count, 3))
    return [moved(unknowns, full, board.square_mm * move) for move in moves]


def moved(unknowns: Unknowns, full: NDArray[np.float64], by_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the full vector with the spheres moved by (N, 3), then pushed apart."""
    found = np.array(full)
    rows = found[unknowns.glass].reshape(-1, len(SPHERE))
    rows[:, :3] += by_mm
    rows[:, :4] = pushed_apart(np.c_[rows, np.zeros(len(rows))])[:, :4]
    return found


def pair(
    unknowns: Unknowns,
    full: NDArray[np.float64],
    frames: Sequence[Candidates],
    board: Chessboard,
    pitch_mm: float,
    further: Sequence[NDArray[np.float64]] = (),
) -> list[Start]:
    """Try starts until one explains the frames; best first.

    Parameters
    ----------
    unknowns : Unknowns
        With the glass free.
    full : (F,) float64
        Full vector to start around.
    frames : sequence of Candidates
        Frames with glass.
    board : Chessboard
    pitch_mm : float
        A corrected pixel on the plane.
    further : sequence of (F,) float64
        Full vectors that may be right as well.
    """
    tried: list[Start] = []

    def best() -> Start:
        return max(tried, key=lambda one: one.inliers)

    def explained() -> bool:
        alike = sum(_same(unknowns, best(), other) for other in tried)
        return best().share >= (TWICE if alike > 1 else ENOUGH)

    def attempt(start: NDArray[np.float64]) -> None:
        tried.append(pair_from(unknowns, unknowns.free(start), frames, board, pitch_mm))

    near = group_starts(unknowns, full, board)
    for start in [near[0], *further, *near[1:]]:
        attempt(start)
        if explained():
            return sorted(tried, key=lambda one: -one.inliers)
    if best().share < TWICE:
        for start in random_starts(unknowns, full, board):
            attempt(start)
            if explained():
                break
    return sorted(tried, key=lambda one: -one.inliers)


def _same(unknowns: Unknowns, one: Start, other: Start) -> bool:
    """Whether two starts ended with the spheres, or most of many, at the same places seen from the camera."""
    off = np.abs(unknowns.sigma * (one.solution.x - other.solution.x))
    apart = {sphere.name: 0.0 for sphere in unknowns.scene.spheres}
    for name, by in zip(unknowns.names, off.tolist(), strict=True):
        ball, _, part = name.rpartition(".")
        if part in ("x", "y") and ball in apart:
            apart[ball] = max(apart[ball], by)
    astray = sum(by >= SAME_MM for by in apart.values())
    return astray <= (len(apart) // 2 if len(apart) >= MANY else 0)
