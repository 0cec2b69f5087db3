"""Corners measured in frames: from the bare target by search, behind glass from the present scene's prediction.

A bare target seen through a tube is measured again from the prediction: beside the tube's edge a search takes
corners that the wall has cut or bent for whole ones, and a fit to them ends beside the truth, well within noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.errors import TargetNotFound
from correction.fit.seen.bent_view import LEFT_BY_RIM, window_bias
from correction.fit.seen.dot_rims import off_centre
from correction.fit.seen.prediction import Expected, expect, in_target_frame, measure, on_each_level
from correction.fit.seen.smear import (
    SMEAR_SIGMA,
    UNEVEN,
    UNEVEN_COLOURS,
    Dispersion,
    colour_steps,
    join_smears,
    pupil_smear,
    smear_by_colour,
    smear_of,
    uneven_blur,
)
from correction.fit.seen.smear_test import EdgeSpread
from correction.fit.solve.solver import Corners
from correction.target import Chessboard
from correction.target.board_search import Predict, track_board
from correction.target.corners import CornerFit, CornerReason
from correction.target.lattice_fit import BoardDetection
from ground.short_repr import short_repr
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose

NOT_ASKED = (CornerReason.EDGE, CornerReason.MASKED, CornerReason.SMALL)  # no window, so nothing is lost
MIN_REGION_CORNERS = 20  # corners from which a region's sigma can be judged
SHADOWED = 2.0  # times as uncertain as dots of the face: shadows cut those of the lower level
FLOOR_PX = 0.01  # no corner is better than this: lens, print and model are not


@short_repr
@dataclass(frozen=True)
class TargetFrame:
    """A frame of the target.

    Parameters
    ----------
    name : str
        Said in messages.
    image : (H, W) uint8, uint16 or float
        The raw frame.
    glass : bool
        Whether the glass stood before the camera.
    height_mm : float
        z of the target, by its stage.
    pose : str
        Name of a pose by hand, which no stage measured; empty on the stage.
    """

    name: str
    image: NDArray[Any]
    glass: bool
    height_mm: float = 0.0
    pose: str = ""


@dataclass(frozen=True)
class LostCorners:
    """Corners, M of them, that the scene shows in a frame and that are not found in their windows.

    Parameters
    ----------
    index : (M, 2) int64
        Corner of the board.
    pixel : (M, 2) float64
        Where it was expected.
    branch_name : (M,) str
        Spheres crossed, joined by " > "; empty for the direct view.
    rim_px : (M,) float64
        Distance to the border of the branch.
    axes_px : (M, 2, 2) float64
        Columns: displacement in the image by one square along the board's +x and +y.
    """

    index: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    pixel: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    branch_name: NDArray[np.str_] = field(default_factory=lambda: np.zeros(0, "<U1"))
    rim_px: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    axes_px: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2, 2)))


@dataclass(frozen=True)
class MeasuredFrame:
    """Corners of one frame, N valid ones, with what was expected and not found.

    Parameters
    ----------
    name : str
        Of the frame.
    corners : Corners
        For the solver.
    index : (N, 2) int64
        Corner of the board.
    axes_px : (N, 2, 2) float64
        Columns: displacement in the image by one square along the board's +x and +y.
    branch_name : (N,) str
        Spheres crossed, joined by " > "; empty for the direct view.
    rim_px : (N,) float64
        Distance to the border of the branch; infinite on the bare target.
    sigma_px : (N, 2) float64
        Standard deviation from the window.
    expected : dict
        Name of a branch -> corners behind glass that the scene shows.
    refused : dict
        Reason -> corners that could not be measured.
    lost : LostCorners
        Those of them that the scene shows.
    spread : EdgeSpread
        How wide edges are drawn.
    known_smooth_px : (N,) float64
        Standard deviation of what is smooth in the errors and known: what smears corners is not known to better.
    smear_px : (N, 2, 2) float64
        What colours, and what the pupil, may do to corners beyond what is taken off, all alike, one standard
        deviation.
    bent_px : (N, 2) float64
        The same of the bending of the view, alike on every way (`bent_view`).
    origin_basis : str
        What the origin of the bare target rests on, if no mark shows it.
    """

    name: str
    corners: Corners
    index: NDArray[np.int64]
    axes_px: NDArray[np.float64]
    branch_name: NDArray[np.str_]
    rim_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    expected: dict[str, int]
    refused: dict[str, int]
    lost: LostCorners = field(default_factory=LostCorners)
    spread: EdgeSpread = field(default_factory=EdgeSpread)
    known_smooth_px: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    smear_px: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2, 2)))
    bent_px: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    origin_basis: str = ""

    def __post_init__(self) -> None:
        for name, width in (("known_smooth_px", ()), ("smear_px", (2, 2)), ("bent_px", (2,))):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.zeros((len(self), *width)))

    def __len__(self) -> int:
        return len(self.index)

    @property
    def behind(self) -> NDArray[np.bool_]:
        """Corners seen through glass (N,)."""
        return np.asarray(self.branch_name != "")

    @property
    def in_shadow(self) -> NDArray[np.bool_]:
        """Dots (N,) of a level of a plate that shadows make much less certain than those of the other one."""
        deep, spread = self.corners.depth_mm != 0.0, np.linalg.norm(self.sigma_px, axis=1)
        if not deep.any() or deep.all():
            return np.zeros(len(self), bool)
        lower, other = np.median(spread[deep]), np.median(spread[~deep])
        return np.asarray(deep & (lower > SHADOWED * other) | ~deep & (other > SHADOWED * lower))

    def take(self, which: NDArray[np.bool_]) -> "MeasuredFrame":
        """Return the frame with the chosen corners only."""
        return replace(
            self,
            corners=self.corners.take(which),
            index=self.index[which],
            axes_px=self.axes_px[which],
            branch_name=self.branch_name[which],
            rim_px=self.rim_px[which],
            sigma_px=self.sigma_px[which],
            spread=self.spread.take(which),
            known_smooth_px=self.known_smooth_px[which],
            smear_px=self.smear_px[which],
            bent_px=self.bent_px[which],
        )


def whitening(sigma_px: NDArray[np.float64], scale: NDArray[np.float64] | float = 1.0) -> NDArray[np.float64]:
    """W (N, 2, 2) of corners with standard deviations (N, 2), floored and scaled by (N,) or a number."""
    spread = np.hypot(sigma_px, FLOOR_PX) * np.reshape(scale, (-1, 1))
    return np.asarray(np.eye(2) / spread[:, :, None])


def region_factors(
    behind: Sequence[NDArray[np.bool_]], values: Sequence[NDArray[np.float64]]
) -> dict[bool, float]:
    """By what sigmas beside glass and behind it are to be multiplied, that the median residual is what they say.

    Parameters
    ----------
    behind : sequence of (N,) bool
        Corners seen through glass, frame by frame.
    values : sequence of (N, 2) float64
        Their residuals in sigmas; by Rayleigh the median of the squares of their lengths is 2 ln 2.
    """
    square = np.concatenate([(value**2).sum(axis=1) for value in values])
    region = np.concatenate(list(behind))
    factors = {}
    for glass in (False, True):
        chosen = square[(region == glass) & np.isfinite(square)]
        known = len(chosen) > MIN_REGION_CORNERS
        factors[glass] = float(np.sqrt(np.median(chosen) / (2.0 * np.log(2.0)))) if known else 1.0
    return factors


def by_region(behind: NDArray[np.bool_], factors: dict[bool, float]) -> NDArray[np.float64]:
    """Factors (N,) of corners, by whether they are seen through glass (N,)."""
    return np.where(behind, factors[True], factors[False])


def bare_frame(
    frame: TargetFrame, board: Chessboard, predict: Predict, height_number: int, reach: float | None = None
) -> tuple[MeasuredFrame, Chessboard]:
    """Find the board without glass, with a prediction of its view, off by up to `reach` squares if that is given.

    Returns
    -------
    MeasuredFrame
    Chessboard
        The same board, with what the frame shows of its shades.

    Raises
    ------
    TargetNotFound
        With the frame's name in front.
    """
    try:
        found = track_board(frame.image, board, predict, reach=reach)
    except TargetNotFound as error:
        raise TargetNotFound(f"{frame.name}: {error}") from None
    return as_measured(frame.name, found, height_number), found.board


def as_measured(name: str, found: BoardDetection, height_number: int) -> MeasuredFrame:
    """Return marks that were found without glass, or beside it, for the fit."""
    count, depth = len(found), found.board.depth_mm(found.index)
    corners = Corners(height_number, False, found.position_px, found.plane_mm, whitening(found.sigma_px), depth)
    nothing = np.zeros_like(found.blurs_px)
    return MeasuredFrame(
        name,
        corners,
        found.index,
        found.axes_px,
        np.full(count, ""),
        np.full(count, np.inf),
        found.sigma_px,
        {},
        dict(found.refused),
        spread=EdgeSpread(found.blurs_px**2, nothing, nothing),
        origin_basis=found.origin_basis,
    )


def bare_frame_through_walls(
    frame: TargetFrame, board: Chessboard, scene: Scene, pose: TargetPose, height_number: int
) -> MeasuredFrame:
    """Measure the bare target again where a scene without balls shows it, clear of the edges of its walls."""
    expected = expect(scene, pose, board)
    fit = measure(frame.image, expected, board)
    nothing = np.zeros_like(fit.blurs_px)
    spread = EdgeSpread(fit.blurs_px**2, nothing, nothing)
    found = _to_measured_frame(frame.name, board, expected, fit, spread, height_number)
    nothing_behind = np.full(len(found), "")
    corners = replace(found.corners, glass=False)
    return replace(found, corners=corners, branch_name=nothing_behind, expected={}, lost=LostCorners())


def centre_dots(frame: MeasuredFrame, board: Chessboard, scene: Scene, pose: TargetPose) -> MeasuredFrame:
    """Take the middles of pictures of dots of the bare target back to their centres, by a scene without balls."""
    off, depth = np.full((len(frame), 2), np.nan), board.depth_mm(frame.index)
    for depth_mm in board.depths_mm:
        own, seen = depth == depth_mm, in_target_frame(scene, pose.behind(depth_mm))
        off[own] = off_centre(seen, board, frame.index[own], frame.corners.pixel[own], frame.axes_px[own])
    whole = np.isfinite(off[:, 0])
    frame, off = frame.take(whole), off[whole]
    corners = replace(frame.corners, pixel=frame.corners.pixel - off)
    return replace(frame, corners=corners, bent_px=LEFT_BY_RIM * off)


def glass_frame(
    frame: TargetFrame,
    board: Chessboard,
    scene: Scene,
    pose: TargetPose,
    height_number: int,
    only_behind: bool,
    dispersion: Dispersion | None = None,
) -> MeasuredFrame:
    """Measure the corners that a scene predicts in a frame with glass, and take off what colours do to them."""
    expected = expect(scene, pose, board)
    if only_behind:
        expected = expected.take(expected.branch != 0)
    fit = measure(frame.image, expected, board)
    spread = EdgeSpread(fit.blurs_px**2, np.zeros_like(fit.blurs_px), np.zeros_like(fit.blurs_px))
    levels = list(on_each_level(expected, pose, board))
    aside, bent = (
        np.concatenate(parts)
        for parts in zip(
            *(window_bias(scene, on, board, expected.take(own), fit.blur_px[own]) for on, own in levels),
            strict=True,
        )
    )
    fit = replace(fit, position_px=fit.position_px - aside)
    smooth, alike = np.zeros(len(expected.pixel)), np.zeros((len(expected.pixel), 2, 2))
    if dispersion is not None:
        of_levels = [colour_steps(scene, on, dispersion, expected.pixel[own]) for on, own in levels]
        parts = (
            np.concatenate([steps for steps, _ in of_levels], axis=1),
            np.concatenate([share for _, share in of_levels], axis=1),
        )
        if board.dots is None:
            smear = smear_by_colour(*parts, expected.axes_px, expected.window, fit.blurs_px)
        else:
            smear = smear_of(*parts, expected.axes_px, fit.blur_px)
        alike[:, 0], smooth = UNEVEN_COLOURS * smear.shift_px, SMEAR_SIGMA * smear.width_px
        spread = EdgeSpread(spread.variance_px2 - smear.edges_px2, spread.by_pupil_px2, smear.edges_px2)
        fit = replace(fit, position_px=fit.position_px - smear.shift_px)
    if scene.camera.pupil is not None:
        smear = join_smears(
            [
                pupil_smear(
                    scene, scene.camera.pupil, on, expected.pixel[own], expected.axes_px[own], fit.blur_px[own]
                )
                for on, own in levels
            ]
        )
        uneven = uneven_blur(expected.index, expected.branch, expected.axes_px, smear)
        alike[:, 1] = UNEVEN * smear.shift_px + uneven
        spread = EdgeSpread(spread.variance_px2 - smear.edges_px2, smear.edges_px2, spread.by_light_px2)
        fit = replace(fit, position_px=fit.position_px - smear.shift_px)
    smooth = np.hypot(smooth, np.linalg.norm(alike, axis=(1, 2)))
    fit = replace(fit, sigma_px=np.hypot(fit.sigma_px, smooth[:, None]))
    measured = _to_measured_frame(frame.name, board, expected, fit, spread, height_number)
    return replace(measured, known_smooth_px=smooth[fit.valid], smear_px=alike[fit.valid], bent_px=bent[fit.valid])


def _windows_in_frame(expected: Expected) -> NDArray[np.bool_]:
    """Corners (N,) whose windows the frame holds whole: in the rest of one a corner may be missed."""
    reach_px = expected.window[:, None] * np.abs(expected.axes_px).sum(axis=2)
    last_px = np.array(expected.usable.shape[::-1]) - 1.0
    return np.asarray(((expected.pixel >= reach_px) & (expected.pixel <= last_px - reach_px)).all(axis=1))


def _to_measured_frame(
    name: str, board: Chessboard, expected: Expected, fit: CornerFit, spread: EdgeSpread, height_number: int
) -> MeasuredFrame:
    branch_names = expected.ways
    names, counts = np.unique(branch_names[branch_names != ""], return_counts=True)
    valid, lost = fit.valid, ~fit.valid & ~np.isin(fit.reason, NOT_ASKED) & _windows_in_frame(expected)
    node, depth = board.corner_mm(expected.index[valid]), board.depth_mm(expected.index[valid])
    corners = Corners(height_number, True, fit.position_px[valid], node, whitening(fit.sigma_px[valid]), depth)
    reasons = {reason: count for reason, count in fit.counts().items() if reason != "OK"}
    return MeasuredFrame(
        name,
        corners,
        expected.index[valid],
        expected.axes_px[valid],
        branch_names[valid],
        expected.rim_px[valid],
        fit.sigma_px[valid],
        dict(zip(names.tolist(), counts.tolist(), strict=True)),
        reasons,
        LostCorners(
            expected.index[lost],
            expected.pixel[lost],
            branch_names[lost],
            expected.rim_px[lost],
            expected.axes_px[lost],
        ),
        spread.take(valid),
    )
