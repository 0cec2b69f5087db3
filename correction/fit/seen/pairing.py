"""Find out which lattice corner each saddle shows, when nothing is known but a rough scene.

The cost, the distance of every candidate to its nearest corner (`Candidates`) through a Cauchy loss, is a
continuous function of the scene and is minimised as it is, pairing anew at every step, with the knee of the
loss drawn in from rough to fine.  Several starts escape from pairings shifted by a corner; such a scene
bends light so differently elsewhere that it never gathers the inliers of the right one.  What this leaves
behind are spheres that show few corners (`lost_sphere`).

Candidates are the saddles of a frame that may be seen through glass.  Each is traced to the target with the
present scene and paired with the nearest lattice corner OF ITS OWN KIND: seen through the local derivative of the
trace, the saddle tells whether the square towards +x, +y is bright.  Corners of one kind lie sqrt(2) squares
apart, on a lattice turned by 45 degrees, so the pairing is right up to 0.7 squares of error; dots, which are all
of one kind, up to half a pitch.  On a plate each is paired with the nearest dot of either level, in its plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.contact import push_apart
from correction.fit.solve.solver import Corners, Residuals, Solution, free_rates, land_corners, minimise
from correction.fit.solve.unknowns import Unknowns
from correction.target import Chessboard
from correction.target.lattice_growth import Saddles
from tracer.strategies.branches import DIRECT
from tracer.strategies.sensitivity import SPHERE, TARGET, Landings, parameter_names

SQUEEZED = 5.0  # a raw pixel that covers more corrected pixels than this shows no squares
SEARCH_WIDENING = 1.15  # candidates are looked for in spheres wider by this
KNEES_PX = (12.0, 4.0, 1.0)  # of the loss, in corrected pixels, from rough to fine
INLIER_PX = 1.0
GOOD_INLIER_SHARE = 0.9  # share of inliers at which no further start is tried
TWICE = 0.6  # the same, if two starts have ended at the same scene
SAME_MM = 0.05
# Spheres, of which half may have gone astray in two starts that ended alike: they are found later
MANY = 4
RANDOM_STARTS = 64


@dataclass(frozen=True)
class Candidates:
    """Saddles of one frame.

    Parameters
    ----------
    height_number : int
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

    height_number: int
    pixel: NDArray[np.float64]
    bright: NDArray[np.float64]
    inside: NDArray[np.bool_]
    bare: NDArray[np.bool_]

    def take(self, chosen: NDArray[np.bool_]) -> "Candidates":
        """Return the candidates where `chosen`."""
        pixel, bright = self.pixel[chosen], self.bright[chosen]
        return Candidates(self.height_number, pixel, bright, self.inside[chosen], self.bare[chosen])


def candidates_of(
    saddles: Saddles,
    least: float,
    unknowns: Unknowns,
    full: NDArray[np.float64],
    height_number: int,
    board: Chessboard,
) -> Candidates:
    """Choose the saddles that may be seen through glass.

    Saddles weaker than `least` are noise; those that fit the bare lattice and lie well outside the nominal
    glass say nothing about it.
    """
    bright = saddles.edges.sum(axis=1)
    everything, rays, node = nearest_marks(
        unknowns, full, (height_number, False), saddles.position_px, bright, board
    )
    bare = np.linalg.norm(rays.point_mm - node, axis=1) < 0.1 * board.square_mm
    wide = np.array(full)
    wide[unknowns.glass].reshape(-1, len(SPHERE))[:, 3] *= SEARCH_WIDENING
    everything = replace(everything, glass=True)
    through = land_corners(unknowns, wide, everything, by_walls=True)
    inside = _behind_balls(unknowns, through, rays) & (saddles.strength > least)
    in_wall = rays.recovered & (rays.key != DIRECT)  # squeezed by the wall of a tube: no ball is there
    chosen = inside | (~bare & ~in_wall & (saddles.strength > least))
    return Candidates(height_number, saddles.position_px[chosen], bright[chosen], inside[chosen], bare[chosen])


def _behind_balls(unknowns: Unknowns, rays: Landings, bare: Landings) -> NDArray[np.bool_]:
    """Rays (N,) that a ball turns, or loses; going through a tube's wall alone does not count."""
    behind, scene = rays.key != DIRECT, unknowns.scene
    standing = {body.name for body in scene.bodies if body.stays}
    if not standing:
        return np.asarray(behind)
    owners = [name.rpartition(".")[0] for name in parameter_names(scene)[: -len(TARGET)]]
    of_glass = [place for place, owner in enumerate(owners) if owner not in {"camera", *standing}]
    turned = np.any(rays.rate[:, :, of_glass] != 0.0, axis=(1, 2))
    return np.asarray(behind & np.where(rays.recovered, turned, bare.recovered))


def nearest_marks(
    unknowns: Unknowns,
    full: NDArray[np.float64],
    view: tuple[int, bool],
    pixel: NDArray[np.float64],
    bright: NDArray[np.float64],
    board: Chessboard,
) -> tuple[Corners, Landings, NDArray[np.float64]]:
    """Land saddles, or dots, on the level of the board on which they are nearest to a mark.

    Parameters
    ----------
    unknowns, full
        The scene.
    view : (int, bool)
        Number of the target's height, and whether the glass stood there.
    pixel : (N, 2) float64
    bright : (N, 2) float64
        Image direction of the bright squares.
    board : Chessboard

    Returns
    -------
    Corners
        Of these pixels, without their places on the board, but on the level that was found.
    Landings
    (N, 2) float64
        Nearest mark [mm]; NaN where a ray does not land.
    """
    zeros, found = np.zeros_like(pixel), []
    for depth_mm in board.depths_mm:
        corners = Corners(*view, pixel, zeros, 1.0, np.full(len(pixel), depth_mm))
        rays = land_corners(unknowns, full, corners)
        found.append((corners, rays, _nearest_nodes(rays.point_mm, rays.pixel_rate, bright, board, depth_mm)))
    if len(found) == 1:
        return found[0]
    away = np.stack([np.linalg.norm(rays.point_mm - node, axis=1) for _, rays, node in found])
    nearest = np.where(np.isfinite(away), away, np.inf).argmin(axis=0)
    corners = replace(found[0][0], depth_mm=np.array(board.depths_mm)[nearest])
    (_, rays, node), (_, lower_rays, lower_node) = found
    return corners, rays.where(nearest == 0, lower_rays), np.where((nearest == 0)[:, None], node, lower_node)


def _nearest_nodes(
    point_mm: NDArray[np.float64],
    pixel_rate: NDArray[np.float64],
    bright: NDArray[np.float64],
    board: Chessboard,
    depth_mm: float,
) -> NDArray[np.float64]:
    """Nearest mark of the right kind, and level, (N, 2) [mm] of landing points (N, 2); NaN stays NaN."""
    place = board.along_mm(point_mm) / board.sides_mm
    x, y = place.T
    if board.dots is not None:  # all of one kind
        if not board.dots.levels:
            return board.on_board_mm(np.rint(place) * board.sides_mm)
        odd = np.full(len(x), float(depth_mm != 0.0))
        if board.dots.levels == "rows":
            return np.asarray(
                np.stack((np.rint(x), 2.0 * np.rint((y - odd) / 2.0) + odd), axis=-1) * board.sides_mm
            )
        if board.dots.levels == "columns":
            return np.asarray(
                np.stack((2.0 * np.rint((x - odd) / 2.0) + odd, np.rint(y)), axis=-1) * board.sides_mm
            )
    else:
        towards = (pixel_rate @ bright[:, :, None])[:, :, 0]
        odd = np.where((towards[:, 0] * towards[:, 1] > 0.0) == board.odd_bright, 1.0, 0.0)
    p = 2.0 * np.rint((x + y - odd) / 2.0) + odd
    q = 2.0 * np.rint((x - y - odd) / 2.0) + odd
    return board.on_board_mm(np.stack((p + q, p - q), axis=-1) * 0.5 * board.sides_mm)


def pairing_residuals(
    unknowns: Unknowns, x: NDArray[np.float64], candidates: Candidates, board: Chessboard, pitch_mm: float
) -> Residuals:
    """Distance of each candidate to its nearest corner, in corrected or raw pixels, whichever are coarser.

    Near a rim a ray turns wildly with every number of the scene, and would dominate: there the distance is
    measured in raw pixels, and where the view is squeezed too much it is not asked at all.
    """
    full = unknowns.full(x)
    off, scale, rays, corners = distances(unknowns, full, candidates, board, pitch_mm)
    return Residuals(off, free_rates(unknowns, full, corners, rays) / scale[:, :, None])


def distances(
    unknowns: Unknowns, full: NDArray[np.float64], candidates: Candidates, board: Chessboard, pitch_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], Landings, Corners]:
    """Distances (N, 2) to the nearest corners [px], mm a px (N, 1), and the rays they come from."""
    stretched = board.stretch(unknowns.stretch(full)[:2])  # `land_corners` makes the step deeper by itself
    view = candidates.height_number, True
    corners, rays, node = nearest_marks(unknowns, full, view, candidates.pixel, candidates.bright, stretched)
    off = rays.point_mm - node
    spread = np.sqrt((rays.pixel_rate**2).sum(axis=(1, 2)))  # of a pixel, on the plane
    scale = np.maximum(spread, pitch_mm)[:, None]
    off[spread > SQUEEZED * pitch_mm] = np.nan
    return off / scale, scale, rays, corners


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
) -> Start:
    """Minimise the distance to the nearest corners from one start."""

    def evaluate(at: NDArray[np.float64]) -> list[Residuals]:
        return [pairing_residuals(unknowns, at, frame, board, pitch_mm) for frame in frames]

    for knee in KNEES_PX:
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
    return [
        move_spheres(unknowns, full, board.square_mm * np.where(everything[:, None], move, 0.0)) for move in moves
    ]


def random_starts(unknowns: Unknowns, full: NDArray[np.float64], board: Chessboard) -> list[NDArray[np.float64]]:
    """Full vectors with every sphere moved by up to 0.4 squares (fixed seed: same frames, same fit)."""
    rng = np.random.default_rng(0)
    count = len(unknowns.scene.spheres)
    moves = rng.uniform(-0.4, 0.4, (RANDOM_STARTS, count, 3))
    return [move_spheres(unknowns, full, board.square_mm * move) for move in moves]


def move_spheres(unknowns: Unknowns, full: NDArray[np.float64], by_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the full vector with the spheres moved by (N, 3), then pushed apart."""
    found = np.array(full)
    rows = found[unknowns.glass].reshape(-1, len(SPHERE))
    rows[:, :3] += by_mm
    rows[:, :4] = push_apart(np.c_[rows, np.zeros(len(rows))])[:, :4]
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

    def is_explained() -> bool:
        alike = sum(_same(unknowns, best(), other) for other in tried)
        return best().share >= (TWICE if alike > 1 else GOOD_INLIER_SHARE)

    def attempt(start: NDArray[np.float64]) -> None:
        tried.append(pair_from(unknowns, unknowns.free(start), frames, board, pitch_mm))

    near = group_starts(unknowns, full, board)
    for start in [near[0], *further, *near[1:]]:
        attempt(start)
        if is_explained():
            return sorted(tried, key=lambda one: -one.inliers)
    if best().share < TWICE:
        for start in random_starts(unknowns, full, board):
            attempt(start)
            if is_explained():
                break
    return sorted(tried, key=lambda one: -one.inliers)


def _same(unknowns: Unknowns, one: Start, other: Start) -> bool:
    """Return whether two starts led to the same places of the spheres, or most of many, seen from the camera."""
    off = np.abs(unknowns.sigma * (one.solution.x - other.solution.x))
    apart = {sphere.name: 0.0 for sphere in unknowns.scene.spheres}
    for name, by in zip(unknowns.names, off.tolist(), strict=True):
        ball, _, part = name.rpartition(".")
        if part in ("x", "y") and ball in apart:
            apart[ball] = max(apart[ball], by)
    astray = sum(by >= SAME_MM for by in apart.values())
    return astray <= (len(apart) // 2 if len(apart) >= MANY else 0)
