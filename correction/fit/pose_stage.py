"""Poses of the target that no stage measured: a board held by hand, tilted or aside, without glass or through it.

Each has six numbers of its own in the fit, of which nothing is known before.  Where the board is found in its
frame, a pinhole says where it stands, in two ways (a plane seen from afar looks nearly the same tilted to either
side); from both the pose alone is fitted through the walls that stand there, and the better one is where the fit
of all frames begins.  Behind balls the board is found beside them, where rays reach the plane as without them.

Such a frame is extra: one that shows no board, or another one, or the board where another frame shows it, is left
out with the reason, and the fit goes on without it.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.errors import TargetNotFound
from correction.fit.adjustment import Adjustment, feasible_scene
from correction.fit.progress import Progress
from correction.fit.seen.measurement import MeasuredFrame, TargetFrame, as_measured
from correction.fit.solve.unknowns import pose_label
from correction.target.board_search import find_held_board, mirror_found
from correction.target.lattice_fit import BoardDetection
from piv.errors import FrameError
from tracer.camera import Camera
from tracer.scene.scene import Scene
from tracer.strategies.trace import trace

OTHER_TIMES = 4.0  # rms of a frame over that of the others, from which it shows another board, or a bent one
OTHER_PX = 0.3  # and at least this
SAME_VIEW, SAME_SQUARES = 2e-3, 5.0  # of the distance: points so many squares from the origin that are not farther
# apart at two poses say nothing new
BESIDE_PX, CLEAR_PX, STEP_PX = 0.01, 12, 4  # bending of rays beside balls; distance kept from them; raster
Array = NDArray[np.float64]


def find_poses(work: Progress) -> None:
    """Find the board in all frames of poses by hand, and start each pose where it is seen."""
    placed = {frame.name: (False, _points_mm(work, frame.corners.height_number)) for frame in work.bare}
    for frame in [frame for frame in (*work.bare_frames, *work.glass_frames) if frame.pose]:
        if frame.glass and frame.pose in {one.pose for one in work.bare_frames}:
            continue  # the board has stood there since its frame without glass
        try:
            found = _find(work, frame)
        except (TargetNotFound, FrameError) as error:
            bare = f"; or take target_clear_{frame.pose} too, before the glass is put there" if frame.glass else ""
            work.drop_pose(frame.pose, f"{error}{bare}")
            continue
        measured = as_measured(frame.name, found, work.height_number(frame))
        _fit_pose(work, frame.pose, found, measured)
        seen_mm = _points_mm(work, measured.corners.height_number)
        same = next(
            (name for name, other in placed.items() if _is_same(work, (frame.glass, seen_mm), other)), None
        )
        if same is not None:
            work.drop_pose(frame.pose, f"it shows the board at the same pose as {same}, so it adds no information")
            continue
        placed[frame.name] = frame.glass, seen_mm
        if not frame.glass:
            work.bare.append(measured)


def drop_other_boards(work: Progress) -> bool:
    """Leave out poses by hand whose marks fit far worse than those of the other frames; say whether there are."""
    x = work.unknowns.free(work.full)
    rms = {
        frame.name: float(np.sqrt(np.nanmean(work.fits.reprojection(work.unknowns, x, [frame]) ** 2)))
        for frame in work.bare
    }
    limit = max(OTHER_PX, OTHER_TIMES * float(np.median(list(rms.values()))))
    off = [frame for frame in work.bare_frames if frame.pose and not rms.get(frame.name, 0.0) <= limit]
    for frame in off:
        work.drop_pose(
            frame.pose,
            f"its marks lie {rms[frame.name]:.2f} px from any pose of the board: another board, or a bent one",
        )
    return bool(off)


def _find(work: Progress, frame: TargetFrame) -> BoardDetection:
    """Find the board in a frame of a pose by hand; with glass, beside the balls."""
    camera = work.unknowns.camera(work.full)
    mask = _beside_balls(feasible_scene(work.unknowns, work.full)[0]) if frame.glass else None
    if not camera.is_mirrored:
        return find_held_board(frame.image, work.board, mask)
    seen = None if mask is None else np.ascontiguousarray(mask[:, ::-1])
    found = find_held_board(np.ascontiguousarray(frame.image[:, ::-1]), work.board, seen)
    return mirror_found(found, frame.image.shape[1] - 1.0)


def _beside_balls(scene: Scene) -> NDArray[np.bool_]:
    """Pixels (H, W) whose rays reach the plane as they would without balls, clear of these."""
    import cv2

    height, width = scene.camera.shape
    u, v = np.meshgrid(np.arange(0, width, STEP_PX), np.arange(0, height, STEP_PX))
    pixels = np.column_stack((u.ravel(), v.ravel())).astype(np.float64)
    off_mm = np.linalg.norm(trace(scene, pixels).plane_mm - trace(scene.bare(), pixels).plane_mm, axis=1)
    pitch_mm = scene.camera.position_mm[2] / scene.camera.focal_px
    beside = (off_mm < BESIDE_PX * pitch_mm).reshape(u.shape).astype(np.uint8)  # False for NaN
    whole = cv2.resize(beside, (width, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.erode(whole, np.ones((2 * CLEAR_PX + 1,) * 2, np.uint8)) > 0)


def _fit_pose(work: Progress, pose: str, found: BoardDetection, measured: MeasuredFrame) -> None:
    """Start a pose from the better of both that a pinhole sees, each fitted through the walls that stand there."""
    tried = []
    for start in pinhole_poses(work.unknowns.camera(work.full), found):
        work.put_pose(pose, start)
        alone = work.unknowns.around(work.full).only([pose_label(pose)])
        fits = Adjustment()
        solution = fits.solve(alone, np.zeros(len(alone.names)), [measured])
        rms_px = float(np.sqrt(np.mean(fits.reprojection(alone, solution.x, [measured]) ** 2)))
        place = alone.place(measured.corners.height_number)
        tried.append((rms_px if np.isfinite(rms_px) else np.inf, alone.full(solution.x)[place]))
    work.put_pose(pose, min(tried, key=lambda one: one[0])[1])


def pinhole_poses(camera: Camera, found: BoardDetection) -> list[Array]:
    """Poses (6,) of a board, x, y, z [mm] and turn [rad], that a pinhole sees so, the likelier first.

    Parameters
    ----------
    camera : Camera
        Of the frame; its lens terms are taken off.
    found : BoardDetection
        The board in the frame.
    """
    import cv2

    (u, v), focal, across = camera.principal_px, camera.focal_px, -1.0 if camera.is_mirrored else 1.0
    matrix = np.array(((across * focal, 0.0, u), (0.0, focal, v), (0.0, 0.0, 1.0)))
    places = np.column_stack((found.plane_mm, np.zeros(len(found))))
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        places, camera.ideal(found.position_px), matrix, None, flags=cv2.SOLVEPNP_IPPE
    )
    to_world = camera.rotation_matrix.T * (across, 1.0, 1.0)
    out = []
    for turn, shift in zip(turns, shifts, strict=True):
        axes = to_world @ scipy.spatial.transform.Rotation.from_rotvec(turn[:, 0]).as_matrix()
        vector = scipy.spatial.transform.Rotation.from_matrix(axes).as_rotvec()
        out.append(np.concatenate((np.array(camera.position_mm) + to_world @ shift[:, 0], vector)))
    return out


def _points_mm(work: Progress, number: int) -> Array:
    """World points (4, 3) of four points of the board at a pose, some squares from its origin."""
    side = SAME_SQUARES * float(work.board.sides_mm.mean())
    around = np.array(((-side, -side), (side, -side), (side, side), (-side, side)))
    return work.unknowns.pose(work.full, number).to_world(around)


def _is_same(work: Progress, one: tuple[bool, Array], other: tuple[bool, Array]) -> bool:
    """Return whether two frames, with glass or without, show the board as good as alike."""
    away = float(np.linalg.norm(np.array(work.unknowns.camera(work.full).position_mm) - one[1].mean(axis=0)))
    return one[0] == other[0] and bool(np.linalg.norm(one[1] - other[1], axis=1).max() < SAME_VIEW * away)
