"""Places of the balls by their outlines, before a single corner is paired.

A ball of radius R whose centre is D from the pinhole hides everything within the angle a = asin(R / D) of the
direction d of its centre: its rim is an ellipse in the frame, whose place gives two coordinates and whose size the
third.  The frame shows the rim by what it hides: corners of the bare lattice are found where the camera sees them
without glass beside the balls, and not behind them.  With m = max over balls (a - angle(ray, d)) the
margin of a corner inside the outlines,

    p(hidden) = 1 / (1 + exp(-m / t)),        t drawn in from SOFT to SHARP squares,

is fitted to what is hidden, by least squares over the centres, with priors that let all balls move together and
each by itself.  That is good to a few tenths of a millimetre sideways, and to some millimetres in depth; from
there corners are paired.  A ball behind another has no rim of its own: it goes where the others go.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.seen.measurement import MeasuredFrame
from correction.fit.seen.pairing import move_spheres, nearest_marks
from correction.fit.solve.unknowns import Unknowns
from correction.target import Chessboard
from correction.target.lattice_growth import Saddles
from tracer.camera import Camera
from tracer.scene.scene import Scene
from tracer.strategies.branches import DIRECT
from tracer.strategies.trace import trace

# Standard deviation of a move of all balls together, and of one by itself
COMMON_MM = 4.0
OWN_MM = 2.0
KEPT_GAP_MM = 0.2  # standard deviation of the gap that opens between balls that touch
SOFT, SHARP = (2.0, 1.0, 0.4), 0.2  # width of the outline, in squares
WRONG = 0.3  # standard deviation of a label: corners are missed, and found by chance
NEAR_RIM = 1.5  # squares: corners so near to an outline tell about it
MIN_OWN_CORNERS = 12  # of them that make a rim a ball's own
# And this share of all along its outline: what else is hidden there others hide, and a gap shows little
OWN = 0.2
MIN_LATTICE_CORNERS = 50  # corners of the lattice that must be seen or hidden
OUTLINE_SIGMAS = 3.0  # sigmas from which a move is more than chance
SAME = 0.1  # squares: a saddle so near to a corner of its kind is that corner
# What the outlines may be off in depth whatever their sigma: rims blur, and hide less or more
OUTLINE_DEPTH_SIGMA_MM = 4.0


@dataclass(frozen=True)
class Outlines:
    """Outlines of the balls, B of them.

    Parameters
    ----------
    names : tuple of str
        Of the balls.
    place_mm : (B, 3) float64
        Centres where the outlines show them.
    move_mm : (B, 3) float64
        From where the scene puts them to there.
    sigma_mm : (B, 3) float64
        Standard deviation of it.
    own_rim : (B,) bool
        Whether the ball shows a rim of its own; else it goes with the others.
    explained : float
        Share of the lattice's corners that are hidden or seen as the outlines say.
    """

    names: tuple[str, ...]
    place_mm: NDArray[np.float64]
    move_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    own_rim: NDArray[np.bool_]
    explained: float

    @property
    def sideways_mm(self) -> NDArray[np.float64]:
        """Offset of each ball from its place, sideways (B,)."""
        return np.asarray(np.hypot(self.move_mm[:, 0], self.move_mm[:, 1]))

    def surely_off(self, least_mm: float) -> NDArray[np.bool_]:
        """Balls (B,) with a rim of their own that stand beside their place by more than chance, and than that."""
        spread = np.hypot(self.sigma_mm[:, 0], self.sigma_mm[:, 1])
        return np.asarray(self.own_rim & (self.sideways_mm > np.maximum(least_mm, OUTLINE_SIGMAS * spread)))

    def beside(self, scene: Scene, least_mm: float) -> NDArray[np.bool_]:
        """Balls (B,) of a scene that stand beside their own rims by more than chance, and than that."""
        centre, eye = scene.sphere_table()[:, :3], np.array(scene.camera.position_mm)
        towards = (centre - eye) / np.linalg.norm(centre - eye, axis=1)[:, None]
        off = self.place_mm - centre
        aside = off - np.sum(off * towards, axis=1)[:, None] * towards  # of depth an outline tells little
        spread = np.hypot(self.sigma_mm[:, 0], self.sigma_mm[:, 1])
        return np.asarray(
            self.own_rim & (np.linalg.norm(aside, axis=1) > np.maximum(least_mm, OUTLINE_SIGMAS * spread))
        )

    def in_words(self, least_mm: float) -> str:
        """Say which balls stand beside their places, which way and how far; empty if none does."""
        off = self.surely_off(least_mm)
        words = [
            f"the rim of {name} is seen {_way(move)} of where the scene puts it"
            for name, move, far in zip(self.names, self.move_mm.tolist(), off.tolist(), strict=True)
            if far
        ]
        if len(words) > 1 and np.ptp(self.move_mm[off], axis=0)[:2].max() < 1.0:
            x, y, _ = self.move_mm[off].mean(axis=0).tolist()
            return (
                f"the rims of {', '.join(np.array(self.names)[off])} are all seen {_way([x, y])} of their places"
            )
        return "; ".join(words)


def _way(move: list[float]) -> str:
    """A move of a ball in words, by its larger parts."""
    x, y = move[0], move[1]
    parts = [f"{abs(x):.1f} mm to the {'right' if x > 0.0 else 'left'} (x {x:+.1f})"] if abs(x) > 0.3 else []
    parts += [f"{abs(y):.1f} mm {'above' if y > 0.0 else 'below'} (y {y:+.1f})"] if abs(y) > 0.3 else []
    return " and ".join(parts) or "within 0.3 mm"


def outlines_of(
    scene: Scene,
    camera: Camera,
    free: NDArray[np.bool_],
    corners_mm: NDArray[np.float64],
    hidden: NDArray[np.bool_],
    square_mm: float,
    packed: Iterable[tuple[int, int]] = (),
) -> Outlines | None:
    """Find the balls by what they hide.

    Parameters
    ----------
    scene : Scene
        As believed.
    camera : Camera
        As the bare board shows it.
    free : (B,) bool
        Balls whose centre may move.
    corners_mm : (N, 3) float64
        Corners of the lattice in the world, all within the frame.
    hidden : (N,) bool
        Whether a corner is not seen where it stands.
    square_mm : float
        Side of a square of the lattice.
    packed : iterable of (int, int)
        Balls that touch each other, and stay so: the rim of a neighbour is not taken for theirs.

    Returns
    -------
    Outlines or None
        None where the lattice says nothing: too few corners, or all of one kind.
    """
    count, table = len(scene.spheres), scene.sphere_table()
    if (
        len(corners_mm) < MIN_LATTICE_CORNERS
        or not count
        or not MIN_OWN_CORNERS <= np.count_nonzero(hidden) <= len(hidden) - MIN_OWN_CORNERS
    ):
        return None
    eye = np.array(camera.position_mm)
    ray = corners_mm - eye
    far = np.linalg.norm(ray, axis=1)
    ray = ray / far[:, None]
    square = square_mm / float(np.median(far))  # as an angle
    moving = np.flatnonzero(free)
    together = OWN_MM**2 * np.eye(len(moving)) + COMMON_MM**2
    tight = np.kron(np.linalg.inv(np.linalg.cholesky(together)), np.eye(3)) if len(moving) else np.zeros((0, 0))
    place = {int(ball): k for k, ball in enumerate(moving)}
    kept = [pair for pair in packed if pair[0] in place and pair[1] in place]
    gaps = np.zeros((len(kept), len(moving), 3))  # by how much a move opens the gap of balls that touch
    for row, (i, j) in enumerate(kept):
        apart = table[j, :3] - table[i, :3]
        gaps[row, place[j]] = apart / np.linalg.norm(apart) / KEPT_GAP_MM
        gaps[row, place[i]] = -gaps[row, place[j]]
    tight = np.concatenate((tight, gaps.reshape(len(kept), 3 * len(moving))))

    def margins(moves: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Margins (N, B) and their derivatives (N, B, 3) by the centres."""
        centre = table[:, :3].copy()
        centre[moving] += moves.reshape(-1, 3)
        away = centre - eye
        distance = np.linalg.norm(away, axis=1)
        towards = away / distance[:, None]
        cosine = np.clip(ray @ towards.T, -1.0, 1.0)
        half = np.clip(table[:, 3] / distance, 0.0, 0.999)
        sine = np.sqrt(np.maximum(1.0 - cosine**2, 1e-12))
        turn = (ray[:, None, :] - cosine[:, :, None] * towards) / (sine * distance)[:, :, None]
        smaller = (half / (distance * np.sqrt(1.0 - half**2)))[:, None] * towards
        return np.asarray(np.arcsin(half) - np.arccos(cosine)), np.asarray(turn - smaller)

    def misses(moves: NDArray[np.float64], width: float) -> NDArray[np.float64]:
        share = scipy.special.expit(margins(moves)[0].max(axis=1) / (width * square))
        return np.concatenate(((hidden - share) / WRONG, tight @ moves))

    def slopes(moves: NDArray[np.float64], width: float) -> NDArray[np.float64]:
        inside, rate = margins(moves)
        foremost = inside.argmax(axis=1)
        share = scipy.special.expit(inside.max(axis=1) / (width * square))
        steep = share * (1.0 - share) / (width * square * WRONG)
        by_centre = np.zeros((len(ray), count, 3))
        every = np.arange(len(ray))
        by_centre[every, foremost] = -steep[:, None] * rate[every, foremost]
        return np.concatenate((by_centre[:, moving].reshape(len(ray), -1), tight))

    moves = np.zeros(3 * len(moving))
    for width in (*SOFT, SHARP):
        found = scipy.optimize.least_squares(misses, moves, slopes, args=(width,), max_nfev=15)
        moves = found.x
    covariance = np.linalg.inv(found.jac.T @ found.jac) if len(moves) else np.zeros((0, 0))
    inside, _ = margins(moves)
    foremost = inside.argmax(axis=1)
    near = np.abs(inside.max(axis=1)) < NEAR_RIM * square
    move, sigma = np.zeros((count, 3)), np.zeros((count, 3))
    move[moving] = moves.reshape(-1, 3)
    sigma[moving] = np.sqrt(np.diag(covariance)).reshape(-1, 3)
    first = np.bincount(foremost[near], minlength=count)
    own = (first >= MIN_OWN_CORNERS) & (
        first >= OWN * np.count_nonzero(np.abs(inside) < NEAR_RIM * square, axis=0)
    )
    right = float(np.mean((inside.max(axis=1) > 0.0) == hidden))
    names = tuple(sphere.name for sphere in scene.spheres)
    return Outlines(names, table[:, :3] + move, move, sigma, own, right)


def find_outlines(
    unknowns: Unknowns,
    full: NDArray[np.float64],
    bare: MeasuredFrame,
    saddles: Saddles,
    least: float,
    height_number: int,
    board: Chessboard,
) -> Outlines | None:
    """Compare a frame with glass with the lattice as the bare frame shows it; see `outlines_of`.

    Parameters
    ----------
    unknowns : Unknowns
        With the believed scene.
    full : (F,) float64
        Camera as fitted.
    bare : MeasuredFrame
        Corners of the lattice that there are.
    saddles : Saddles
        Of the frame with glass.
    least : float
        Strength below which a saddle is noise.
    height_number : int
        Of the frame's target.
    board : Chessboard
    """
    if not all(map(unknowns.scene.in_camera_room, unknowns.scene.spheres)):
        return None  # behind a wall the lattice is not where the bare frame has it, beside the balls either
    strong = saddles.strength > least
    pixel, bright = saddles.position_px[strong], saddles.edges[strong].sum(axis=1)
    _, rays, node = nearest_marks(unknowns, full, (height_number, False), pixel, bright, board)
    at_node = np.linalg.norm(rays.point_mm - node, axis=1) < SAME * board.square_mm
    found = {tuple(index) for index in board.nearest_index(node[at_node]).tolist()}
    hidden = np.array([tuple(index) not in found for index in bare.index.tolist()], dtype=np.bool_)
    pose = unknowns.pose(full, height_number)
    corners = pose.to_world(board.corner_mm(bare.index)) - np.multiply.outer(
        board.depth_mm(bare.index), pose.axes[2]
    )
    free = np.array([f"{sphere.name}.x" in unknowns.names for sphere in unknowns.scene.spheres], dtype=np.bool_)
    scene, camera = unknowns.scene, unknowns.camera(full)
    rest = [body for body in scene.bodies if body not in scene.spheres]
    clear = np.ones(len(corners), dtype=np.bool_)
    if rest:  # what hides a corner is then no ball
        seen = trace(scene.with_camera(camera).with_bodies(rest), camera.project(corners))
        clear = seen.recovered & (seen.rays["key"] == DIRECT)
    packed = unknowns.packing.values()
    return outlines_of(scene, camera, free, corners[clear], hidden[clear], board.square_mm, packed)


def follow_outlines(
    unknowns: Unknowns, full: NDArray[np.float64], outlines: Outlines, alone: bool = False
) -> NDArray[np.float64]:
    """Full vector (F,) with the balls where the outlines show them, clear of each other and of the plane.

    Depth is followed only where it is off by more than the outlines may err; a ball without a rim of its own goes
    with the others, or stays if they move `alone`.
    """
    move = outlines.move_mm.copy()
    deep = np.abs(move[:, 2]) > np.maximum(OUTLINE_DEPTH_SIGMA_MM, OUTLINE_SIGMAS * outlines.sigma_mm[:, 2])
    move[~(deep & outlines.own_rim), 2] = 0.0
    if outlines.own_rim.any():
        move[~outlines.own_rim] = 0.0 if alone else move[outlines.own_rim].mean(axis=0)
    return move_spheres(unknowns, full, move)
