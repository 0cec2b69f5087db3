"""Where the search for the glass starts: as given, the glass moved as one, one sphere scanned, at random."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from correction.fit.candidates import WIDER, Candidates, distances
from correction.fit.contact import pushed_apart
from correction.fit.solver import LOST, Corners, landed
from correction.fit.unknowns import Bench
from correction.target import Chessboard
from tracer.sensitivity import SPHERE

KNEE_PX = 4.0  # of the loss that a scan adds up, in corrected pixels
RANDOM_STARTS = 16
SCAN = 5  # steps each way when one sphere is scanned
VALLEYS = 3  # minima of the scan that are followed


def group_starts(bench: Bench, full: NDArray[np.float64], board: Chessboard) -> list[NDArray[np.float64]]:
    """Full vectors to start from: as given, then the glass as one, moved by half a square along each axis."""
    moves = [np.zeros(3), *(0.5 * sign * np.eye(3)[axis] for axis in range(3) for sign in (1.0, -1.0))]
    everything = np.ones(len(bench.scene.spheres), bool)
    return [moved(bench, full, board.square_mm * np.where(everything[:, None], move, 0.0)) for move in moves]


def sphere_starts(
    bench: Bench,
    full: NDArray[np.float64],
    frames: Sequence[Candidates],
    board: Chessboard,
    pitch_mm: float,
    number: int,
) -> list[NDArray[np.float64]]:
    """Full vectors with one sphere moved sideways to where its own candidates cost least, the best first.

    A sphere of which few corners are seen has a narrow basin; scanning its two coordinates costs no more
    than a few minimisations.
    """
    wide = np.array(full)
    wide[bench.glass].reshape(-1, len(SPHERE))[number, 3] *= WIDER
    own = []
    for frame in frames:
        everything = Corners(frame.height, True, frame.pixel, np.zeros_like(frame.pixel), 1.0)
        rate = landed(bench, wide, everything).columns([f"{number}.x", f"{number}.y"])
        own.append(frame.take(np.any(rate != 0.0, axis=(1, 2))))
    alone = np.eye(len(bench.scene.spheres))[:, [number]]
    steps = np.linspace(-0.4, 0.4, 2 * SCAN + 1) * board.square_mm
    cost, vectors = np.empty((len(steps), len(steps))), []
    for i, x in enumerate(steps):
        for j, y in enumerate(steps):
            vectors.append(moved(bench, full, alone * np.array([x, y, 0.0])))
            cost[i, j] = sum(_cost(bench, vectors[-1], frame, board, pitch_mm) for frame in own)
    valley = cost == ndimage.minimum_filter(cost, 3, mode="nearest")
    order = np.argsort(np.where(valley, cost, np.inf).ravel(), kind="stable")
    return [vectors[k] for k in order[: min(VALLEYS, int(valley.sum()))]]


def random_starts(bench: Bench, full: NDArray[np.float64], board: Chessboard) -> list[NDArray[np.float64]]:
    """Full vectors with every sphere moved by up to 0.4 squares (fixed seed: same frames, same fit)."""
    rng = np.random.default_rng(0)
    count = len(bench.scene.spheres)
    moves = rng.uniform(-0.4, 0.4, (RANDOM_STARTS, count, 3))
    return [moved(bench, full, board.square_mm * move) for move in moves]


def moved(bench: Bench, full: NDArray[np.float64], by_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the full vector with the spheres moved by (N, 3), then pushed apart."""
    found = np.array(full)
    rows = found[bench.glass].reshape(-1, len(SPHERE))
    rows[:, :3] += by_mm
    rows[:, :4] = pushed_apart(np.c_[rows, np.zeros(len(rows))])[:, :4]
    return found


def _cost(
    bench: Bench, full: NDArray[np.float64], candidates: Candidates, board: Chessboard, pitch_mm: float
) -> float:
    """Cauchy cost of the distances to the nearest corners."""
    off = distances(bench, full, candidates, board, pitch_mm)[0]
    square = np.nan_to_num((off**2).sum(axis=1), nan=LOST**2)
    return float(np.sum(np.log1p(square / KNEE_PX**2)))
