"""Boards at any pose behind flat walls, drawn by rays of the tests' own: planes and Snell's law with vectors.

Shares no line with tracer or simulator.  `fermat_px` asks the other way round, where a point of a board is seen:
the path of least time through the planes, by Newton's method.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from correction.fit.seen.measurement import TargetFrame
from tests.correction.synthetic_board import photographed, soft_board
from tracer.board import CHIRAL

SHAPE = (210, 280)
FOCAL_PX = 490.0
CAMERA_MM = np.array((6.0, -4.0, 610.0))


def matrix_of(turn_rad):
    """Rotation about x, then y, then z of the world."""
    return Rotation.from_euler("xyz", turn_rad).as_matrix()


def camera_axes(turn_rad=(0.0, 0.0, 0.0)):
    """Rows: x right, y down, z forward of a camera that looks along -z, turned."""
    return np.diag((1.0, -1.0, -1.0)) @ matrix_of(turn_rad).T


def flat_tank(near_mm, thickness_mm, n, normal=(0.0, 0.0, 1.0)):
    """Planes of a slab whose front face passes z = near_mm: (normal, offset along it, index behind)."""
    normal = np.array(normal) / np.linalg.norm(normal)
    front = near_mm * normal[2]
    return ((normal, front, n), (normal, front - thickness_mm, 1.0))


def land(pixels, planes, pose, axes, focal_px=FOCAL_PX):
    """Board points (..., 2) [mm] that pixels (..., 2) show; pose: place (3,) and turns (3,) of the board."""
    middle = 0.5 * (np.array(SHAPE[::-1]) - 1.0)
    local = (np.asarray(pixels, float) - middle) / focal_px
    way = np.concatenate((local, np.ones((*local.shape[:-1], 1))), axis=-1) @ axes
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    at, before = np.broadcast_to(CAMERA_MM, way.shape), 1.0
    for normal, offset, behind in planes:
        at = at + way * ((offset - at @ normal) / (way @ normal))[..., None]
        ratio, steep = before / behind, -(way @ normal)
        across = np.sqrt(1.0 - ratio**2 * (1.0 - steep**2))
        way, before = ratio * way + (ratio * steep - across)[..., None] * normal, behind
    place, board = np.array(pose[0]), matrix_of(pose[1])
    at = at + way * (((place - at) @ board[:, 2]) / (way @ board[:, 2]))[..., None]
    return ((at - place) @ board)[..., :2]


def fermat_px(points_mm, planes, axes, focal_px=FOCAL_PX):
    """Pixels (N, 2) that show world points (N, 3): least optical path over where it crosses parallel planes."""
    normal = planes[0][0]
    ends = np.array([CAMERA_MM @ normal, *(offset for _, offset, _ in planes)])
    index = np.array([1.0, *(behind for _, _, behind in planes)])
    out = []
    for point in points_mm:
        deep = -np.diff(np.append(ends, point @ normal))
        across = (point - CAMERA_MM) - ((point - CAMERA_MM) @ normal) * normal
        far = np.linalg.norm(across)
        # d path / d crossings = 0 says that index x sine is the same in every layer: one number, by Newton.
        sine = far / np.hypot(far, deep.sum())
        for _ in range(50):
            cosine = np.sqrt(index**2 - sine**2)
            step = (far - (deep * sine / cosine).sum()) / (deep * index**2 / cosine**3).sum()
            sine += step
            if abs(step) < 1e-15:
                break
        way = axes @ (sine * across / max(far, 1e-300) - np.sqrt(1.0 - sine**2) * normal)
        out.append(0.5 * (np.array(SHAPE[::-1]) - 1.0) + focal_px * way[:2] / way[2])
    return np.array(out)


def tank_frame(
    name, planes, pose, seed, square_mm=16.0, axes=None, blur_px=0.7, discs=CHIRAL, sheet_mm=None, wider=1.0
):
    """One frame; a sheet of so many mm (2,) about the board's origin ends in grey, else the board has no end.

    `wider` stretches the print along x.
    """
    axes = camera_axes() if axes is None else axes

    def to_board(pixels):
        return land(pixels, planes, pose, axes) / (wider, 1.0)

    image = soft_board(to_board, SHAPE, square_mm, blur_px, discs=discs, disc_mm=0.4 * square_mm)
    if sheet_mm is not None:
        rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
        inside = (np.abs(to_board(np.stack((columns, rows), -1))) < 0.5 * np.array(sheet_mm)).all(axis=-1)
        image = np.where(inside, image, 1200.0)
    pose_name = name.partition("_pose")[2]
    return TargetFrame(name, photographed(image, seed), "glass" in name, 0.0, pose_name and f"pose{pose_name}")
