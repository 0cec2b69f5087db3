"""From a frame to its saddle points, and from these to patches of a lattice, without a start.

Where two edges cross, intensity has a saddle: the Hessian H of the smoothed frame has eigenvalues
l1 > 0 > l2, and l1 up the bright squares.  -det H is large there, zero along a straight edge and negative on
a blob; it does not depend on rotation, and little on perspective.  The edges themselves are the directions
in which the quadratic form vanishes: at angles +-atan(sqrt(-l1 / l2)) from the eigenvector of l1.

Dots of a grid grow alike (`dots_seen`): theirs are no saddles, and all of one kind, which no step can check.

Next to a corner the lattice has corners of the opposite kind (bright and dark exchanged), so every step
along an edge can be checked.

A seed is a saddle with a neighbour of the opposite kind along each of its four edges.  From there the
lattice grows by one step a round: the position, the edge directions and the kind of each new corner must
agree with its neighbour's.  Steps are predicted from the last step, so the lattice may bend as a whole as
much as it likes (perspective, barrel distortion), only not by more than a quarter of a square from one
square to the next.

Dots of a plate with two levels grow level by level (`two_levels`).

Indices are relative here: i along the first axis, j along the second, handed as the board's x, y are in a
view from the front (v points down, hence det < 0).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

SADDLE_SMOOTHING_PX = 1.6  # standard deviation; squares down to 8 px still have one saddle a corner
MIN_SHRUNK_SQUARE_PX = 12.0  # to which squares may be shrunk to look for saddles
WORTH_IT = 1.25  # times that a frame is shrunk at least, or not at all
NEAREST_PX = 3  # two corners are never closer
MIN_SADDLE_STRENGTH = 0.06  # of the strength of the strongest corners
# Largest miss of a predicted corner, in squares
TOLERANCE, TOLERANCE_ON_PLATE = 0.28, 0.18
COS_EDGE = 0.9  # edges of neighbours agree to 25 degrees
MIN_PATCH_CORNERS = 9  # a patch smaller than this is chance
LEAST_BOARD = 12  # corners: the six squares around the discs and a little more
STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1))
NEAREST_SADDLES = 13  # nearest saddles looked at around a seed
SEED_COSINE = 0.97  # of a seed: cosine between an edge and the way to a neighbour
MAX_UNEVEN_STEP = 0.25  # of the longer: by how much the ways to both neighbours along an axis differ
Index = tuple[int, int]


@dataclass(frozen=True)
class Saddles:
    """Saddle points of a frame, or the dots in it, N of them.

    Attributes
    ----------
    position_px : (N, 2) float64
        u, v, good to about 0.1 px.
    edges : (N, 2, 2) float64
        ``edges[n, k]`` is the unit vector of edge k; the squares around ``edges[n, 0] + edges[n, 1]`` and
        opposite to it are bright.
    strength : (N,) float64
        -det H; of dots how much darker than the paper they are.
    alike : bool
        Whether all are of one kind, as dots are.
    levels : str
        Of dots of a plate: `tracer.board.Dots.levels`.
    steps : (N, 2, 2) float64, optional
        Of dots of a plate: to the next ones of the same level along the edges [px].
    """

    position_px: NDArray[np.float64]
    edges: NDArray[np.float64]
    strength: NDArray[np.float64]
    alike: bool = False
    levels: str = ""
    steps: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.strength)


def find_saddles(frame: NDArray[Any], mask: NDArray[np.bool_] | None = None) -> Saddles:
    """Find saddle points, strongest first.

    Parameters
    ----------
    frame : (H, W) uint8, uint16 or float32
        The frame.
    mask : (H, W) bool, optional
        True where candidates may lie.
    """
    import cv2

    smooth = cv2.GaussianBlur(
        frame.astype(np.float32), (0, 0), SADDLE_SMOOTHING_PX, borderType=cv2.BORDER_REPLICATE
    )
    uu = cv2.sepFilter2D(smooth, cv2.CV_32F, np.array([1.0, -2.0, 1.0]), np.array([1.0]))
    vv = cv2.sepFilter2D(smooth, cv2.CV_32F, np.array([1.0]), np.array([1.0, -2.0, 1.0]))
    slope = np.array([-0.5, 0.0, 0.5])
    uv = cv2.sepFilter2D(smooth, cv2.CV_32F, slope, slope)
    strength = uv * uv - uu * vv
    size = 2 * NEAREST_PX + 1
    peak = (strength == cv2.dilate(strength, np.ones((size, size), np.uint8))) & (strength > 0.0)
    peak[:NEAREST_PX], peak[-NEAREST_PX:], peak[:, :NEAREST_PX], peak[:, -NEAREST_PX:] = False, False, False, False
    if mask is not None:
        peak &= mask
    v, u = np.nonzero(peak)
    if len(u) == 0:
        return Saddles(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0))
    value = strength[v, u].astype(np.float64)
    strong = np.sort(value)[-min(len(value), 100) :]
    keep = np.flatnonzero(value > MIN_SADDLE_STRENGTH * np.median(strong))
    keep = keep[np.argsort(-value[keep], kind="stable")]
    u, v = u[keep], v[keep]
    hessian = np.array([[uu[v, u], uv[v, u]], [uv[v, u], vv[v, u]]], dtype=np.float64).transpose(2, 0, 1)
    first = 0.5 * np.stack((smooth[v, u + 1] - smooth[v, u - 1], smooth[v + 1, u] - smooth[v - 1, u]), axis=-1)
    shift = -np.linalg.solve(hessian, first.astype(np.float64)[..., None])[..., 0]
    position = np.stack((u, v), axis=-1) + np.clip(shift, -1.0, 1.0)
    return Saddles(position, _edges(hessian), value[keep])


def _edges(hessian: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors (N, 2, 2) in which the quadratic forms (N, 2, 2) vanish."""
    values, vectors = np.linalg.eigh(hessian)
    low, high = values[:, 0], values[:, 1]
    up, across = vectors[:, :, 1], vectors[:, :, 0]
    angle = np.arctan(np.sqrt(np.maximum(high, 0.0) / np.maximum(-low, 1e-300)))
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return np.stack((c * up - s * across, c * up + s * across), axis=1)


def coarse_saddles(frame: NDArray[Any], square_px: float, mask: NDArray[np.bool_] | None = None) -> Saddles:
    """Saddles of a frame, looked for in one that is shrunk as far as its squares of `square_px` allow.

    Large frames are searched faster, and what is printed in the squares, a marker or a disc, blurs into grey.
    """
    import cv2

    shrink = square_px / MIN_SHRUNK_SQUARE_PX
    if shrink < WORTH_IT:
        return find_saddles(frame, mask)
    size = round(frame.shape[1] / shrink), round(frame.shape[0] / shrink)
    small = cv2.resize(frame.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    by = np.array((frame.shape[1] / size[0], frame.shape[0] / size[1]))
    seen = None
    if mask is not None:
        seen = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    found = find_saddles(np.asarray(small), seen)
    return replace(found, position_px=(found.position_px + 0.5) * by - 0.5)


@dataclass(frozen=True)
class Patch:
    """A connected piece of lattice with N corners.

    Attributes
    ----------
    index : (N, 2) int64
        Relative i, j.
    position_px : (N, 2) float64
    axes_px : (N, 2, 2) float64
        Columns: displacement by one square along i and along j.
    sign : (N,) int8
        +1 if the square to +i, +j is bright, and of dots.
    error_px : float
        How far off the positions may be.
    """

    index: NDArray[np.int64]
    position_px: NDArray[np.float64]
    axes_px: NDArray[np.float64]
    sign: NDArray[np.int8]
    error_px: float = 0.5

    def take(self, chosen: NDArray[np.bool_]) -> "Patch":
        """Return the corners where `chosen` (N,)."""
        return Patch(
            self.index[chosen], self.position_px[chosen], self.axes_px[chosen], self.sign[chosen], self.error_px
        )


def grow_patches(saddles: Saddles) -> list[Patch]:
    """Return all patches, largest first."""
    if len(saddles) < MIN_PATCH_CORNERS:
        return []
    tree = scipy.spatial.cKDTree(saddles.position_px)
    axes, good = _seeds(saddles, tree) if saddles.steps is None else _right_handed(saddles.steps)
    free = np.ones(len(saddles), dtype=bool)
    patches = []
    for seed in np.flatnonzero(good):  # strongest first
        if free[seed]:
            patch = _grow(saddles, tree, int(seed), axes[seed], free)
            if len(patch.index) >= MIN_PATCH_CORNERS:
                patches.append(patch)
            elif saddles.levels and len(patch.index):
                free[tree.query(patch.position_px[1:])[1]] = True
    return sorted(patches, key=lambda patch: -len(patch.index))


def lattice_saddles(frame: NDArray[Any], saddles: Saddles, square_px: float) -> Saddles:
    """Saddles of a frame that belong to lattices, of squares of any size up to twice `square_px`.

    Parameters
    ----------
    frame : (H, W) uint8, uint16 or float32
        The frame.
    saddles : Saddles
        All that are in it.
    square_px : float
        Usual side of a square.
    """
    found: list[Saddles] = []
    for times in (0.0, 1.0, 2.0):
        some = saddles if times == 0.0 else coarse_saddles(frame, times * square_px)
        patches = grow_patches(some)
        if not patches or (times and times * square_px < 2.0 * MIN_SHRUNK_SQUARE_PX):
            continue
        at = scipy.spatial.cKDTree(some.position_px).query(np.concatenate([one.position_px for one in patches]))[1]
        if found:
            known = scipy.spatial.cKDTree(np.concatenate([one.position_px for one in found]))
            at = at[known.query(some.position_px[at])[0] > NEAREST_PX]
        found.append(Saddles(some.position_px[at], some.edges[at], some.strength[at]))
    if not found:
        return saddles
    position, edges, strength = (
        np.concatenate([getattr(one, name) for one in found]) for name in ("position_px", "edges", "strength")
    )
    return Saddles(position, edges, strength)


def lattice_axes(
    index: NDArray[np.int64], position: NDArray[np.float64], axes: NDArray[np.float64], plate: bool = False
) -> None:
    """Replace axes (N, 2, 2) in place by central differences of neighbours where there are any.

    On a plate the next dot is on the other level: there differences to one side are left out.
    """
    place = {(int(i), int(j)): n for n, (i, j) in enumerate(index)}
    for n, (i, j) in enumerate(index.tolist()):
        for k, (di, dj) in enumerate(((1, 0), (0, 1))):
            ahead, behind = place.get((i + di, j + dj)), place.get((i - di, j - dj))
            if ahead is not None and behind is not None:
                axes[n, :, k] = 0.5 * (position[ahead] - position[behind])
            elif plate:
                continue
            elif ahead is not None:
                axes[n, :, k] = position[ahead] - position[n]
            elif behind is not None:
                axes[n, :, k] = position[n] - position[behind]


def _signs(edges: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.int8]:
    """Kinds (N,) of saddles with unit edges (N, 2, 2: rows) in axes (N, 2, 2: columns); 0 if edges disagree."""
    unit = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    cosine = np.abs(edges @ unit)  # [saddle, edge, axis]
    straight = np.minimum(cosine[:, 0, 0], cosine[:, 1, 1]) > COS_EDGE
    crossed = np.minimum(cosine[:, 0, 1], cosine[:, 1, 0]) > COS_EDGE
    bright = edges[:, 0] + edges[:, 1]
    both, apart = unit[..., 0] + unit[..., 1], unit[..., 0] - unit[..., 1]
    # The bisector of the axes is compared in length-free form, so sheared squares count as well; multiplied out,
    # as axes along one line have none.
    along, across = (np.abs((bright * way).sum(axis=1)) for way in (both, apart))
    along, across = along * np.linalg.norm(apart, axis=1), across * np.linalg.norm(both, axis=1)
    return np.where(straight | crossed, np.where(along > across, 1, -1), 0).astype(np.int8)


def _kinds(saddles: Saddles, which: NDArray[np.intp], axes: NDArray[np.float64]) -> NDArray[np.int8]:
    """Kinds of some saddles (N,) in axes (N, 2, 2): columns; 0 where the edges disagree with these."""
    # Large dots, and those beside marks or at the rim of a plate, show other directions or none.
    if saddles.levels:
        return np.ones(len(which), np.int8)
    signs = _signs(saddles.edges[which], axes)
    return np.abs(signs) if saddles.alike else signs


def _seeds(saddles: Saddles, tree: "scipy.spatial.cKDTree") -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Axes (N, 2, 2) of every saddle from its nearest neighbours along its edges, and whether all four exist."""
    position, edges = saddles.position_px, saddles.edges
    count = min(NEAREST_SADDLES, len(saddles))
    distance, neighbour = tree.query(position, k=count)
    distance, neighbour = distance[:, 1:], neighbour[:, 1:]
    towards = (position[neighbour] - position[:, None]) / distance[..., None]
    axes = np.zeros((len(saddles), 2, 2))
    good = np.ones(len(saddles), dtype=bool)
    rows = np.arange(len(saddles))
    for k in range(2):
        along = np.einsum("nmc,nc->nm", towards, edges[:, k])
        ends = []
        for side in (1.0, -1.0):
            reach = np.where(side * along > SEED_COSINE, distance, np.inf)
            best = reach.argmin(axis=1)
            good &= np.isfinite(reach[rows, best])
            ends.append(position[neighbour[rows, best]] - position)
        ahead, behind = np.hypot(*ends[0].T), np.hypot(*ends[1].T)
        good &= np.abs(ahead - behind) < MAX_UNEVEN_STEP * np.maximum(ahead, behind)
        axes[:, :, k] = 0.5 * (ends[0] - ends[1])
    return _right_handed(axes.transpose(0, 2, 1))[0], good


def _right_handed(steps: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Axes (N, 2, 2: columns), handed as the board is, from two steps (N, 2, 2: rows), and whether they exist."""
    axes = steps.transpose(0, 2, 1).copy()
    axes[np.linalg.det(np.nan_to_num(axes)) > 0.0, :, 1] *= -1.0
    return axes, np.asarray(np.isfinite(axes).all(axis=(1, 2)))


def _grow(
    saddles: Saddles,
    tree: "scipy.spatial.cKDTree",
    seed: int,
    axes: NDArray[np.float64],
    free: NDArray[np.bool_],
) -> Patch:
    """Grow one patch from a seed; corners taken are no longer free."""
    tolerance = TOLERANCE_ON_PLATE if saddles.levels else TOLERANCE
    next_to = 1 if saddles.alike else -1  # the kind of a neighbour, times one's own
    sign = int(_kinds(saddles, np.array([seed]), axes[None])[0])
    found: dict[Index, tuple[int, NDArray[np.float64], int]] = {}
    if sign:
        found[0, 0] = (seed, axes, sign)
        free[seed] = False
    frontier = list(found)
    while frontier:
        steps = [
            (at, step) for at in frontier for step in STEPS if (at[0] + step[0], at[1] + step[1]) not in found
        ]
        frontier = []
        if not steps:
            break
        start = np.array([saddles.position_px[found[at][0]] for at, _ in steps])
        stride = np.array([found[at][1] @ step for at, step in steps])
        distance, nearest = tree.query(start + stride)
        near = np.flatnonzero(distance < tolerance * np.hypot(*stride.T))
        if not len(near):
            break
        own = np.array([found[steps[n][0]][1] for n in near])
        for row, n in enumerate(near):
            _, (di, dj) = steps[n]
            over = saddles.position_px[nearest[n]] - start[n]
            own[row, :, 0 if di else 1] = over * (di + dj)
        signs = _kinds(saddles, nearest[near], own)
        for row, n in enumerate(near):
            (i, j), (di, dj) = steps[n]
            saddle, key = int(nearest[n]), (i + di, j + dj)
            if not free[saddle] or key in found:
                continue
            parent_sign = found[i, j][2]
            if signs[row] == next_to * parent_sign:
                found[key] = (saddle, own[row], next_to * parent_sign)
                free[saddle] = False
                frontier.append(key)
    index = np.array(list(found), dtype=np.int64).reshape(-1, 2)
    members = list(found.values())
    position = saddles.position_px[[saddle for saddle, _, _ in members]].reshape(-1, 2)
    all_axes = np.array([own for _, own, _ in members]).reshape(-1, 2, 2)
    if len(index):
        lattice_axes(index, position, all_axes)
    return Patch(index, position, all_axes, np.array([s for _, _, s in members], dtype=np.int8))
