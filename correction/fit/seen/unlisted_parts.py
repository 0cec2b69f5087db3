"""Unlisted bodies: parts of a frame of the target that do not show what the fitted scene shows there.

Corners say little about a bead or a drop: it hides three of them, or none where squares are wide.  The frame
itself says it, pixel by pixel (`view_agreement`).

Where a ball shows squares many times as large as they are, the fit may not know which of them a pixel shows: a
pixel says nothing whose place is known to less than PLACE_SIGMAS standard deviations from the next edge.  What
disagrees (a < 0), with all around it that agrees by halves (a < NEIGHBOUR_AGREEMENT), is one part.  Its hull is
masked, made wider by a share of a square: next to what disagrees the same body agrees by chance.  So do the
squares between two parts of one body, a dark wire before a dark square: parts that are nearer to each other than
SAME_BODY squares are masked with what lies between them.  A part that lies within PLACE_SIGMAS standard deviations
of the rim of a ball is that ball's, which stands a little elsewhere than the fit could tell: it is masked and
said, and no alarm.

A view that shows other squares on more than MISFIT of its pixels, or next to their edges alone, is not hidden by a
body: it is bent otherwise than the scene bends it, and is unconfirmed as a whole (`unconfirmed_ways.Misfit`).  The
ball that bends it is the one on its way of which other views confirm least, or whose rim is not where the scene
shows it (`rims_seen`), which is an alarm of its own.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.seen.prediction import in_target_frame
from correction.fit.seen.rims_seen import RimSeen, rims_off
from correction.fit.seen.unconfirmed_ways import Misfit
from correction.fit.seen.view_agreement import DIRECT_VIEW, Shown
from correction.masked import hull_px, pixels_in
from correction.target import Chessboard
from tracer.masked import UNCONFIRMED, UNLISTED, MaskedPart, Point
from tracer.scene.scene import Scene
from tracer.strategies.branches import branch_of, text_of
from tracer.strategies.ray_map import RayMap
from tracer.strategies.sensitivity import TargetPose

NEIGHBOUR_AGREEMENT = 0.4  # agreement below which a pixel next to one that disagrees belongs to the same part
PLACE_SIGMAS = 3.0  # standard deviations of the place that a pixel shows, and of a rim's
NEARLY_ALL = 0.9
MISFIT = 0.1  # of the pixels of a view, from which it is bent otherwise than the scene bends it
ALL_OVER = 0.4  # of the spread of a view's pixels, from which some of them are not in one place
FEWEST, CERTAIN = 16, 5  # pixels of a part, and those of them that disagree
MIN_DISC_SHARE = 0.0005  # of the disc in which the smallest ball is seen, likewise
JOIN_PX = 9  # side of what joins pixels to parts
SAME_BODY = 1.5  # squares as seen there
WIDER_PX, WIDER = 4.0, 0.25  # a body reaches so far beyond what is seen of it: pixels, and squares seen there
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
        """Parts that no map is to use."""
        return tuple(MaskedPart(UNCONFIRMED if self.rim_of else UNLISTED, outline) for outline in self.outlines_px)

    def __str__(self) -> str:
        """Return one sentence."""
        points = np.concatenate(self.outlines_px)
        (left, top), (right, bottom) = points.min(axis=0), points.max(axis=0)
        where = f"through `{self.way}`" if self.way else "beside the glass"
        else_ = ", or radius, glass or place of a ball on that way is a little off" if self.way else ""
        if self.rim_of:
            return (
                f"{self.frame}: around pixel ({(left + right) / 2:.0f}, {(top + bottom) / 2:.0f}) the rim of"
                f" `{self.rim_of}` is not where the scene shows it: too few corners are seen through it to tell"
                " its place; what lies there is masked in every map; smaller squares would show some"
            )
        return (
            f"{self.frame}: around pixel ({(left + right) / 2:.0f}, {(top + bottom) / 2:.0f}), {right - left:.0f}"
            f" x {bottom - top:.0f} px {where}, the frame does not show the squares that the scene shows:"
            f" something that the scene does not list seems to stand there (a drop, a bead, dirt){else_}; it is"
            " masked in every map; list it among the bodies or take it away"
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


@dataclass(frozen=True)
class Compared:
    """Frames with glass, compared with what the fitted scene shows.

    Parameters
    ----------
    unlisted : tuple of Unlisted
        Parts that are not what the scene shows, the largest first.
    misfits : tuple of Misfit
        Ways through the glass that are bent otherwise than the scene bends them.
    rims : tuple of RimSeen
        Rims of listed balls that are not where the scene shows them.
    """

    unlisted: tuple[Unlisted, ...] = ()
    misfits: tuple[Misfit, ...] = ()
    rims: tuple[RimSeen, ...] = ()


def compare_views(
    scene: Scene,
    views: Iterable[View],
    board: Chessboard,
    lattice: Sequence[NDArray[np.int64]],
    place_mm: Mapping[str, float] | None = None,
    size_mm: Mapping[str, float] | None = None,
) -> Compared:
    """Compare frames with what a scene shows, pixel by pixel, and the rims of all its balls.

    Parameters
    ----------
    scene : Scene
        As fitted.
    views : iterable of View
        Frames with glass.
    board : Chessboard
        As large as its print was found to be.
    lattice : sequence of (N, 2) int64
        Corners that bare frames show; beyond them the board may end.
    place_mm : mapping, optional
        Ball -> standard deviation of its place sideways; those not in it are known exactly.
    size_mm : mapping, optional
        The same of its radius.
    """
    if not lattice:
        return Compared()
    place = dict(place_mm or {})
    corners = board.corner_mm(np.concatenate(lattice))
    bounds = corners.min(axis=0), corners.max(axis=0)
    found: list[Unlisted] = []
    rims: dict[str, RimSeen] = {}
    misfits: dict[str, Misfit] = {}
    for view in views:
        shown = Shown.of(scene, view.pose, board, bounds)
        seen, rays, width = in_target_frame(scene, view.pose), shown.rays, shown.width_px
        known_mm = {ball: (far, (size_mm or {}).get(ball, 0.0)) for ball, far in place.items()}
        for rim in rims_off(seen, shown, view.image, board, bounds, known_mm):
            rims.setdefault(rim.ball, rim)
            place[rim.ball] = place.get(rim.ball, 0.0) + rim.off_px * rim.pixel_mm
        agrees = shown.agreement(view.image)
        least_px = _least_px(seen)
        unsure = list(_parts(agrees, least_px)) if view.sigma_mm is not None else []
        for part in unsure:
            row, column = part[_unsure(part, rays, board, view)].T
            agrees[row, column] = np.nan
        for misfit in _misfits(shown, agrees, board, view.name, least_px, rims):
            misfits.setdefault(misfit.way, misfit)
            agrees[rays.branch == rays.branches.index(branch_of(misfit.way))] = np.nan
        for body in _bodies(_parts(agrees, least_px), width):
            largest = max(body, key=len)
            row, column = largest[len(largest) // 2]
            outlines = tuple(_outlines(body, width))
            known = [part for one in found for part in one.masked]  # in another frame
            if not any(pixels_in(part, agrees.shape)[row, column] for part in known):
                way = text_of(rays.branches[int(rays.branch[row, column])])
                rim_of = _rim_of(np.concatenate(body), seen, place, rims)
                found.append(Unlisted(view.name, way, sum(map(len, body)), outlines, rim_of))
    by_size = tuple(sorted(found, key=lambda one: -one.pixels))
    return Compared(by_size, tuple(misfits.values()), tuple(rims.values()))


def _misfits(
    shown: Shown,
    agrees: NDArray[np.float32],
    board: Chessboard,
    frame: str,
    least_px: float,
    rims: Mapping[str, RimSeen],
) -> Iterator[Misfit]:
    """Ways through the glass that show other squares all over, or beside their edges."""
    number = np.where(np.isfinite(agrees), shown.rays.branch, DIRECT_VIEW)
    asked = np.bincount(number.ravel(), minlength=len(shown.rays.branches))
    with np.errstate(invalid="ignore"):
        against = agrees < 0.0
    wrong = np.bincount(number[against], minlength=len(asked))
    good = {
        ball: sum(
            int(asked[at] - wrong[at])
            for at, way in enumerate(shown.rays.branches)
            if ball in way and wrong[at] <= MISFIT * asked[at]
        )
        for ball in {ball for way in shown.rays.branches for ball in way}
    }
    named: set[str] = set()
    found = np.flatnonzero(wrong >= max(FEWEST, least_px)).tolist()
    for at in sorted(
        found, key=lambda at: (len(shown.rays.branches[at]), -wrong[at])
    ):  # balls by themselves first
        way = shown.rays.branches[at]
        everywhere = 0.0 if named & set(way) else ALL_OVER  # another view of a wrong ball may show it in one place
        if way and (
            wrong[at] > MISFIT * asked[at] or _beside_edges(number == at, against, shown, board, everywhere)
        ):
            suspect = min(way, key=lambda ball: (ball not in rims, ball not in named, good[ball]))
            named.add(suspect)
            yield Misfit(text_of(way), float(wrong[at] / asked[at]), suspect, frame)


def _beside_edges(
    view: NDArray[np.bool_],
    against: NDArray[np.bool_],
    shown: Shown,
    board: Chessboard,
    everywhere: float,
) -> bool:
    """Return whether disagreeing pixels of a view lie nearer to edges than half of it, in more than one place.

    Squares that are seen a little aside differ there, all over the view; a body hides them anywhere, or in one
    place.
    """
    wrong = against[view]
    from_edge = board.from_edges_mm(shown.rays.plane_mm[view]).min(axis=1)
    spread = [np.argwhere(each).std(axis=0).sum() for each in (against & view, view)]
    near = np.quantile(from_edge[wrong], NEARLY_ALL) < np.median(from_edge)
    return bool(near and spread[0] > everywhere * spread[1])


def _rim_of(pixels: Pixels, scene: Scene, place_mm: Mapping[str, float], whole: Collection[str]) -> str:
    """Name of the ball whose rim may be seen at nearly all of these pixels (N, 2); empty if there is none.

    Of balls that are masked as a `whole`, what lies within the rim is theirs as well.
    """
    way = scene.camera.directions(pixels[:, ::-1].astype(np.float64))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    for ball in scene.spheres:
        away = np.array(ball.centre_mm) - np.array(scene.camera.position_mm)
        far = float(np.linalg.norm(away))
        aside = np.arccos(np.clip(way @ (away / far), -1.0, 1.0)) - np.arcsin(min(ball.radius_mm / far, 1.0))
        beside = aside if ball.name in whole else np.abs(aside)
        near = beside * far < PLACE_SIGMAS * place_mm.get(ball.name, 0.0)
        if np.mean(near) > NEARLY_ALL:
            return ball.name
    return ""


def _unsure(part: Pixels, rays: RayMap, board: Chessboard, view: View) -> NDArray[np.bool_]:
    """Pixels (N,) of a part that may as well show the next square."""
    assert view.sigma_mm is not None
    apart = board.from_edges_mm(rays.plane_mm[part[:, 0], part[:, 1]])
    sigma = view.sigma_mm(part[:, ::-1].astype(np.float64))
    return np.asarray(~(PLACE_SIGMAS * sigma < apart).all(axis=1))


def _parts(agrees: NDArray[np.float32], least_px: float) -> Iterator[Pixels]:
    """Rows and columns (N, 2) of each part that disagrees."""
    import cv2

    with np.errstate(invalid="ignore"):
        halfway, against = agrees < NEIGHBOUR_AGREEMENT, agrees < 0.0
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
    return MIN_DISC_SHARE * float(np.pi * min(radii) ** 2) if radii else 0.0


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
        yield _hull(some, WIDER_PX + WIDER * _typical(some, width_px))


def _hull(part: Pixels, wider_px: float) -> tuple[Point, ...]:
    """Convex outline u, v of pixels (N, 2) given as rows and columns, made wider."""
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = wider_px * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    return hull_px((part[:, None, ::-1] + ring).reshape(-1, 2))
