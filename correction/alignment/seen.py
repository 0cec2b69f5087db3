"""Positions of a bench's camera and glass, from one frame, against the scene file.

With the board in sight the world is the board's: its lattice says where the camera stands, and the rims, seen from
there, where the spheres do. Without it the camera is taken to stand where the scene and its axes have it, and all
that is found is the glass before this camera.

All spheres are carried together, so their places o_k, each with its covariance C_k, are joined to one place of
the glass,

    glass = sum V_k o_k,        V_k = (sum W_k)^-1 W_k,        W_k = (C_k + SPHERE_PLACE_SIGMA_MM^2)^-1,

with the covariance sum V_k C_k V_k': it is where these spheres are, not where others of their kind might be. In
depth they err alike, because the light shifts the edges of all rims the same way, so many tell no more than one.

What the glass would need to be where the scene has it is its negative. Spheres that stand off by themselves are
named; no stage can cure them.

Beside the glass the board is seen directly. Its saddles are grown to patches of lattice there, placed by where
the nominal camera would see them (the discs of the origin mostly stand behind the glass); corners are fitted, and
to them the pose of the camera, with what the scene's `fit` section lets it change. (Saddles alone are pulled
towards pixels by hundredths of one, the same way over wide parts of a lattice whose squares are nearly whole
pixels: that looks like a camera that stands 60 um aside and turns back.) A lattice looks the same two squares
further along a diagonal: the nominal view must be good to half a square, or a bare frame has to say where the
origin is.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.alignment.rim import rim_of
from correction.alignment.spheres_seen import SphereSeen, find_spheres
from correction.errors import RimUnclear, TargetNotFound
from correction.fit.solve.unknowns import unknowns_of
from correction.target import Chessboard
from correction.target.board_count import place_by_count
from correction.target.board_origin import place_by_prediction
from correction.target.board_search import SATURATED, corners_in_view
from correction.target.corners import CornerSearch, fraction_saturated
from correction.target.lattice_growth import Patch, grow_patches
from correction.target.marks import find_marks, refine_marks
from piv.errors import FrameError
from piv.resampling.sample import checked_frame
from tracer.bodies import translate_by
from tracer.camera import Camera
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene

REACH_MM = 2.2  # sideways, how far glass may be off
SPHERE_PLACE_SIGMA_MM = 0.1  # standard deviation of a sphere's place in the glass
AT_CORNER = 0.2  # squares: a saddle so near to a corner of the lattice is that corner
FEWEST_HIDDEN = 12  # corners side by side that are hidden by something
AS_GLASS = 0.3  # of the area of the smallest sphere of the scene: something as large is glass, or as bad
OUTLINE = 1.06  # of a rim, within which corners are not expected
CORNER_PX = 0.05  # standard deviation of a corner, most of it the same for neighbours
BOARD_CORNERS = 500  # corners
EDGE_ARM = 0.1  # squares, half width of what is fitted of their edges: wider ones hold little but bright and dark
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
    patches = grow_patches(find_marks(frame, board, beside, square_px(nominal, board, board_mm)))

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


@dataclass(frozen=True)
class Arrangement:
    """Offsets of glass and camera from their places in the scene file, in the world [mm].

    Parameters
    ----------
    glass_mm : (3,) float64
        Of the glass as a whole.
    covariance_mm2 : (3, 3) float64
        Of it.
    spheres : tuple of SphereSeen
        Each sphere, from its place in the scene file.
    camera_mm, camera_sigma_mm : (3,) float64 or None
        Of the camera's pinhole; None where no board says it.
    remarks : tuple of str
        What else is to be seen, in sentences.
    """

    glass_mm: NDArray[np.float64]
    covariance_mm2: NDArray[np.float64]
    spheres: tuple[SphereSeen, ...]
    camera_mm: NDArray[np.float64] | None = None
    camera_sigma_mm: NDArray[np.float64] | None = None
    remarks: tuple[str, ...] = ()

    @property
    def sigma_mm(self) -> NDArray[np.float64]:
        """Standard deviation (3,) of the place of the glass."""
        return np.asarray(np.sqrt(np.diag(self.covariance_mm2)))


@dataclass(frozen=True)
class Expected:
    """Expected offsets of glass, camera and board from the scene file, before a frame is taken [mm], (3,) each."""

    glass_mm: NDArray[np.float64]
    camera_mm: NDArray[np.float64]
    board_mm: NDArray[np.float64]


def find_arrangement(
    frame: NDArray[Any],
    scene: Scene,
    board: Chessboard | None,
    expected: Expected,
    reach_mm: float = REACH_MM,
    priors: FitTable | None = None,
) -> Arrangement:
    """Find where glass and camera stand.

    Parameters
    ----------
    frame : (H, W) uint8, uint16 or float
        What the camera sees.
    scene : Scene
        Of the scene file.
    board : Chessboard or None
        The target, where it hangs.
    expected : Expected
        By the positions of the axes, and what was found before.
    reach_mm : float
        How far sideways the glass may be off that.
    priors : FitTable, optional
        How well camera and radii are known.

    Raises
    ------
    TargetNotFound
        The board is not seen beside the glass.
    RimNotFound, RimUnclear
        The frame does not say where the spheres are; or more stands there than the scene names.
    FrameError
        It is no frame of this camera, holds NaN, or is saturated.
    """
    priors, frame = priors or FitTable(), usable(frame, scene.camera)
    there = at_places(scene, expected)
    view = None if board is None else find_camera(frame, there, board, expected.board_mm, reach_mm, priors)
    camera = there.camera if view is None else view.camera
    found = find_spheres(frame, there, camera, reach_mm, priors, view)
    if view is not None:
        found = tuple(
            _with_camera(one, ball.centre_mm, view) for one, ball in zip(found, there.spheres, strict=True)
        )
    found = tuple(replace(one, off_mm=one.off_mm + expected.glass_mm) for one in found)
    glass, covariance = _combine_spheres(found)
    remarks = tuple(_own_places(found))
    if view is None:
        return Arrangement(glass, covariance, found, remarks=remarks)
    remarks += _find_unlisted(frame, scene, camera, glass, view)
    return Arrangement(glass, covariance, found, view.off_mm + expected.camera_mm, view.sigma_mm, remarks)


def usable(frame: NDArray[Any], camera: Camera) -> NDArray[Any]:
    """Return a frame whose edges stand where they were seen.

    Raises
    ------
    FrameError
        It is of another size, holds NaN, or more of it is saturated than does no harm.
    """
    full = fraction_saturated(np.asarray(frame))
    frame = checked_frame(frame)
    if frame.shape != camera.shape:
        raise FrameError(
            f"the frame has shape {frame.shape}, the camera of the scene {camera.shape}; they must agree"
        )
    if frame.dtype == np.float32 and not np.isfinite(frame.sum(dtype=np.float64)):
        raise FrameError("the frame holds NaN or infinity; take another one")
    if full > SATURATED:
        raise FrameError(
            f"{100.0 * full:.0f} % of the pixels are saturated, which displaces every edge; expose shorter"
        )
    return frame


def at_places(scene: Scene, expected: Expected) -> Scene:
    """Return the scene with glass and camera moved; what the bench itself carries stays."""
    x, y, z = np.add(scene.camera.position_mm, expected.camera_mm).tolist()
    moves = {"glass": expected.glass_mm, "camera": expected.camera_mm}
    bodies = tuple(
        body.moved(translate_by(moves[body.carried])) if body.carried in moves else body for body in scene.bodies
    )
    return replace(scene, camera=replace(scene.camera, position_mm=(x, y, z)), bodies=bodies)


def _with_camera(one: SphereSeen, centre_mm: tuple[float, float, float], view: CameraSeen) -> SphereSeen:
    """Add what is unsure of the camera: as far as a sphere stands before the board, it moves with the camera.

    In depth it moves as far as the camera does where the print may be larger: the rim alone says how far off it is.
    """
    far = abs(view.camera.position_mm[2] - view.board_mm[2])
    lever = abs(centre_mm[2] - view.board_mm[2]) / far
    levers = np.array((lever, lever, 1.0 if any(view.board.scale_sigma) else lever))
    return replace(one, covariance_mm2=one.covariance_mm2 + np.diag((levers * view.sigma_mm) ** 2))


def _combine_spheres(found: tuple[SphereSeen, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place (3,) of the glass and its covariance, of the spheres that show a rim."""
    seen = [one for one in found if one.own_rim]
    own = SPHERE_PLACE_SIGMA_MM**2 * np.eye(3) if len(seen) > 1 else np.zeros((3, 3))
    weights = [np.linalg.inv(one.covariance_mm2 + own) for one in seen]
    all_of_them = np.linalg.inv(np.sum(weights, axis=0))
    shares = [all_of_them @ weight for weight in weights]
    place = np.sum([share @ one.off_mm for share, one in zip(shares, seen, strict=True)], axis=0)
    covariance = np.sum([v @ one.covariance_mm2 @ v.T for v, one in zip(shares, seen, strict=True)], axis=0)
    deep = float(sum(v[2, 2] * one.sigma_mm[2] for v, one in zip(shares, seen, strict=True)))
    alike = np.diag((1.0, 1.0, max(1.0, deep / float(np.sqrt(covariance[2, 2])))))
    return np.asarray(place), np.asarray(alike @ covariance @ alike)


def _own_places(found: tuple[SphereSeen, ...]) -> list[str]:
    """Name the spheres that stand off where the others do, and those out of sight."""
    said = []
    for one in found:
        others = [other.off_mm for other in found if other.own_rim and other is not one]
        if not one.own_rim:
            said.append(f"{one.name} shows no rim of its own and is taken to stand as the others do")
        if not one.own_rim or not others:
            continue
        x, y, _ = (one.off_mm - np.mean(others, axis=0)).tolist()
        if np.hypot(x, y) > 3.0 * np.hypot(*one.sigma_mm[:2]) + SPHERE_PLACE_SIGMA_MM:
            said.append(f"{one.name} stands ({1e3 * x:+.0f}, {1e3 * y:+.0f}) um beside the others in x, y")
    return said


def _find_unlisted(
    frame: NDArray[Any], scene: Scene, camera: Camera, glass_mm: NDArray[np.float64], view: CameraSeen
) -> tuple[str, ...]:
    """Look for something that hides the board beside the glass of the scene.

    Raises
    ------
    RimUnclear
        It is as large as glass.
    """
    import cv2

    def predict(place_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        return camera.project(place_mm + view.board_mm)

    index, pixel = corners_in_view(view.board, predict, camera.shape)
    outlines = np.zeros(camera.shape, np.uint8)
    areas = []
    for body in scene.bodies:
        start, end, radius = body.capsule
        for end_mm in np.linspace(np.array(start), np.array(end), 30 if start != end else 1):
            disc = np.array([[*(end_mm + glass_mm), OUTLINE * radius]])
            outline = rim_of(camera, disc, 0, 90).pixel
            if not np.isfinite(outline).all():
                continue
            cv2.fillPoly(outlines, [np.rint(outline).astype(np.int32)], 1)
            if body in scene.spheres:
                areas.append(float(cv2.contourArea(outline.astype(np.float32))))
    at = np.rint(pixel).astype(np.intp)
    beside = outlines[at[:, 1], at[:, 0]] == 0
    side_px = square_px(camera, view.board, view.board_mm)
    inside = (pixel > side_px).all(axis=1) & (pixel < np.array(camera.sensor_px) - 1.0 - side_px).all(axis=1)
    low, high = view.index.min(axis=0), view.index.max(axis=0)  # beyond, the board may end
    known = beside & inside & ((index >= low) & (index <= high)).all(axis=1)
    index, pixel = index[known], pixel[known]
    if not len(index):
        return ()
    away, _ = scipy.spatial.cKDTree(find_marks(frame, view.board, None, side_px).position_px).query(pixel)
    lost = away > AT_CORNER * side_px
    lattice, cell = np.zeros(high - low + 1, dtype=np.bool_), index - low
    lattice[cell[lost, 0], cell[lost, 1]] = True
    label, count = scipy.ndimage.label(lattice)
    own = label[cell[:, 0], cell[:, 1]]
    sizes = np.bincount(own[lost], minlength=count + 1)
    largest = int(sizes.argmax())
    if sizes[largest] < FEWEST_HIDDEN:
        return ()
    u, v = pixel[own == largest].mean(axis=0).tolist()
    said = (
        f"{sizes[largest]} corners side by side around pixel ({u:.0f}, {v:.0f}) are hidden by something that the"
        " scene does not name"
    )
    if areas and sizes[largest] * side_px**2 > AS_GLASS * min(areas):
        raise RimUnclear(f"{said}: another ball? Name all that stands there, or nothing may be moved by itself")
    return (said,)
