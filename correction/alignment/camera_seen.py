"""Position of the camera, from the board that it sees beside the glass in one frame.

Beside the glass the board is seen directly. Its saddles are grown to patches of lattice there, placed by where
the nominal camera would see them (the discs of the origin mostly stand behind the glass); corners are fitted, and
to them the pose of the camera, with what the scene's `fit` section lets it change. (Saddles alone are pulled
towards pixels by hundredths of one, the same way over wide parts of a lattice whose squares are nearly whole
pixels: that looks like a camera that stands 60 um aside and turns back.) A lattice looks the same two squares
further along a diagonal: the nominal view must be good to half a square, or a bare frame has to say where the
origin is.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.alignment.rim import rim_of
from correction.errors import TargetNotFound
from correction.fit.solve.unknowns import unknowns_of
from correction.target import Chessboard
from correction.target.board_count import place_by_count
from correction.target.board_origin import place_by_prediction
from correction.target.board_search import corners_in_view
from correction.target.corners import CornerSearch
from correction.target.lattice_growth import Patch
from correction.target.marks import find_marks, grow_marks, refine_marks
from tracer.camera import Camera
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene

CORNER_PX = 0.05  # standard deviation of a corner, most of it the same for neighbours
BOARD_CORNERS = 500  # corners
# Squares, half width of what is fitted of their edges: wider ones hold little but bright and dark
EDGE_ARM = 0.1
VOTING = 200  # corners of a patch that say where in the board it lies
MIN_BOARD_CORNERS = 40
FRAME_ROUNDS = 6
SIGMA_STEP = 1e-4  # of the sigma of a number, for derivatives
LEAST_SPREAD = 0.25  # of the frame that the corners must span, or the pose is a guess
AROUND = 1.1  # of the radius of a ball and the reach: nothing in there is taken for the board


@dataclass(frozen=True)
class CameraSeen:
    """A camera by the board that it sees beside the glass.

    Parameters
    ----------
    camera : Camera
        As fitted.
    off_mm, sigma_mm : (3,) float64
        Of its pinhole, from its expected place.
    corners : int
        That it was fitted to.
    rms_px : float
        Of them, per coordinate.
    index : (N, 2) int64
        All corners that were found.
    board, board_mm
        What is seen, and where it hangs.
    levels : (float, float)
        Intensity of dark and bright squares.
    """

    camera: Camera
    off_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    corners: int
    rms_px: float
    index: NDArray[np.int64]
    board: Chessboard
    board_mm: NDArray[np.float64]
    levels: tuple[float, float]

    def shade(self, pixel: NDArray[np.float64]) -> NDArray[np.float64]:
        """Brightness of the directly seen board at pixels (..., 2): 1 bright, 0 dark."""
        return self.board.shade(self._on_board(pixel))

    def blur(self, pixel: NDArray[np.float64], blur_px: float) -> NDArray[np.float64]:
        """Return the same with blur: means over nine points, as far apart as pixels of the middle of the frame."""
        nodes, weights = (-blur_px * 3.0**0.5, 0.0, blur_px * 3.0**0.5), (1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0)
        middle = np.array(self.camera.sensor_px) / 2.0
        corner, right, down = self._on_board(middle + np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]))
        place = self._on_board(pixel)
        shade = np.zeros(place.shape[:-1])
        for du, wu in zip(nodes, weights, strict=True):
            for dv, wv in zip(nodes, weights, strict=True):
                shade += wu * wv * self.board.shade(place + du * (right - corner) + dv * (down - corner))
        return shade

    def _on_board(self, pixel: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 2) of the board that are seen directly at pixels (..., 2) [mm]."""
        eye, ray = np.array(self.camera.position_mm), self.camera.directions(pixel)
        reach = (self.board_mm[2] - eye[2]) / ray[..., 2:]
        return np.asarray((eye + reach * ray - self.board_mm)[..., :2])


def find_camera(
    frame: NDArray[Any],
    scene: Scene,
    board: Chessboard,
    board_mm: NDArray[np.float64],
    reach_mm: float,
    priors: FitTable | None = None,
) -> CameraSeen:
    """Find where the camera stands, from the board beside the glass.

    Parameters
    ----------
    frame : (H, W) uint8, uint16 or float
        What it sees.
    scene : Scene
        Camera and spheres where they are expected.
    board : Chessboard
        The target.
    board_mm : (3,) float64
        Where its origin stands in the world; it hangs upright.
    reach_mm : float
        How far sideways a sphere may be off.
    priors : FitTable, optional
        How well the camera is known.

    Raises
    ------
    TargetNotFound
        Too little of the board is seen beside the glass, or it lies elsewhere than expected.
    """
    if scene.camera.is_mirrored:
        raise TargetNotFound(
            "alignment reads no frames of a mirrored camera; set its ReverseX, or measure by hand"
        )
    nominal, beside = scene.camera, _beside(scene, reach_mm)
    patches = grow_marks(find_marks(frame, board, beside, square_px(nominal, board, board_mm)))

    def predict(place_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        return nominal.project(place_mm + board_mm)

    index, expected = corners_in_view(board, predict, nominal.shape)
    if board.is_plain and patches and len(index):  # which squares are bright is seen
        board, _ = place_by_count(frame, patches[0], board, (index, expected))
    indices, pixels, axes = [], [], []
    for patch in patches:
        if len(patch.index) < MIN_BOARD_CORNERS:
            break
        placing = place_by_prediction(_some_of(patch), index, expected, board)
        if placing is not None:
            indices.append(placing.board_index(patch.index))
            pixels.append(patch.position_px)
            axes.append(placing.board_axes(patch.axes_px))
    count = sum(map(len, indices))
    spread = np.ptp(np.concatenate(pixels), axis=0) / np.array(nominal.sensor_px) if pixels else np.zeros(2)
    if count < MIN_BOARD_CORNERS or spread.min() < LEAST_SPREAD:
        raise TargetNotFound(
            f"only {count} corners of the target are seen beside the glass where they are expected; bring light on"
            " the target, or correct the camera of the scene: its view must be good to half a square"
        )
    index = np.concatenate(indices)
    some = np.unique(np.linspace(0, count - 1, min(count, BOARD_CORNERS)).round().astype(np.intp))
    found = refine_marks(
        frame,
        board,
        index[some],
        np.concatenate(pixels)[some],
        np.concatenate(axes)[some],
        beside,
        search=CornerSearch(EDGE_ARM, start_error_px=0.5, max_shift=0.3),
    )
    if np.count_nonzero(found.valid) < MIN_BOARD_CORNERS:
        raise TargetNotFound(
            "the corners of the target beside the glass are too blurred to be measured; focus on it"
        )
    fitted = index[some][found.valid], found.position_px[found.valid]
    camera, board, sigma, rms = _fit_camera(scene, *fitted, board, board_mm, priors or FitTable())
    off = np.array(camera.position_mm) - np.array(nominal.position_mm)
    levels = _levels(frame, camera, index, board, board_mm)
    return CameraSeen(camera, off, sigma, len(index), rms, index, board, board_mm, levels)


def _some_of(patch: Patch) -> Patch:
    """Corners of a patch that are enough to say which of the board they are."""
    some = np.unique(np.linspace(0, len(patch.index) - 1, VOTING).round().astype(np.intp))
    return Patch(patch.index[some], patch.position_px[some], patch.axes_px[some], patch.sign[some])


def square_px(camera: Camera, board: Chessboard, board_mm: NDArray[np.float64]) -> float:
    """Side of a square in the frame."""
    return camera.focal_px * board.square_mm / abs(camera.position_mm[2] - float(board_mm[2]))


def _levels(
    frame: NDArray[Any], camera: Camera, index: NDArray[np.int64], board: Chessboard, board_mm: NDArray[np.float64]
) -> tuple[float, float]:
    """Intensity of dark and bright parts: the middles of squares beside some corners, or of dots and between."""
    marks = board.place_mm(index)
    asked = marks + np.append(0.5 * board.corner_mm((1, 1)), 0.0)
    asked = asked if board.dots is None else np.concatenate((marks, asked))
    middle = camera.project(asked + board_mm)
    at = np.rint(middle).astype(np.intp)
    inside = (at >= 0).all(axis=1) & (at < np.array(camera.sensor_px)).all(axis=1)
    value = frame[at[inside, 1], at[inside, 0]]
    bright = board.shade(asked[inside, :2]) > 0.5
    return float(np.median(value[~bright])), float(np.median(value[bright]))


def _fit_camera(
    scene: Scene,
    index: NDArray[np.int64],
    pixel: NDArray[np.float64],
    board: Chessboard,
    board_mm: NDArray[np.float64],
    priors: FitTable,
) -> tuple[Camera, Chessboard, NDArray[np.float64], float]:
    """Camera and print that fit corners, robustly; sigma (3,) of the camera's place, and rms of the corners [px].

    A printer stretches paper by half a percent or more, several pixels at the border of a frame, and then the
    board beside the glass would look as strange as within its rims.
    """
    unknowns = unknowns_of(scene, [0.0], priors, False).only(("camera.",))
    own, print_sigma = len(unknowns.names), np.array(board.print_sigma)

    def parts(x: NDArray[np.float64]) -> tuple[Camera, Chessboard]:
        return unknowns.camera(unknowns.full(x[:own])), board.stretch(1.0 + print_sigma * x[own:])

    def off_px(x: NDArray[np.float64]) -> NDArray[np.float64]:
        camera, paper = parts(x)
        return np.asarray(camera.project_ideal(paper.place_mm(index) + board_mm) - camera.ideal(pixel))

    def misses(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(off_px(x).ravel() / CORNER_PX)

    x = np.zeros(own + len(print_sigma))
    covariance: NDArray[np.float64] = np.eye(len(x))
    for _ in range(FRAME_ROUNDS):  # corners that are none weigh less and less
        left = misses(x)
        slopes = np.stack([(misses(x + step) - left) / SIGMA_STEP for step in SIGMA_STEP * np.eye(len(x))], axis=1)
        weight = 1.0 / np.sqrt(1.0 + left**2)
        normal = slopes.T @ (weight[:, None] * slopes) + np.eye(len(x))
        covariance = np.asarray(np.linalg.inv(normal), np.float64)
        x = x - covariance @ (slopes.T @ (weight * left) + x)
    rms = float(np.sqrt(np.median(np.sum(off_px(x) ** 2, axis=1)) / 1.386))
    off_by = (
        unknowns.columns[:3] @ covariance[:own, :own] @ unknowns.columns[:3].T * max(1.0, rms / CORNER_PX) ** 2
    )
    return *parts(x), np.asarray(np.sqrt(np.diag(off_by))), rms


def _beside(scene: Scene, reach_mm: float) -> NDArray[np.bool_]:
    """Pixels (H, W) that no sphere can hide, however far it may be off."""
    import cv2

    camera = scene.camera
    clear = np.ones(camera.shape, np.uint8)
    spheres = np.array([[*ball.centre_mm, AROUND * ball.radius_mm + reach_mm] for ball in scene.spheres])
    for number in range(len(spheres)):
        outline = rim_of(camera, spheres, number, 90).pixel
        if np.isfinite(outline).all():
            cv2.fillPoly(clear, [np.rint(outline).astype(np.int32)], 0)
    return clear.astype(np.bool_)
