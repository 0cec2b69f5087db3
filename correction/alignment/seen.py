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
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.alignment.camera_seen import CameraSeen, find_camera, square_px
from correction.alignment.rim import rim_of
from correction.alignment.spheres_seen import SphereSeen, find_spheres
from correction.errors import RimUnclear
from correction.target import Chessboard
from correction.target.board_search import SATURATED, corners_in_view
from correction.target.corners import fraction_saturated
from correction.target.marks import find_marks
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

    In depth it moves as far as the camera does where the print may be larger: the rim alone says its place.
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
