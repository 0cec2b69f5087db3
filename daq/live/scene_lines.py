"""Overlay lines of a scene for the page: a set for every view that a step of a plan can have.

**Outlines** of balls.  Where lines of sight touch a ball (``correction.alignment.rim``) is its outline in the raw
frame; the same lines, going on to the plane, are the outline of what the ball hides in the corrected one.  Where a
frame shows a ball beside its outline, it stands elsewhere than the scene says.

**Folds and masks**, found once, on coarse pixels.  Along a fold the plane is seen twice, once on each side, and
det d plane / d pixel changes its sign: in the raw frame folds are drawn where neighbouring pixels of one branch
differ in that sign, in the corrected one around what lies beyond them.  Masks are drawn around pixels from which
no ray reaches the plane, and around nodes of the plane that no pixel shows well.  A side has `COARSE_PX` coarse
pixels: lines are good to two or three of a frame's.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from correction.alignment.rim import tangent_points
from correction.errors import CorrectionError
from correction.grid import grid_of
from correction.maps.correction_map import build_correction_map
from correction.node_status import NodeStatus
from daq.plans.steps import BEHIND_GLASS, CLEAR
from ground.errors import GroundError
from piv.errors import PivError
from tracer.errors import TracerError
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import RayMap, build_ray_map
from tracer.strategies.trace import RayStatus

COARSE_PX = 504  # side of what is traced
LEAST_PX, LEAST_PX2 = 4, 12  # coarse pixels on a line and in a region; less is a speck
MOST_LINES = 60  # of one kind: more of them hide the picture
REACH = np.ones((3, 3), np.uint8)
SHOWN = NodeStatus.RECOVERED, NodeStatus.OUT_OF_FRAME
Line = list[list[float]]


def folds_and_masks(scene: Scene) -> dict[str, dict[str, list[Line]]]:
    """Lines for the page: name of a picture -> "folds" and "masks" -> lines of points in its pixels.

    Parameters
    ----------
    scene : Scene
        The plane z = 0 is seen through it.
    """
    times = max(1, round(max(scene.camera.sensor_px) / COARSE_PX))
    coarse = scene.coarser(times)
    rays = build_ray_map(coarse)
    status = build_correction_map(coarse, rays).status
    folded, lost = status == NodeStatus.FOLD, ~np.isin(status, SHOWN)
    return {
        "raw": {"folds": _folds(rays, times), "masks": _around(rays.status != RayStatus.RECOVERED, times)},
        "corrected": {"folds": _around(folded, times), "masks": _around(lost, times)},
    }


def _folds(rays: RayMap, times: int) -> list[Line]:
    """Lines between coarse pixels of one branch whose determinants differ in sign."""
    x, y, branch = rays.plane_mm[..., 0], rays.plane_mm[..., 1], rays.branch.astype(np.int64)
    alike = (branch[1:, 1:] == branch[:-1, :-1]) & (branch[1:, :-1] == branch[:-1, 1:])
    alike &= (branch[1:, 1:] == branch[1:, :-1]) & (branch[1:, 1:] > 0)
    xu, yu = (0.5 * (p[1:, 1:] + p[:-1, 1:] - p[1:, :-1] - p[:-1, :-1]) for p in (x, y))
    xv, yv = (0.5 * (p[1:, 1:] + p[1:, :-1] - p[:-1, 1:] - p[:-1, :-1]) for p in (x, y))
    with np.errstate(invalid="ignore"):
        turned = xu * yv - xv * yu
    lines: list[Line] = []
    for number in np.unique(branch[1:, 1:][alike & np.isfinite(turned)]).tolist():
        here = alike & (branch[1:, 1:] == number)
        one, other = ((here & (sign * turned > 0.0)).astype(np.uint8) for sign in (1.0, -1.0))
        if not (one.any() and other.any()):
            continue
        near = cv2.dilate(other, REACH)
        for contour in cv2.findContours(one, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]:
            points = contour[:, 0, :]
            on = near[points[:, 1], points[:, 0]] > 0
            lines += [_scale_line(run + 0.5, times, on.all()) for run in _runs(points, on)]
    return sorted(lines, key=len, reverse=True)[:MOST_LINES]


def _runs(points: NDArray[Any], on: NDArray[np.bool_]) -> list[NDArray[Any]]:
    """Parts of a closed line (N, 2) that are on; what begins at its end goes on at its beginning."""
    if on.all():
        return [points] if len(points) >= LEAST_PX else []
    first = int(np.argmin(on))  # begin where it is off
    points, on = np.roll(points, -first, axis=0), np.roll(on, -first)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], on.astype(np.int8), [0]))))
    return [points[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= LEAST_PX]


def _around(region: NDArray[np.bool_], times: int) -> list[Line]:
    """Closed lines around the parts of a region."""
    _, label, found, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8))
    large = region & (found[:, cv2.CC_STAT_AREA] >= LEAST_PX2)[label]
    contours, _ = cv2.findContours(large.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    long = sorted((c[:, 0, :] for c in contours if len(c) >= LEAST_PX), key=len, reverse=True)[:MOST_LINES]
    return [_scale_line(points, times, closed=True) for points in long]


def _scale_line(points: NDArray[Any], times: int, closed: bool) -> Line:
    """Points in pixels of the frame, as few as follow the line to half a coarse pixel."""
    few = cv2.approxPolyDP(points.astype(np.float32)[:, None, :], 0.5, closed)[:, 0, :]
    few = np.concatenate((few, few[:1])) if closed else few
    return [[round(float(u), 1), round(float(v), 1)] for u, v in (few + 0.5) * times - 0.5]


ANGLES = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
MAX_BALLS = 24  # balls; what is said of a snapshot has little room, and more lines hide the picture


def outlines(scene: Scene) -> dict[str, Any]:
    """Lines for the page: name of a picture -> list of closed lines, each with a name and points in its pixels.

    The cross is the origin of the plane.
    """
    grid, largest = grid_of(scene.camera), sorted(scene.spheres, key=lambda ball: -ball.radius_mm)[:MAX_BALLS]
    origin = np.zeros((1, 3))
    said: dict[str, Any] = {"raw": {"lines": []}, "corrected": {"lines": []}}
    pinhole = np.array(scene.camera.position_mm)
    for ball in largest:
        touch = tangent_points(scene.camera, np.array(ball.centre_mm), ball.radius_mm, ANGLES)
        if not np.isfinite(touch).all():  # the camera stands in it
            continue
        said["raw"]["lines"].append([ball.name, _round_points(scene.camera.project(touch))])
        if (touch[:, 2] < pinhole[2] - 1e-6 * ball.radius_mm).all():
            along = pinhole[2] / (pinhole[2] - touch[:, 2])
            plane = pinhole + (touch - pinhole) * along[:, None]
            said["corrected"]["lines"].append([ball.name, _round_points(grid.to_px(plane[:, :2]))])
    said["raw"]["cross"] = _round_points(scene.camera.project(origin))[0]
    said["corrected"]["cross"] = _round_points(grid.to_px(origin[:, :2]))[0]
    return said


def _round_points(pixels: NDArray[np.float64]) -> list[list[float]]:
    return [[round(float(u), 1), round(float(v), 1)] for u, v in np.nan_to_num(pixels, nan=-1e4)]


LIT = "light sheet"  # view of a step that shows the light sheet through the glass


def scene_lines(scene: Scene, whole: bool) -> dict[str, dict[str, Any]]:
    """Lines by view.

    Parameters
    ----------
    scene : Scene
        As the run has it.
    whole : bool
        With folds and masks, which take kernels; a scene for which there are none has its outlines.
    """
    lines: dict[str, dict[str, Any]] = {}
    for view, seen in ((BEHIND_GLASS, scene), (CLEAR, scene.bare()), (LIT, scene.in_light_sheet())):
        if view != BEHIND_GLASS and seen == scene:
            lines[view] = lines[BEHIND_GLASS]
            continue
        lines[view] = outlines(seen)
        if whole:
            _add_folds(lines[view], seen)
    return lines


def _add_folds(lines: dict[str, Any], scene: Scene) -> None:
    """Add folds and masks of a scene to its outlines."""
    try:
        found = folds_and_masks(scene)
    except (TracerError, CorrectionError, PivError, GroundError):
        return  # nothing is corrected there either, and the correction has said why
    for name, kinds in found.items():
        lines[name] |= kinds
