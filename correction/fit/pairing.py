"""Pair saddles with the lattice corners that they show, when nothing is known but a rough scene.

Each candidate is traced to the target with the present scene and paired with the nearest lattice corner OF
ITS OWN KIND: seen through the local derivative of the trace, the saddle tells whether the square towards +x, +y is
bright.  Corners of one kind lie sqrt(2) squares apart, on a lattice turned by 45 degrees, so the pairing is
right up to 0.7 squares of error.  The cost (distance to the nearest corner, through a Cauchy loss) is a
continuous function of the scene and is minimised as it is, pairing anew at every step, with the knee of the
loss drawn in from rough to fine.  Several starts escape from pairings shifted by a corner; such a scene
bends light so differently elsewhere that it never gathers the inliers of the right one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from correction.fit.contact import pushed_apart
from correction.fit.solver import LOST, Corners, Residuals, Solution, free_rates, landed, minimise
from correction.fit.unknowns import Bench
from correction.saddles import Saddles
from correction.target import Chessboard
from tracer.kernels.march import DIRECT
from tracer.sensitivity import SPHERE, Landings

KNEES_PX = (12.0, 4.0, 1.0)  # of the loss, in corrected pixels, from rough to fine
INLIER_PX = 1.0
SQUEEZED = 5.0  # a raw pixel that covers more corrected pixels than this shows no squares
WIDER = 1.15  # candidates are looked for in spheres wider by this
ENOUGH = 0.9  # share of inliers at which no further start is tried
TWICE = 0.6  # the same, if two starts have ended at the same scene
SAME_MM = 0.05
RANDOM_STARTS = 16
SCAN = 5  # steps each way when one sphere is scanned
SWEEPS = 3  # over all spheres, as long as one of them gains
VALLEYS = 3  # minima of the scan that are followed


@dataclass(frozen=True)
class Candidates:
    """Saddles of one frame.

    Parameters
    ----------
    height : int
        Number of the target's height.
    pixel : (N, 2) float64
        u, v.
    bright : (N, 2) float64
        Image direction of the bright squares.
    inside : (N,) bool
        Within the outline of the nominal glass, made a little wider.
    bare : (N,) bool
        On the lattice as it would be seen without glass.
    """

    height: int
    pixel: NDArray[np.float64]
    bright: NDArray[np.float64]
    inside: NDArray[np.bool_]
    bare: NDArray[np.bool_]

    def take(self, chosen: NDArray[np.bool_]) -> "Candidates":
        """Return the candidates where `chosen`."""
        pixel, bright = self.pixel[chosen], self.bright[chosen]
        return Candidates(self.height, pixel, bright, self.inside[chosen], self.bare[chosen])


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


def candidates_of(
    saddles: Saddles,
    least: float,
    bench: Bench,
    full: NDArray[np.float64],
    height: int,
    board: Chessboard,
) -> Candidates:
    """Choose the saddles that may be seen through glass.

    Saddles weaker than `least` are noise; those that fit the bare lattice and lie well outside the nominal
    glass say nothing about it.
    """
    bright = saddles.edges.sum(axis=1)
    everything = Corners(height, False, saddles.position_px, np.zeros((len(saddles), 2)), 1.0)
    rays = landed(bench, full, everything)
    node = nearest_nodes(rays.point_mm, rays.pixel_rate, bright, board)
    bare = np.linalg.norm(rays.point_mm - node, axis=1) < 0.1 * board.square_mm
    wide = np.array(full)
    wide[bench.glass].reshape(-1, len(SPHERE))[:, 3] *= WIDER
    inside = landed(bench, wide, Corners(height, True, everything.pixel, everything.node_mm, 1.0)).key != DIRECT
    inside &= saddles.strength > least
    chosen = inside | (~bare & (saddles.strength > least))
    return Candidates(height, saddles.position_px[chosen], bright[chosen], inside[chosen], bare[chosen])


def nearest_nodes(
    point_mm: NDArray[np.float64],
    pixel_rate: NDArray[np.float64],
    bright: NDArray[np.float64],
    board: Chessboard,
) -> NDArray[np.float64]:
    """Nearest lattice corner of the right kind (N, 2) [mm] of landing points (N, 2); NaN stays NaN."""
    towards = (pixel_rate @ bright[:, :, None])[:, :, 0]
    odd = np.where(towards[:, 0] * towards[:, 1] > 0.0, 1.0, 0.0)
    x, y = point_mm.T / board.square_mm
    p = 2.0 * np.rint((x + y - odd) / 2.0) + odd
    q = 2.0 * np.rint((x - y - odd) / 2.0) + odd
    return np.asarray(np.stack((p + q, p - q), axis=-1) * 0.5 * board.square_mm)


def paired_residuals(
    bench: Bench, x: NDArray[np.float64], candidates: Candidates, board: Chessboard, pitch_mm: float
) -> Residuals:
    """Distance of each candidate to its nearest corner, in corrected or raw pixels, whichever are coarser.

    Near a rim a ray turns wildly with every number of the scene, and would dominate: there the distance is
    measured in raw pixels, and where the view is squeezed too much it is not asked at all.
    """
    full = bench.full(x)
    off, scale, rays, corners = _distances(bench, full, candidates, board, pitch_mm)
    return Residuals(off, free_rates(bench, full, corners, rays) / scale[:, :, None])


def _distances(
    bench: Bench, full: NDArray[np.float64], candidates: Candidates, board: Chessboard, pitch_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], Landings, Corners]:
    """Distances (N, 2) to the nearest corners [px], mm a px (N, 1), and the rays they come from."""
    corners = Corners(candidates.height, True, candidates.pixel, np.zeros_like(candidates.pixel), 1.0)
    rays = landed(bench, full, corners)
    off = rays.point_mm - nearest_nodes(rays.point_mm, rays.pixel_rate, candidates.bright, board)
    spread = np.sqrt((rays.pixel_rate**2).sum(axis=(1, 2)))  # of a pixel, on the plane
    scale = np.maximum(spread, pitch_mm)[:, None]
    off[spread > SQUEEZED * pitch_mm] = np.nan
    return off / scale, scale, rays, corners


def pair_from(
    bench: Bench,
    x: NDArray[np.float64],
    frames: Sequence[Candidates],
    board: Chessboard,
    pitch_mm: float,
    knees_px: Sequence[float] = KNEES_PX,
) -> Start:
    """Minimise the distance to the nearest corners from one start."""

    def evaluate(at: NDArray[np.float64]) -> list[Residuals]:
        return [paired_residuals(bench, at, frame, board, pitch_mm) for frame in frames]

    for knee in knees_px:
        solution = minimise(bench, evaluate, x, knee=knee, steps=25, tolerance=1e-2)
        x = solution.x
    square = np.concatenate([(part.value**2).sum(axis=1) for part in evaluate(x)])
    square = square[np.isfinite(square) & ~np.concatenate([frame.bare for frame in frames])]
    near = square[square < INLIER_PX**2]
    return Start(solution, len(near), len(square), float(np.sqrt(near.mean())) if len(near) else float("nan"))


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


def _cost(
    bench: Bench, full: NDArray[np.float64], candidates: Candidates, board: Chessboard, pitch_mm: float
) -> float:
    """Cauchy cost of the distances to the nearest corners."""
    off = _distances(bench, full, candidates, board, pitch_mm)[0]
    square = np.nan_to_num((off**2).sum(axis=1), nan=LOST**2)
    return float(np.sum(np.log1p(square / KNEES_PX[1] ** 2)))


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


def pair(
    bench: Bench,
    full: NDArray[np.float64],
    frames: Sequence[Candidates],
    board: Chessboard,
    pitch_mm: float,
) -> list[Start]:
    """Try starts until one explains the frames; best first.

    Parameters
    ----------
    bench : Bench
        With the glass free.
    full : (F,) float64
        Full vector to start around.
    frames : sequence of Candidates
        Frames with glass.
    board : Chessboard
    pitch_mm : float
        A corrected pixel on the plane.
    """
    tried: list[Start] = []

    def best() -> Start:
        return max(tried, key=lambda one: one.inliers)

    def explained() -> bool:
        alike = sum(_same(bench, best(), other) for other in tried)
        return best().share >= (TWICE if alike > 1 else ENOUGH)

    def attempt(start: NDArray[np.float64]) -> None:
        tried.append(pair_from(bench, bench.free(start), frames, board, pitch_mm))

    for start in group_starts(bench, full, board):
        attempt(start)
        if explained():
            return sorted(tried, key=lambda one: -one.inliers)
    for _ in range(SWEEPS):  # one sphere may be lost while the others explain the most
        before = best().inliers
        for number in range(len(bench.scene.spheres)):
            at = bench.full(best().solution.x)
            for start in sphere_starts(bench, at, frames, board, pitch_mm, number):
                attempt(start)
        if best().inliers == before:
            break
    if best().share < TWICE:
        for start in random_starts(bench, full, board):
            attempt(start)
            if explained():
                break
    return sorted(tried, key=lambda one: -one.inliers)


def _same(bench: Bench, one: Start, other: Start) -> bool:
    """Whether two starts ended with the spheres at the same places, seen from the camera."""
    sideways = [name.endswith((".x", ".y")) for name in bench.names]
    off = np.abs(bench.sigma * (one.solution.x - other.solution.x))[sideways]
    return bool(off.max(initial=0.0) < SAME_MM)
