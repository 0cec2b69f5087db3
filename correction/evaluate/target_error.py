"""Position errors of target points, in both senses of Table 2 of Martins et al. (2018).

1. computer-generated against acquired: where a scene says a corner is, and where the raw frame shows it;
2. corrected against the regular grid: where the corner stands in the corrected frame, and where it should.

The paper aligned its camera with the bare target and believed the stages for the glass; "nominal" here
means the same: fitted camera, nominal glass.  Behind glass, "at a rim" is within RIM_PX of the border of a
branch, "off the rims" the rest.

In a perfectly corrected frame of the target, corner (i, j) stands at ((i a - x0), (y0 - j a)) / pitch.  Every
corner whose window lies in recovered nodes is measured, and its distance from there is an error of the
correction plus the noise of the measurement.  Corners whose window sees more than one branch are not
counted: half of such a window belongs to another picture of the plane.

Where two corrections of one frame differ in nothing that a corner's window can reach, as beside the glass of two
scenes with the same camera, the corner is measured once.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.seen.prediction import expect
from correction.fitted.prepared import prepare
from correction.maps.corrector import Corrector
from correction.target import Chessboard
from correction.target.corners import ARM_LENGTH, CornerSearch
from correction.target.marks import refine_marks
from ground.short_repr import short_repr
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose

if TYPE_CHECKING:  # who corrects a frame does not wait for all that makes a fit
    from correction.fit.judge.result import FittedCorners, SceneFit

# A magnified view comes out so sharp that an edge along a pixel row leaves no pixel to measure it by; a
# symmetric blur moves nothing and gives the edge a width again.
SOFTEN_PX, SOFTEN_REACH_PX = 0.6, 2
MAX_SHIFT = 0.45  # largest move of a window from its start in squares
REGIONS = ("all", "seen directly", "behind glass")
RIM_PX = 40.0
FARTHEST_PX = 60.0  # a corner predicted farther away than this counts as not predicted


@dataclass(frozen=True)
class Region:
    """Errors of the corners of one region.

    Parameters
    ----------
    expected : int
        Corners whose window is recovered.
    found : int
        Corners measured.
    bias_px, rms_px : (float, float)
        Mean and root mean square (bias included) per axis, u and v, in corrected pixels.
    largest_px : float
        Largest distance.
    """

    expected: int
    found: int
    bias_px: tuple[float, float]
    rms_px: tuple[float, float]
    largest_px: float


@short_repr
@dataclass(frozen=True)
class TargetError:
    """Errors by region; `corners` and `errors_px` keep the single corners (N, 2) for pictures."""

    regions: Mapping[str, Region]
    corners_px: NDArray[np.float64] = field(repr=False)
    errors_px: NDArray[np.float64] = field(repr=False)

    def rows(self) -> list[tuple[str, ...]]:
        """Table rows: region, corners found of expected, bias, rms, largest."""
        return [
            (
                name,
                f"{region.found} of {region.expected}",
                f"{region.bias_px[0]:+.3f}, {region.bias_px[1]:+.3f}",
                f"{region.rms_px[0]:.3f}, {region.rms_px[1]:.3f}",
                f"{region.largest_px:.2f}",
            )
            for name, region in self.regions.items()
        ]

    def to_dict(self) -> dict[str, Any]:
        """JSON-able figures; regions where nothing was found have no numbers."""
        return {
            name: vars(region) if region.found else {"expected": region.expected, "found": 0}
            for name, region in self.regions.items()
        }


@dataclass(frozen=True)
class _Measured:
    """A softened frame (H, W), where it may be used, and the corners (i, j) in it: place, whether it is valid."""

    soft: NDArray[Any]
    usable: NDArray[np.bool_]
    corners: dict[tuple[int, int], tuple[NDArray[np.float64], bool]]

    def alike(self, other: "_Measured", reach_px: int) -> NDArray[np.bool_]:
        """Pixels (H, W) that look the same in both frames as far as `reach_px` to all sides."""
        import cv2

        if self.soft.shape != other.soft.shape:
            return np.zeros(self.soft.shape, bool)
        differ = ((self.soft != other.soft) | (self.usable != other.usable)).astype(np.uint8)
        return np.asarray(cv2.dilate(differ, np.ones((2 * reach_px + 1,) * 2, np.uint8)) == 0)


def target_error(corrected: NDArray[np.float32], corrector: Corrector, board: Chessboard) -> TargetError:
    """Measure a corrected frame of the target, as `target_errors` does several."""
    return target_errors([(corrected, corrector)], board)[0]


def target_errors(frames: Iterable[tuple[NDArray[np.float32], Corrector]], board: Chessboard) -> list[TargetError]:
    """Measure corrections of one frame of the target.

    Parameters
    ----------
    frames : iterable of (ndarray of float32, Corrector)
        What each corrector returned; it tells grid, mask and branches.
    board : Chessboard
        The target, at the investigation plane.

    Returns
    -------
    list of TargetError
        Figures for all corners, those seen directly, and those behind glass.
    """
    errors, before = list[TargetError](), None
    for corrected, corrector in frames:
        error, before = _error_of(corrected, corrector, board, before)
        errors.append(error)
    return errors


def _error_of(
    corrected: NDArray[np.float32], corrector: Corrector, board: Chessboard, before: _Measured | None
) -> tuple[TargetError, _Measured]:
    """Measure one, with what was measured in the one before."""
    import cv2

    grid = corrector.map.grid
    whole = corrector.recovered & (_same_branch(corrector.map.branch[0]) > 0)
    reach = np.ones((2 * SOFTEN_REACH_PX + 1,) * 2, np.uint8)
    usable = cv2.erode(whole.astype(np.uint8), reach, borderValue=0) > 0
    soft = cv2.GaussianBlur(np.nan_to_num(corrected), (2 * SOFTEN_REACH_PX + 1,) * 2, SOFTEN_PX)
    outline = grid.to_mm(np.array([[0.0, 0.0], [grid.shape[1] - 1.0, grid.shape[0] - 1.0]]))
    index = board.corners_within(outline)
    index = index[board.depth_mm(index) == 0.0]  # the map is that of the plane
    expected = grid.to_px(board.corner_mm(index))
    across, up = board.sides_mm / grid.pitch_mm
    square = max(across, up)
    window = np.ones((2 * int(0.3 * square) + 1,) * 2, np.uint8)
    inner = cv2.erode(whole.astype(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    nearest = np.clip(np.rint(expected).astype(int), 0, np.array(grid.shape[::-1]) - 1)
    seen = inner[nearest[:, 1], nearest[:, 0]] > 0
    expected, nearest = expected[seen], nearest[seen]
    if board.is_plain and board.dots is None:
        board = _as_lit(board, soft, index[seen], expected, square)
    now = _Measured(soft, usable, {})
    nodes = [(int(i), int(j)) for i, j in index[seen]]
    known = np.zeros(len(nodes), bool)
    if before is not None:
        alike = now.alike(before, int(np.ceil((ARM_LENGTH + MAX_SHIFT) * square)) + 1)
        known = np.array([node in before.corners for node in nodes], bool) & alike[nearest[:, 1], nearest[:, 0]]
    position, valid = np.full((len(nodes), 2), np.nan), np.zeros(len(nodes), bool)
    if before is not None:
        for n in np.flatnonzero(known):
            position[n], valid[n] = before.corners[nodes[n]]
    fit = refine_marks(
        soft,
        board,
        index[seen][~known],
        expected[~known],
        np.array([[across, 0.0], [0.0, -up]]) @ board.steps,
        usable,
        search=CornerSearch(board.arm, max_shift=MAX_SHIFT),
    )
    position[~known], valid[~known] = fit.position_px, fit.valid
    now.corners.update(zip(nodes, zip(position, valid.tolist(), strict=True), strict=True))
    errors = position - expected
    glass = corrector.map.branch[0][nearest[:, 1], nearest[:, 0]] != 0
    chosen = dict(zip(REGIONS, (np.ones(len(glass), bool), ~glass, glass), strict=True))
    regions = {name: _region(errors[which], valid[which]) for name, which in chosen.items() if which.any()}
    return TargetError(regions, expected[valid], errors[valid]), now


def _as_lit(
    board: Chessboard,
    soft: NDArray[Any],
    index: NDArray[np.int64],
    expected: NDArray[np.float64],
    square: float,
) -> Chessboard:
    """Return a plain board with those of its squares bright that are: its file does not say which."""
    u, v = np.rint(expected + 0.25 * square * np.array((1.0, -1.0))).astype(int).T  # in the square up and right
    inside = (v >= 0) & (u < soft.shape[1])
    value, odd = soft[v[inside], u[inside]], index[inside].sum(axis=1) % 2 == 1
    if not odd.any() or odd.all():
        return board
    return replace(board, odd_bright=bool(np.median(value[odd]) > np.median(value[~odd])))


def _same_branch(branch: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """1 where a node and its neighbours show the same branch."""
    import cv2

    low = cv2.erode(branch, np.ones((3, 3), np.uint8))
    high = cv2.dilate(branch, np.ones((3, 3), np.uint8))
    return np.asarray(low == high, dtype=np.uint8)


def _region(errors: NDArray[np.float64], valid: NDArray[np.bool_]) -> Region:
    good = errors[valid]
    if not len(good):
        nan = (float("nan"), float("nan"))
        return Region(len(errors), 0, nan, nan, float("nan"))
    bias, rms = good.mean(axis=0), np.sqrt((good**2).mean(axis=0))
    largest = float(np.hypot(good[:, 0], good[:, 1]).max())
    return Region(
        len(errors), len(good), (float(bias[0]), float(bias[1])), (float(rms[0]), float(rms[1])), largest
    )


@dataclass(frozen=True)
class RegionErrors:
    """Computer-generated minus acquired, one region.

    Parameters
    ----------
    region : str
    corners : int
        Corners compared.
    bias_px, rms_px : (2,) float64
        Per axis u, v in raw px; rms holds the bias.
    largest_px : float
        Largest distance.
    """

    region: str
    corners: int
    bias_px: NDArray[np.float64]
    rms_px: NDArray[np.float64]
    largest_px: float


def aligned(fit: "SceneFit") -> Scene:
    """Return the nominal glass before the fitted camera."""
    return fit.unknowns.scene.with_camera(fit.scene.camera)


def computed_against_acquired(
    scene: Scene, corners: "FittedCorners", frame: int, board: Chessboard
) -> tuple[list[RegionErrors], NDArray[np.float64], NDArray[np.float64]]:
    """Sense 1 for one frame at z = 0.

    Returns
    -------
    regions : list of RegionErrors
    pixel, error_px : (N, 2) float64
        Acquired pixels and computer-generated minus acquired.
    """
    chosen = np.flatnonzero((corners.frame == frame) & corners.inlier)
    expected = expect(scene, TargetPose(), board)
    pairs = []
    for behind in (False, True):
        mine = chosen[corners.behind[chosen] == behind]
        theirs = np.flatnonzero((expected.branch != 0) == behind)
        if not (len(mine) and len(theirs)):
            continue
        # One lattice corner may be on several sheets: lift indices far apart, then take the nearest pixel.
        far = 4.0 * FARTHEST_PX
        tree = scipy.spatial.cKDTree(np.c_[expected.pixel[theirs], far * expected.index[theirs]])
        away, found = tree.query(np.c_[corners.pixel[mine], far * corners.index[mine]])
        near = away < FARTHEST_PX
        pairs.append((mine[near], theirs[found[near]]))
    mine, theirs = (np.concatenate([pair[side] for pair in pairs]) for side in (0, 1))
    error = expected.pixel[theirs] - corners.pixel[mine]
    behind, rim = corners.behind[mine], corners.rim_px[mine] < RIM_PX
    regions = {
        "all": behind | True, "seen directly": ~behind,
        "behind glass, off the rims": behind & ~rim, "behind glass, at a rim": behind & rim,
    }  # fmt: skip
    figures = [_figures(name, error[which]) for name, which in regions.items() if which.any()]
    return figures, corners.pixel[mine], error


def corrected_against_grid(
    scenes: Sequence[Scene], image: NDArray[Any], board: Chessboard
) -> tuple[list[TargetError], tuple[NDArray[np.float32], Corrector]]:
    """Sense 2: correct a frame of the target at z = 0 with each scene and measure it.

    Returns
    -------
    list of TargetError
        One a scene.
    (ndarray of float32, Corrector)
        The frame as the last scene corrects it.
    """
    last: list[tuple[NDArray[np.float32], Corrector]] = []

    def by_scene() -> Iterator[tuple[NDArray[np.float32], Corrector]]:
        for scene in scenes:
            corrector = prepare(scene).corrector
            last[:] = [(corrector(image), corrector)]
            yield last[0]

    return target_errors(by_scene(), board), last[0]


def _figures(region: str, error: NDArray[np.float64]) -> RegionErrors:
    largest = float(np.linalg.norm(error, axis=1).max())
    return RegionErrors(region, len(error), error.mean(axis=0), np.sqrt((error**2).mean(axis=0)), largest)
