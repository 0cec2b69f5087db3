"""Bodies that nobody listed: parts of a frame of the target that do not show what the fitted scene shows there.

Corners say little about a bead or a drop: it hides three of them, or none where squares are wide.  The frame
itself says it, pixel by pixel.  A traced pixel shows a bright square or a dark one.  With W and B the means of the
frame nearby, over pixels of the same branch that show bright and dark squares, the frame agrees by

    a = +-(I - (W + B) / 2) / ((W - B) / 2),   + where a bright square is shown:  1 as it should, -1 as the other.

Asked are pixels off every edge, disc and border of a branch, where squares are wide enough to be seen.  Blur
changes no sign there, nor does slow shading.  Where a ball shows squares many times as large as they are, the fit
may not know which of them a pixel shows: a pixel says nothing whose place is known to less than UNSURE standard
deviations from the next edge.  What disagrees (a < 0), with all around it that agrees by halves
(a < HALF), is one part.  Its hull is masked, made wider by a share of a square: next to what disagrees the same
body agrees by chance.  So do the squares between two parts of one body, a dark wire before a dark square: parts
that are nearer to each other than SAME_BODY squares are masked with what lies between them.  A part that lies
within UNSURE standard deviations of the rim of a ball is that ball's, which stands a little elsewhere than the fit
could tell: it is masked and said, and no alarm.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.seen.prediction import in_target_frame
from correction.grid import grid_of
from correction.masked import hull_px, pixels_in
from correction.target import Chessboard
from tracer.masked import UNCONFIRMED, UNLISTED, MaskedPart, Point
from tracer.scene.scene import Scene
from tracer.strategies.branches import text_of
from tracer.strategies.ray_map import RayMap, build_ray_map
from tracer.strategies.sensitivity import TargetPose
from tracer.strategies.trace import RayStatus

CLEAR_PX = 5  # side of what must show one square: blur and the fit's own errors reach less far
NARROWEST_PX = 8.0  # views of a square that can be told bright from dark
NEARBY = 4.0  # squares: side of what W and B are taken from
HALF = 0.4  # agreement below which a pixel next to one that disagrees belongs to the same part
LOUD = 5.0  # standard deviations of the noise that bright and dark must differ from grey by, or nothing is asked
UNSURE = 3.0  # standard deviations of the place that a pixel shows, and of a rim's
NEARLY_ALL = 0.9
FEWEST, CERTAIN = 16, 5  # pixels of a part, and those of them that disagree
SHARE = 0.0005  # of the disc in which the smallest ball is seen, likewise
JOIN_PX = 9  # side of what joins pixels to parts
SAME_BODY = 1.5  # squares as seen there
BESIDE_PX, BESIDE = 4.0, 0.25  # a body reaches so far beyond what is seen of it: pixels, and squares seen there
Pixels = NDArray[np.int64]  # rows and columns (N, 2)


@dataclass(frozen=True)
class Unlisted:
    """A part of the view in which the frame is not what the scene shows.

    Parameters
    ----------
    frame, way : str
        Where: frame, and spheres crossed; empty beside the glass.
    pixels : int
        That disagree, at least by half.
    outlines_px : tuple of tuple of (float, float)
        Polygons u, v that cover it.
    rim_of : str
        The listed ball whose rim it may be, since its place is not known better; empty if there is none.
    """

    frame: str
    way: str
    pixels: int
    outlines_px: tuple[tuple[Point, ...], ...]
    rim_of: str = ""

    @property
    def masked(self) -> tuple[MaskedPart, ...]:
        """What no map is to use."""
        return tuple(MaskedPart(UNCONFIRMED if self.rim_of else UNLISTED, outline) for outline in self.outlines_px)

    def __str__(self) -> str:
        """Return one sentence."""
        points = np.concatenate(self.outlines_px)
        (left, top), (right, bottom) = points.min(axis=0), points.max(axis=0)
        where = f"through `{self.way}`" if self.way else "beside the glass"
        if self.rim_of:
            return (
                f"{self.frame}: around pixel ({(left + right) / 2:.0f}, {(top + bottom) / 2:.0f}) the rim of"
                f" `{self.rim_of}` is not where the scene shows it: too few corners are seen through it to tell"
                " its place; what lies there is masked in every map; smaller squares would show some"
            )
        return (
            f"{self.frame}: around pixel ({(left + right) / 2:.0f}, {(top + bottom) / 2:.0f}), {right - left:.0f}"
            f" x {bottom - top:.0f} px {where}, the frame does not show the squares that the scene shows:"
            " something that the scene does not list seems to stand there (a drop, a bead, dirt); it is masked in"
            " every map; list it among the bodies or take it away"
        )


@dataclass(frozen=True)
class View:
    """A frame with glass to be compared with what a scene shows.

    Parameters
    ----------
    name : str
    image : (H, W)
    pose : TargetPose
        Where the target stood.
    sigma_mm : callable, optional
        How well the place (N, 2) on the target that pixels (N, 2) show is known; it is exact if not given.
    """

    name: str
    image: NDArray[Any]
    pose: TargetPose
    sigma_mm: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None


def unlisted_parts(
    scene: Scene,
    views: Iterable[View],
    board: Chessboard,
    lattice: Sequence[NDArray[np.int64]],
    place_mm: Mapping[str, float] | None = None,
) -> tuple[Unlisted, ...]:
    """Parts of frames that are not what a scene shows, the largest first.

    Parameters
    ----------
    scene : Scene
        As fitted.
    views : iterable of View
        Frames with glass.
    board : Chessboard
    lattice : sequence of (N, 2) int64
        Corners that bare frames show; beyond them the board may end.
    place_mm : mapping, optional
        Ball -> standard deviation of its place sideways; those not in it are known exactly.
    """
    if not lattice:
        return ()
    index = np.concatenate(lattice)
    bounds = board.corner_mm(index.min(axis=0)), board.corner_mm(index.max(axis=0))
    found: list[Unlisted] = []
    for view in views:
        seen = in_target_frame(scene, view.pose)
        rays = build_ray_map(seen)
        width = _square_px(rays, board)
        for depth_mm in board.depths_mm[1:]:
            rays = _on_plate(rays, build_ray_map(in_target_frame(scene, view.pose.behind(depth_mm))), board)
        agrees = agreement(rays, view.image, board, bounds, width, board.square_mm / grid_of(seen.camera).pitch_mm)
        least_px = _least_px(seen)
        unsure = list(_parts(agrees, least_px)) if view.sigma_mm is not None else []
        for part in unsure:
            row, column = part[_unsure(part, rays, board, view)].T
            agrees[row, column] = np.nan
        for body in _bodies(_parts(agrees, least_px), width):
            largest = max(body, key=len)
            row, column = largest[len(largest) // 2]
            outlines = tuple(_outlines(body, width))
            known = [part for one in found for part in one.masked]  # in another frame
            if not any(pixels_in(part, agrees.shape)[row, column] for part in known):
                way = text_of(rays.branches[int(rays.branch[row, column])])
                rim = _rim_of(np.concatenate(body), seen, place_mm or {})
                found.append(Unlisted(view.name, way, sum(map(len, body)), outlines, rim))
    return tuple(sorted(found, key=lambda one: -one.pixels))


def _on_plate(rays: RayMap, other: RayMap, board: Chessboard) -> RayMap:
    """Ray map to a plate, from those to the planes of its two levels: pixels land where its level is met first.

    Around each mark its level is taken to reach half way to the next; what meets neither level meets the wall
    between, and shows nothing.
    """
    before = board.depths_mm[1] < 0.0  # the second is then before the first
    near, far = (other, rays) if before else (rays, other)
    on_near, on_far = (
        one.recovered
        & ((board.depth_mm(np.rint(np.nan_to_num(one.plane_mm) / board.sides_mm).astype(np.int64)) != 0.0) == odd)
        for one, odd in ((near, before), (far, not before))
    )
    plane = np.where(on_near[..., None], near.plane_mm, far.plane_mm)
    shown = (on_near | on_far) & rays.recovered & other.recovered
    status = np.where(shown, rays.status, np.uint8(RayStatus.MISSED_PLANE))
    return replace(rays, plane_mm=plane, status=status)


def _rim_of(pixels: Pixels, scene: Scene, place_mm: Mapping[str, float]) -> str:
    """Name of the ball whose rim may be seen at nearly all of these pixels (N, 2); empty if there is none."""
    way = scene.camera.directions(pixels[:, ::-1].astype(np.float64))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    for ball in scene.spheres:
        away = np.array(ball.centre_mm) - np.array(scene.camera.position_mm)
        far = float(np.linalg.norm(away))
        aside = np.arccos(np.clip(way @ (away / far), -1.0, 1.0)) - np.arcsin(min(ball.radius_mm / far, 1.0))
        near = np.abs(aside) * far < UNSURE * place_mm.get(ball.name, 0.0)
        if np.mean(near) > NEARLY_ALL:
            return ball.name
    return ""


def _unsure(part: Pixels, rays: RayMap, board: Chessboard, view: View) -> NDArray[np.bool_]:
    """Which pixels (N,) of a part may as well show the next square."""
    assert view.sigma_mm is not None
    apart = board.from_edges_mm(rays.plane_mm[part[:, 0], part[:, 1]])
    sigma = view.sigma_mm(part[:, ::-1].astype(np.float64))
    return np.asarray(~(UNSURE * sigma < apart).all(axis=1))


def agreement(
    rays: RayMap,
    image: NDArray[Any],
    board: Chessboard,
    bounds_mm: tuple[NDArray[np.float64], NDArray[np.float64]],
    width_px: NDArray[np.float64],
    square_px: float,
) -> NDArray[np.float32]:
    """How far each pixel (H, W) of a frame shows the square that it should, -1 to 1; NaN where it is not asked.

    Parameters
    ----------
    rays : RayMap
        To the board's plane.
    image : (H, W)
        The frame.
    board : Chessboard
    bounds_mm : (2,) and (2,) float64
        Least and largest x, y of the board that is there.
    width_px : (H, W) float64
        Narrow side of a square as seen there.
    square_px : float
        Side of a square as seen without glass.
    """
    import cv2

    point = np.nan_to_num(rays.plane_mm).astype(np.float64)
    there = rays.recovered & ((point >= bounds_mm[0]) & (point <= bounds_mm[1])).all(axis=-1)
    there &= width_px >= NARROWEST_PX
    bright = board.shade(point) > 0.5
    kind = np.where(there, 2.0 * rays.branch + bright + 1.0, 0.0).astype(np.float32)
    around = np.ones((CLEAR_PX, CLEAR_PX), np.uint8)
    clear = there & (cv2.erode(kind, around) == cv2.dilate(kind, around))
    light = cv2.blur(image.astype(np.float32), (3, 3))
    out = np.full(clear.shape, np.nan, np.float32)
    side = 2 * int(NEARBY * square_px / 2) + 1
    for number in np.unique(rays.branch[clear]):
        here = clear & (rays.branch == number)
        levels = [_mean(light, here & shade, side) for shade in (bright, ~bright)]
        grey, swing = 0.5 * (levels[0] + levels[1]), 0.5 * (levels[0] - levels[1])
        with np.errstate(invalid="ignore", divide="ignore"):
            value = np.where(bright, light - grey, grey - light) / swing
        asked = here & np.isfinite(value)
        if asked.any() and LOUD * 1.48 * np.median(np.abs(value[asked] - np.median(value[asked]))) < 1.0:
            out[asked] = value[asked]
    return out


def _mean(light: NDArray[Any], where: NDArray[np.bool_], side: int) -> NDArray[np.float32]:
    """Mean (H, W) of the light over a square of pixels, of those `where`; NaN where there are too few."""
    import cv2

    share, window = where.astype(np.float32), (side, side)
    total = cv2.blur(light * share, window, borderType=cv2.BORDER_CONSTANT)
    count = cv2.blur(share, window, borderType=cv2.BORDER_CONSTANT)
    return np.where(count * side**2 > CLEAR_PX**2, total / np.maximum(count, 1e-9), np.float32(np.nan))


def _square_px(rays: RayMap, board: Chessboard) -> NDArray[np.float64]:
    """Narrow side (H, W) of a square as seen at each pixel; 0 where nobody knows."""
    by_v, by_u = (np.asarray(np.gradient(rays.plane_mm, axis=axis), np.float64) for axis in (0, 1))
    square = (by_u**2 + by_v**2).sum(axis=-1)
    turned = by_u[..., 0] * by_v[..., 1] - by_u[..., 1] * by_v[..., 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        widest = np.sqrt(0.5 * (square + np.sqrt(np.maximum(square**2 - 4.0 * turned**2, 0.0))))
        return np.asarray(np.nan_to_num(board.square_mm / widest, nan=0.0, posinf=0.0))


def _parts(agrees: NDArray[np.float32], least_px: float) -> Iterator[Pixels]:
    """Rows and columns (N, 2) of each part that disagrees."""
    import cv2

    with np.errstate(invalid="ignore"):
        halfway, against = agrees < HALF, agrees < 0.0
    joined = cv2.dilate(halfway.astype(np.uint8), np.ones((JOIN_PX, JOIN_PX), np.uint8))
    label, count = scipy.ndimage.label(joined)
    sizes, certain = (np.bincount(label[each], minlength=count + 1) for each in (halfway, against))
    for number in np.flatnonzero((sizes >= max(FEWEST, least_px)) & (certain >= CERTAIN)).tolist():
        yield np.argwhere(halfway & (label == number))


def _least_px(scene: Scene) -> float:
    """Pixels of a part that count, by the smallest ball."""
    eye = np.array(scene.camera.position_mm)
    radii = [
        scene.camera.focal_px * ball.radius_mm / np.linalg.norm(eye - np.array(ball.centre_mm))
        for ball in scene.spheres
    ]
    return SHARE * float(np.pi * min(radii) ** 2) if radii else 0.0


def _bodies(parts: Iterable[Pixels], width_px: NDArray[np.float64]) -> list[list[Pixels]]:
    """Parts that may belong to one body, body by body."""
    every = list(parts)
    linked = np.eye(len(every), dtype=np.bool_)
    for one, other in combinations(range(len(every)), 2):
        linked[one, other] = _near(every[one], every[other], width_px)
    count, label = scipy.sparse.csgraph.connected_components(linked, directed=False) if every else (0, ())
    return [[part for part, own in zip(every, label, strict=True) if own == body] for body in range(count)]


def _near(one: Pixels, other: Pixels, width_px: NDArray[np.float64]) -> bool:
    gap = scipy.spatial.KDTree(one).query(other)[0].min()
    return bool(gap < SAME_BODY * max(_typical(one, width_px), _typical(other, width_px)))


def _typical(part: Pixels, width_px: NDArray[np.float64]) -> float:
    return float(np.median(width_px[part[:, 0], part[:, 1]]))


def _outlines(body: Sequence[Pixels], width_px: NDArray[np.float64]) -> Iterator[tuple[Point, ...]]:
    """Outlines of the parts of a body, two and two that are near each other together."""
    pairs = [(one, other) for one, other in combinations(body, 2) if _near(one, other, width_px)]
    for some in [np.concatenate(pair) for pair in pairs] or body:
        yield _hull(some, BESIDE_PX + BESIDE * _typical(some, width_px))


def _hull(part: Pixels, wider_px: float) -> tuple[Point, ...]:
    """Convex outline u, v of pixels (N, 2) given as rows and columns, made wider."""
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = wider_px * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    return hull_px((part[:, None, ::-1] + ring).reshape(-1, 2))
