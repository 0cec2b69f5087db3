"""Predicted corners of the target, on every branch, and the measurement there.

The inverse of the ray map on a raster whose nodes are the lattice corners gives each corner's pixel on
every sheet, exactly, with the local derivative: one square along the board's +x and +y as it appears in the
frame.  That is all a sub-pixel fit needs to know: window, orientation and shade follow from it.  Windows
stay inside one branch, clear of the rim by a few pixels, because the scene is not yet exact.

A print that is stretched more one way than the other has no square lattice: from the node beside it, each of its
corners is found by Newton's method along traced rays.

A plate shows each of its levels in the plane of that level, all others of its lattice in another: levels are
predicted one by one.

The corner fit knows straight and evenly curved edges.  Next to a fold the view also twists: the odd part of
the landing point, (X(u + d) - X(u - d))/2 - h, that no affine frame explains grows with the cube of the
window.  Windows are shortened until it is below TWIST_PX at their ends.  What is left of it displaces corners
where the view is uneven as well.  With t the twist and e = sum over both axes of (X(u + d) + X(u - d))/2 - X(u),
both at the ends of a window of half length l and in px, corners of exact renders lie off along e by
PULLED t |e| / l, or by a sixth to twice that: a forecast that says which corners must be drawn (`bent_view`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.fit.seen.dot_rims import off_centre
from correction.grid import PlaneGrid
from correction.maps.correction_map import build_correction_map
from correction.target import Chessboard
from correction.target.chessboard import LINES
from correction.target.corners import MIN_HALF_WINDOW_PX, CornerFit, CornerSearch, half_widths_px
from correction.target.marks import refine_marks
from tracer.camera import LONGEST_MM, Vector3
from tracer.scene.scene import Scene
from tracer.strategies.branches import Numbers, text_of
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.sensitivity import TargetPose
from tracer.strategies.trace import trace

MIN_VIEW_SQUARE_PX = 10.0  # narrowest view of a square that a corner can be fitted in
LARGEST_SQUARE_PX = 600.0
WIDE_VIEW_QUANTILE = 0.8  # of the view behind glass; what is left lies along folds, where everything looks wide
NARROWEST = 0.02  # sensor px a corrected px: views that show a square worth naming, if not worth fitting
CORNER_SHEETS = 3  # sheets on which one corner is looked for
TARGET_WIDENING = 1.6  # the glass shows more of the target than the bare view, by this factor at most
BRANCH_MARGIN_PX = 2  # windows stay this far from the border of their branch
# Half length of a window in squares: noise wins over curvature, which is fitted (0.25: 15 % worse)
PREDICTED_WINDOW = 0.42
# The same where the view bends most; a corner that needs less, or MIN_HALF_WINDOW_PX, is not asked
SHORTEST = 0.2
# Cubic bending at the ends of a window that is allowed (from 3 px on corners err by 0.1-1 px)
TWIST_PX = 1.0
NEWTON, SETTLED_PX = 4, 1e-3  # steps, and how near the last must come
PULLED = 0.06  # how much what is left of it pulls at corners, see above


@dataclass(frozen=True)
class Expected:
    """Corners that a scene shows in a frame, N of them (one lattice corner may be there on several sheets).

    Parameters
    ----------
    index : (N, 2) int64
        Corner of the board.
    pixel : (N, 2) float64
        Acquired pixel u, v.
    axes_px : (N, 2, 2) float64
        Columns: displacement by one square along the board's +x, +y.
    branch : (N,) uint16 or uint32
        Number of the branch in `branches`; 0 is the direct view.
    rim_px : (N,) float64
        Distance to the border of the branch.
    window : (N,) float64
        Half length of the window to fit in, in squares.
    bent_px : (N, 2) float64
        How far the bending of the view in the window may pull a corner, or puts the middle of a dot's picture off
        its centre: a rough forecast.
    branches : tuple of tuple of str
        Names of the spheres crossed.
    usable : (H, W) bool
        Pixels that windows may use.
    """

    index: NDArray[np.int64]
    pixel: NDArray[np.float64]
    axes_px: NDArray[np.float64]
    branch: Numbers
    rim_px: NDArray[np.float64]
    window: NDArray[np.float64]
    bent_px: NDArray[np.float64]
    branches: tuple[tuple[str, ...], ...]
    usable: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.index)

    @property
    def ways(self) -> NDArray[np.str_]:
        """Spheres crossed (N,), as text."""
        return np.array([text_of(names) for names in self.branches])[self.branch]

    def take(self, chosen: NDArray[np.bool_]) -> "Expected":
        """Return the corners where `chosen`."""
        return replace(
            self,
            index=self.index[chosen],
            pixel=self.pixel[chosen],
            axes_px=self.axes_px[chosen],
            branch=self.branch[chosen],
            rim_px=self.rim_px[chosen],
            window=self.window[chosen],
            bent_px=self.bent_px[chosen],
        )


def expect(scene: Scene, pose: TargetPose, board: Chessboard, times: int = 1) -> Expected:
    """Predict every corner on every sheet, level by level.

    Parameters
    ----------
    scene : Scene
        The scene.
    pose : TargetPose
        Where the target stands.
    board : Chessboard
    times : int
        A camera so much coarser says where they are: enough for a forecast, which has no frame; places along rims
        and folds, less wide than its pixels, are lost.

    Raises
    ------
    SceneError
        The target stands where a body is.
    """
    levels = [_on_level(scene, pose, board, depth_mm, times) for depth_mm in board.depths_mm]
    return levels[0] if len(levels) == 1 else _merge_levels(levels)


def _merge_levels(levels: Sequence[Expected]) -> Expected:
    """Marks of all levels, one level after the other; windows may use what is clear of borders on each."""
    branches = tuple(dict.fromkeys(way for level in levels for way in level.branches))
    numbered = [np.array([branches.index(way) for way in level.branches])[level.branch] for level in levels]
    parts = {
        name: np.concatenate([getattr(level, name) for level in levels])
        for name in ("index", "pixel", "axes_px", "rim_px", "window", "bent_px")
    }
    usable = np.logical_and.reduce([level.usable for level in levels])
    number = np.concatenate(numbered).astype(levels[0].branch.dtype)
    return Expected(**parts, branch=number, branches=branches, usable=usable)


def on_each_level(
    expected: Expected, pose: TargetPose, board: Chessboard
) -> Iterator[tuple[TargetPose, NDArray[np.bool_]]]:
    """Planes of the levels of a board, and which marks (N,) lie on each; marks of one follow those of another."""
    depth = board.depth_mm(expected.index)
    for depth_mm in board.depths_mm:
        yield pose.behind(depth_mm), np.asarray(depth == depth_mm)


def _on_level(scene: Scene, pose: TargetPose, board: Chessboard, depth_mm: float, times: int) -> Expected:
    """Predict every corner of one level on every sheet; arguments as of `expect`."""
    import cv2

    seen_from_target = in_target_frame(scene, pose.behind(depth_mm))
    searched = seen_from_target.coarser(times)
    ray_map = build_ray_map(searched)
    grid = _lattice(searched, board)
    finer = grid.pitch_mm / float(board.sides_mm.mean())
    found = build_correction_map(
        searched,
        ray_map,
        grid,
        layers=CORNER_SHEETS if scene.spheres else 1,
        min_magnification=MIN_VIEW_SQUARE_PX / times * finer,
        max_magnification=LARGEST_SQUARE_PX / times * finer,
    )
    seen = np.isfinite(found.pixel[..., 0])
    if board.staggered:  # every second node of the raster is a corner
        seen &= np.add.outer(np.arange(grid.shape[0]), np.arange(grid.shape[1])) % 2 == 0
    _, rows, columns = np.nonzero(seen)
    middle = (grid.shape[0] - 1) // 2
    raster = np.stack((columns - middle, middle - rows), axis=-1)
    index = raster @ LINES // 2 if board.staggered else raster  # LINES LINES^T = 2
    axes = found.jacobian[seen].astype(np.float64).reshape(-1, 2, 2) * np.array([1.0, -1.0]) * times
    branch = np.where(ray_map.recovered, ray_map.branch.astype(np.float64), -1.0)  # a type that OpenCV takes
    kernel = np.ones((3, 3), np.uint8)
    within = ray_map.recovered & (cv2.erode(branch, kernel) == cv2.dilate(branch, kernel))
    away = cv2.distanceTransform(within.astype(np.uint8), cv2.DIST_L2, 5)
    pixel = (found.pixel[seen] + 0.5) * times - 0.5
    held = np.ones(len(pixel), bool)
    if np.ptp(board.sides_mm):
        node_mm, node_axes = grid.pitch_mm * raster.astype(np.float64), axes / grid.pitch_mm
        pixel, held = _move_onto(seen_from_target, pixel, node_axes, node_mm, board.corner_mm(index))
    if np.ptp(board.sides_mm) or board.staggered:
        axes = axes * (board.sides_mm / grid.pitch_mm) @ board.steps
    window, bent = _windows(seen_from_target, pixel, axes, board)
    at = np.rint(found.pixel[seen]).astype(np.int64)
    rim = away[at[:, 1], at[:, 0]].astype(np.float64) * times
    branches = tuple(found.branches)
    every = Expected(index, pixel, axes, found.branch[seen], rim, window, bent, branches, away > BRANCH_MARGIN_PX)
    held &= board.has_corner(index)
    if len(board.depths_mm) > 1:
        own = board.depth_mm(index) == depth_mm
        every, held = every.take(own), held[own]
        index, pixel, axes, window = every.index, every.pixel, every.axes_px, every.window
    if board.dots is not None:
        every = replace(every, bent_px=off_centre(seen_from_target, board, index, pixel, axes))
        held &= np.isfinite(every.bent_px[:, 0])
    return every.take(held & (window >= SHORTEST) & (half_widths_px(axes, window) >= MIN_HALF_WINDOW_PX))


def square_behind_px(scene: Scene, pose: TargetPose, board: Chessboard) -> float:
    """Width (narrow side) of a square behind glass [px] that most of the view stays below; 0 if there is none."""
    seen_from_target = in_target_frame(scene, pose)
    found = build_correction_map(
        seen_from_target,
        build_ray_map(seen_from_target),
        min_magnification=NARROWEST,
        max_magnification=LARGEST_SQUARE_PX,
    )
    narrow, _ = found.magnification()
    behind = narrow[found.behind_glass]
    return (
        float(np.quantile(behind, WIDE_VIEW_QUANTILE)) * board.square_mm / found.grid.pitch_mm
        if behind.size
        else 0.0
    )


def measure(frame: NDArray[Any], expected: Expected, board: Chessboard) -> CornerFit:
    """Fit all expected corners in the raw frame."""
    return refine_marks(
        frame,
        board,
        expected.index,
        expected.pixel,
        expected.axes_px,
        expected.usable,
        expected.window,
        CornerSearch(board.arm),
    )


def in_target_frame(scene: Scene, pose: TargetPose) -> Scene:
    """Return the scene in the coordinates of a target, whose plane is then z = 0.

    A target that is tilted is no wall: its plane may meet a window far beside it.

    Raises
    ------
    SceneError
        A body reaches through the target.
    """
    origin, axes = np.array(pose.origin_mm), np.array(pose.axes)
    if not origin.any() and np.array_equal(axes, np.eye(3)):
        return scene

    def point(world: Vector3) -> Vector3:
        x, y, z = axes @ (np.array(world) - origin)
        return float(x), float(y), float(z)

    camera = scene.camera
    a, b, c = ((float(r[0]), float(r[1]), float(r[2])) for r in camera.rotation_matrix @ axes.T)
    camera = replace(camera, position_mm=point(camera.position_mm), rotation=(a, b, c))
    cut_mm = scene.cut_mm if abs(axes[2, 2]) == 1.0 else LONGEST_MM
    return replace(scene, camera=camera, bodies=tuple(body.moved(point) for body in scene.bodies), cut_mm=cut_mm)


def _move_onto(
    scene: Scene,
    pixel: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    from_mm: NDArray[np.float64],
    to_mm: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Pixels (N, 2) that show points `to_mm` (N, 2) near those that are seen at `pixel`, by px a mm (N, 2, 2).

    Also whether each is still seen the same way (N,).
    """
    ways, moved, step = trace(scene, pixel).rays["key"], pixel, to_mm - from_mm
    for _ in range(NEWTON):
        moved = moved + (axes_px @ step[:, :, None])[:, :, 0]
        rays = trace(scene, moved)
        step = to_mm - rays.plane_mm
    off_px = np.linalg.norm((axes_px @ step[:, :, None])[:, :, 0], axis=1)
    return moved, np.asarray((rays.rays["key"] == ways) & (off_px < SETTLED_PX))  # False for NaN


def _windows(
    scene: Scene, pixel: NDArray[np.float64], axes_px: NDArray[np.float64], board: Chessboard
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Half lengths (N,) of windows [squares] in which the view is straight but for an even curvature.

    Then what the rest may do to corners (N, 2) [px].
    """
    twist, uneven, middle = np.zeros(len(pixel)), np.zeros_like(pixel), trace(scene, pixel).plane_mm
    for axis in range(2):
        reach = PREDICTED_WINDOW * axes_px[:, :, axis]
        ahead, behind = trace(scene, pixel + reach).plane_mm, trace(scene, pixel - reach).plane_mm
        odd = 0.5 * board.along_mm(ahead - behind) / board.square_mm - PREDICTED_WINDOW * np.eye(2)[axis]
        in_px = np.linalg.norm((axes_px @ odd[:, :, None])[:, :, 0], axis=1)
        twist = np.maximum(twist, np.nan_to_num(in_px, nan=np.inf))
        bend = board.along_mm(0.5 * (ahead + behind) - middle)
        uneven += (axes_px @ bend[:, :, None])[:, :, 0] / board.square_mm
    shorter = np.minimum(1.0, np.cbrt(TWIST_PX / np.maximum(twist, 1e-12)))
    half_px = np.fmax(
        PREDICTED_WINDOW * shorter * np.linalg.norm(axes_px, axis=1).mean(axis=1), MIN_HALF_WINDOW_PX
    )
    pull = PULLED * np.minimum(twist, TWIST_PX) * shorter**2 / half_px
    return np.asarray(PREDICTED_WINDOW * shorter), pull[:, None] * np.nan_to_num(uneven)


def _lattice(scene: Scene, board: Chessboard) -> PlaneGrid:
    """Raster whose nodes are the lattice corners around the bare view, with corner (0, 0) in its middle.

    Of staggered rows every second node is a corner.
    """
    width, height = scene.camera.sensor_px
    border = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
    rays = scene.camera.directions(border)
    x, y, z = scene.camera.position_mm
    reach = np.abs(np.array([x, y]) - z * rays[:, :2] / rays[:, 2:]).max()
    a = float(board.sides_mm.mean()) * (np.sqrt(0.5) if board.staggered else 1.0)
    half = int(np.ceil(TARGET_WIDENING * reach / a))
    return PlaneGrid((-half * a, half * a), a, (2 * half + 1, 2 * half + 1))
