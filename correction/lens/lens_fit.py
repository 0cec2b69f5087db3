"""Lens and focal length from several poses of a board, none of them measured (Zhang, IEEE PAMI 22, 1330 (2000)).

Unknown are the numbers of the lens, which all frames share, and eight of each frame: its pose, and how far shadows
put the lower level of a plate aside, which two more equations bound.  With A_i the derivatives of the marks of
frame i by the shared numbers, B_i those by its own and r_i what is left, all divided by the standard deviations of
the marks, every step solves

    [ sum A_i^T A_i + P   A_i^T B_i ] [ shared ]   [ sum A_i^T r_i + P (prior - shared) ]
    [ B_i^T A_i           B_i^T B_i ] [ pose_i ] = [ B_i^T r_i                          ]

by eliminating the poses, frame by frame (the Schur complement of bundle adjustment).  OpenCV's calibrateCamera
gives the start; its lens terms go from the ideal to the acquired pixel, those of `tracer.camera` the other way.

Boards are not flat and marks not alike: what the residuals show beyond the standard deviations of the marks is
added to these, in quadrature and alike for all.  The marks of one frame also share errors, so their scatter alone
promises too much: each variance is the larger of the usual one and that of the linear jackknife, which leaves out
one frame after the other.

Sensors have square pixels to a hundredth of a per cent, frames that were resized have not.  The height of a pixel
over its width is a number like the others, known to SQUARE_SIGMA before; where the frames contradict that, or the
user has said so, it is free.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from correction.errors import ViewsMissing
from tracer.camera import Camera, Lens

SHARED = ("focal_px", "principal_u_px", "principal_v_px", "k1", "k2", "k3", "p1", "p2", "pixel_aspect")
SQUARE_SIGMA = 1e-4  # of the height of a pixel over its width
SQUARE = np.array((*[0.0] * 8, 1.0))  # what is likely before
PRIOR = np.array((np.inf, np.inf, np.inf, 1.0, 5.0, 25.0, 0.1, 0.1, SQUARE_SIGMA))  # and its standard deviations
FREE = np.array((*PRIOR[:8], np.inf))
LEAST_POSES = 3
WEAK_FOCAL_SHARE = 0.02  # sigma of a focal length from which more tilted boards are advised
MOST_FOCAL_SHARE = 0.05  # and beyond which it is not worth keeping
OFF_TIMES = 6.0  # of the usual scatter: marks beyond are left out
FRAME_OFF_TIMES = 4.0  # rms of a frame over the median of all: beyond, another board or a bent one
NOT_SQUARE, NOT_SQUARE_SIGMAS = 1e-3, 3.0  # by which width and height of pixels may differ
TILT_CURE = "take more frames with the board tilted by 20 to 40 degrees, to the left, right, up and down"
ROUNDS, SETTLED = 60, 1e-7
FRONT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class SeenBoard(NamedTuple):
    """Marks of a board in one frame, N of them.

    Attributes
    ----------
    tag : str
        Name of the frame.
    place_mm : (N, 3) float64
        x, y and z on the board.
    position_px, sigma_px : (N, 2) float64
        u, v in the frame and their standard deviations.
    aside_mm : float
        Standard deviation, along x and y, by which all marks that are not at z = 0 may stand aside.
    """

    tag: str
    place_mm: NDArray[np.float64]
    position_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    aside_mm: float


@dataclass(frozen=True)
class LensFit:
    """Lens and focal length found.

    Attributes
    ----------
    camera : Camera
        At the origin, looking along z: focal length, principal point, lens terms; its pixels are square.
    numbers : (9,) float64
        Values of `SHARED`; the last is the height of a pixel over its width.
    covariance : (9, 9) float64
        Of `SHARED`.
    poses : dict
        Frame -> (8,) turn vector and shift [mm] from board to camera, and x, y by which the lower level of a plate
        stands aside [mm].
    residual_px : dict
        Frame -> (N, 2) found minus computed, NaN for marks that are left out.
    board_sigma_px : float
        What was added to the standard deviations of the marks.
    seen_aspect : (float, float)
        Height over width of a pixel by the frames alone, and its standard deviation.
    lever : (str, float)
        The frame on which the focal length depends most, and by how much it is longer without it [px].
    refused : dict
        Frame -> why it was not used.
    seen : dict
        Frame -> its marks.
    """

    camera: Camera
    numbers: NDArray[np.float64]
    covariance: NDArray[np.float64]
    poses: dict[str, NDArray[np.float64]]
    residual_px: dict[str, NDArray[np.float64]]
    board_sigma_px: float
    seen_aspect: tuple[float, float]
    lever: tuple[str, float]
    refused: dict[str, str]
    seen: dict[str, SeenBoard] = field(repr=False)

    @property
    def sigma(self) -> NDArray[np.float64]:
        """Standard deviations (9,) of `SHARED`."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def has_square_pixels(self) -> bool:
        """Return whether frames agree with square pixels; a scene has no others."""
        return bool(abs(self.numbers[8] - 1.0) <= NOT_SQUARE_SIGMAS * max(self.sigma[8], SQUARE_SIGMA))

    @property
    def rms_px(self) -> float:
        """Root mean square distance of found from computed marks, as OpenCV's calibrateCamera states it."""
        off = np.concatenate([each[np.isfinite(each[:, 0])] for each in self.residual_px.values()])
        return float(np.sqrt((off**2).sum(axis=1).mean()))

    @property
    def warnings(self) -> list[str]:
        """Sentences to read before the lens is used."""
        out = []
        if self.sigma[0] > WEAK_FOCAL_SHARE * self.numbers[0]:
            tag, moved_px = self.lever
            out.append(
                f"the focal length is known to {self.sigma[0] / self.numbers[0]:.1%} only: without {tag} alone it"
                f" is {moved_px:+.0f} px off; {TILT_CURE}"
            )
        if not self.has_square_pixels:
            width, height = self.camera.sensor_px
            out.append(
                f"pixels seem to be {self.numbers[8]:.4f} +- {self.sigma[8]:.4f} times as high as wide."
                " Turn the board by 90 degrees in some frames and measure its print in both directions"
                " (measured_mm in the board file), as a stretched print looks the same; if it stays, resize all"
                f" frames to {width} x {round(height * self.numbers[8])} px and fit the lens to these"
            )
        corners = np.concatenate([self.seen[tag].position_px for tag in self.poses])
        covered = np.ptp(corners, axis=0) / np.array(self.camera.sensor_px)
        if covered.min() < 0.6:
            out.append(
                f"boards cover {covered[0]:.0%} of the width and {covered[1]:.0%} of the height of the frame; lens"
                " terms beyond them are extrapolated, so add poses at the borders"
            )
        return out


@dataclass(frozen=True)
class _Numbers:
    """All unknowns: shared ones (9,) and those of each frame (F, 8)."""

    shared: NDArray[np.float64]
    poses: NDArray[np.float64]


def fit_lens(
    boards: Sequence[SeenBoard], sensor_px: tuple[int, int], aspect_sigma: float = SQUARE_SIGMA
) -> LensFit:
    """Fit lens and focal length to boards at any poses.

    Parameters
    ----------
    boards : sequence of SeenBoard
        One a frame; the board tilted by 20 to 40 degrees to several sides in most.
    sensor_px : (int, int)
        Width and height of the frames.
    aspect_sigma : float
        How well pixels are known to be square.

    Returns
    -------
    LensFit

    Raises
    ------
    ViewsMissing
        Fewer than three frames, or frames that do not determine the focal length to 5 %.
    """
    if len(boards) < LEAST_POSES:
        raise ViewsMissing(f"{len(boards)} frames show the board; {LEAST_POSES} are needed, 10 to 20 are good")
    every = [np.ones(len(each.place_mm), bool) for each in boards]
    # Once with everything and pixels of any shape, then without what scatters more than the rest.
    first, left = _adjust(_start(boards, sensor_px), boards, every, FREE)
    scaled = [np.abs(each / board.sigma_px).max(axis=1) for each, board in zip(left, boards, strict=True)]
    usual = 1.4826 * float(np.median(np.concatenate(scaled)))
    rms = np.array([np.sqrt((each**2).mean()) for each in left])
    kept = rms <= FRAME_OFF_TIMES * np.median(rms)
    refused = {
        board.tag: f"its marks lie {own:.2f} px from any flat board, those of others {np.median(rms):.2f} px"
        for board, own, good in zip(boards, rms, kept, strict=True)
        if not good
    }
    if kept.sum() < LEAST_POSES:
        raise ViewsMissing("the frames fit no common lens; keep zoom and focus as they are, and use one board")
    boards = [board for board, good in zip(boards, kept, strict=True) if good]
    used = [each <= OFF_TIMES * max(usual, 1.0) for each, good in zip(scaled, kept, strict=True) if good]
    left = [each for each, good in zip(left, kept, strict=True) if good]
    board_sigma_px = _excess(left, boards, used)
    boards = [board._replace(sigma_px=np.hypot(board.sigma_px, board_sigma_px)) for board in boards]
    prior = FREE
    numbers, left = _adjust(_Numbers(first.shared, first.poses[kept]), boards, used, prior)
    seen = float(numbers.shared[8]), float(np.sqrt(_covariance(numbers, boards, used, prior)[0][8, 8]))
    if abs(seen[0] - 1.0) <= max(NOT_SQUARE_SIGMAS * seen[1], NOT_SQUARE):  # the frames allow square pixels
        prior = np.array((*PRIOR[:8], aspect_sigma))
        numbers, left = _adjust(numbers, boards, used, prior)
    covariance, moved_px = _covariance(numbers, boards, used, prior)
    if not np.sqrt(covariance[0, 0]) <= MOST_FOCAL_SHARE * numbers.shared[0]:
        raise ViewsMissing(
            f"the boards determine the focal length to {np.sqrt(covariance[0, 0]) / numbers.shared[0]:.1%} only;"
            f" {TILT_CURE}"
        )
    tags = [board.tag for board in boards]
    camera = _camera(numbers.shared, sensor_px)
    residual = {tag: np.where(own[:, None], each, np.nan) for tag, each, own in zip(tags, left, used, strict=True)}
    poses = dict(zip(tags, numbers.poses, strict=True))
    marks = dict(zip(tags, boards, strict=True))
    most = int(np.argmax(np.abs(moved_px)))
    lever = tags[most], float(moved_px[most])
    found = numbers.shared, covariance, poses, residual, board_sigma_px
    return LensFit(camera, *found, seen, lever, refused, marks)


def _excess(
    left: Sequence[NDArray[np.float64]], boards: Sequence[SeenBoard], used: Sequence[NDArray[np.bool_]]
) -> float:
    """Standard deviation [px] that residuals show beyond those of the marks."""
    off, own = (
        np.concatenate([each[good] for each, good in zip(of, used, strict=True)])
        for of in (left, [board.sigma_px for board in boards])
    )
    return float(np.sqrt(max(0.0, (off**2).mean() - (own**2).mean())))


def _camera(shared: NDArray[np.float64], sensor_px: tuple[int, int]) -> Camera:
    focal, u, v, k1, k2, k3, p1, p2 = (float(value) for value in shared[:8])
    return Camera(focal, (u, v), sensor_px, (0.0, 0.0, 1.0), FRONT, Lens(k1, k2, k3, p1, p2))


def _start(boards: Sequence[SeenBoard], sensor_px: tuple[int, int]) -> _Numbers:
    """Return numbers by OpenCV, with the first of its radial terms turned about."""
    import cv2

    plane = [(each.place_mm * (1.0, 1.0, 0.0)).astype(np.float32) for each in boards]
    pixel = [each.position_px.astype(np.float32) for each in boards]
    _, matrix, terms, turns, shifts = cv2.calibrateCamera(
        plane, pixel, sensor_px, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    shared = SQUARE.copy()
    shared[:4] = matrix[0, 0], matrix[0, 2], matrix[1, 2], -float(np.ravel(terms)[0])
    shared[8] = matrix[0, 0] / matrix[1, 1]
    return _Numbers(
        shared,
        np.array([np.r_[turn[:, 0], shift[:, 0], 0.0, 0.0] for turn, shift in zip(turns, shifts, strict=True)]),
    )


class _Linear(NamedTuple):
    """Weighted residuals of a frame (M,), their derivatives by shared (M, S) and own numbers (M, 8)."""

    by_shared: NDArray[np.float64]
    by_pose: NDArray[np.float64]
    left: NDArray[np.float64]


def _residual(shared: NDArray[np.float64], pose: NDArray[np.float64], board: SeenBoard) -> NDArray[np.float64]:
    """Found minus computed (N, 2) in acquired pixels.

    Both are compared as ideal pixels, where the terms lead without iteration. The difference is taken back by the
    inverse of d ideal / d acquired: exact to first order in a residual, which is a small part of a pixel.
    """
    seen, by_acquired, _ = _ideal(shared, board.position_px)
    off = seen - _project(shared, pose, board.place_mm)[0]
    return np.asarray(np.linalg.solve(by_acquired, off[..., None])[..., 0])


def _ideal(
    shared: NDArray[np.float64], position_px: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Ideal pixels (N, 2), derivatives by acquired pixels (N, 2, 2) and by the shared numbers (N, 2, 9)."""
    focal, (k1, k2, k3, p1, p2), high = shared[0], shared[3:8], np.array((1.0, shared[8]))
    off_px = position_px - shared[1:3]
    xy = off_px / focal * high
    x, y = xy.T
    r2 = x * x + y * y
    radial, slope = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    bent = Lens(k1, k2, k3, p1, p2).apply(xy)
    across = 2.0 * (slope * x * y + p1 * x + p2 * y)
    along_x = radial + 2.0 * slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    along_y = radial + 2.0 * slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    by_square = np.stack((along_x, across, across, along_y), axis=-1).reshape(-1, 2, 2)
    by_acquired = by_square * high
    by_shared = np.empty((len(xy), 2, 9))
    by_shared[..., 0] = bent - (by_square @ xy[..., None])[..., 0]
    by_shared[..., 1:3] = np.eye(2) - by_acquired
    by_shared[..., 3:6] = focal * xy[..., None] * np.stack((r2, r2**2, r2**3), axis=-1)[:, None]
    by_shared[:, 0, 6:8] = focal * np.stack((2.0 * x * y, r2 + 2.0 * x * x), axis=-1)
    by_shared[:, 1, 6:8] = focal * np.stack((r2 + 2.0 * y * y, 2.0 * x * y), axis=-1)
    by_shared[..., 8] = by_square[..., 1] * off_px[:, 1:]
    return shared[1:3] + focal * bent, by_acquired, by_shared


def _project(
    shared: NDArray[np.float64], pose: NDArray[np.float64], place_mm: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Ideal pixels (N, 2) of a board, derivatives by shared numbers (N, 2, 9) and its frame's own (N, 2, 8)."""
    import cv2

    matrix = np.array(((shared[0], 0.0, shared[1]), (0.0, shared[0], shared[2]), (0.0, 0.0, 1.0)))
    is_deep, axes = place_mm[:, 2:] != 0.0, cv2.Rodrigues(pose[:3])[0][:, :2]
    # A plate turns about a level that stands still: whichever of both is aside, its shift makes up for it.
    pixel, by = cv2.projectPoints(place_mm + is_deep * (*pose[6:], 0.0), pose[:3], pose[3:6], matrix, None)
    by = by.reshape(len(place_mm), 2, -1)
    by_shared = np.zeros((len(place_mm), 2, len(shared)))
    by_shared[..., 0] = by[..., 6] + by[..., 7]
    by_shared[..., 1:3] = by[..., 8:10]
    by_own = np.concatenate((by[..., :6], is_deep[:, None] * (by[..., 3:6] @ axes)), axis=-1)
    return np.asarray(pixel[:, 0], np.float64), by_shared, np.asarray(by_own, np.float64)


def _linearise(numbers: _Numbers, boards: Sequence[SeenBoard], used: Sequence[NDArray[np.bool_]]) -> list[_Linear]:
    """Return the equations of every frame, of the marks used, in scaled numbers."""
    scale, pose_scale = _scales(numbers)
    out = []
    for board, own, pose in zip(boards, used, numbers.poses, strict=True):
        seen, by_acquired, by_lens = _ideal(numbers.shared, board.position_px[own])
        computed, by_shared, by_pose = _project(numbers.shared, pose, board.place_mm[own])
        every = np.concatenate(
            ((by_shared - by_lens) * scale, by_pose * pose_scale, (seen - computed)[..., None]), axis=-1
        )
        every = np.linalg.solve(by_acquired, every) / board.sigma_px[own][..., None]
        rows = every.reshape(-1, every.shape[-1])
        # What is known of the shift of a level is two more equations.
        known = np.pad(np.diag(pose_scale[6:]), ((0, 0), (rows.shape[1] - 3, 1)))
        known[:, -1] = -pose[6:]
        rows = np.concatenate((rows, known / board.aside_mm))
        out.append(_Linear(rows[:, : len(scale)], rows[:, len(scale) : -1], rows[:, -1]))
    return out


def _scales(numbers: _Numbers) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return sizes of a change of shared numbers and of a pose that matter about alike."""
    focal, far = numbers.shared[0], float(np.median(numbers.poses[:, 5]))
    shared = np.array((focal, focal, focal, *([1.0] * (len(numbers.shared) - 3))))
    return shared, np.array((1.0, 1.0, 1.0, *[far] * 5))


class _Reduced(NamedTuple):
    """Part of a frame in the equations of the shared numbers, and how its pose follows them."""

    matrix: NDArray[np.float64]
    right: NDArray[np.float64]
    gain: NDArray[np.float64]
    own: NDArray[np.float64]


def _reduce(frame: _Linear, damping: float = 0.0) -> _Reduced:
    """Eliminate the pose of a frame."""
    a, b, r = frame
    normal = b.T @ b
    normal = normal + damping * np.diag(np.diag(normal))
    gain = np.asarray(np.linalg.solve(normal, np.column_stack((b.T @ a, b.T @ r))), np.float64)
    coupling = a.T @ b
    return _Reduced(a.T @ a - coupling @ gain[:, :-1], a.T @ r - coupling @ gain[:, -1], gain[:, :-1], gain[:, -1])


def _adjust(
    start: _Numbers, boards: Sequence[SeenBoard], used: Sequence[NDArray[np.bool_]], prior: NDArray[np.float64]
) -> tuple[_Numbers, list[NDArray[np.float64]]]:
    """Levenberg-Marquardt from a start; the numbers, and residuals (N, 2) [px] of all marks.

    `prior` are the standard deviations (9,) of the shared numbers about `SQUARE`.
    """
    numbers, damping, weight = start, 1e-3, 1.0 / prior**2
    cost = _cost(numbers, boards, used, weight)
    for _ in range(ROUNDS):
        scale, pose_scale = _scales(numbers)
        parts = [_reduce(frame, damping) for frame in _linearise(numbers, boards, used)]
        matrix = sum(part.matrix for part in parts) + np.diag(weight * scale**2)
        right = sum(part.right for part in parts) - weight * (numbers.shared - SQUARE) * scale
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), right)
        trial = _Numbers(
            numbers.shared + step * scale,
            numbers.poses + np.array([part.own - part.gain @ step for part in parts]) * pose_scale,
        )
        better = _cost(trial, boards, used, weight)
        if better < cost:
            settled = cost - better < SETTLED * cost
            numbers, cost, damping = trial, better, damping * 0.1
            if settled:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    return numbers, [
        _residual(numbers.shared, pose, each) for pose, each in zip(numbers.poses, boards, strict=True)
    ]


def _cost(
    numbers: _Numbers, boards: Sequence[SeenBoard], used: Sequence[NDArray[np.bool_]], weight: NDArray[np.float64]
) -> float:
    off = [
        ((_residual(numbers.shared, pose, board)[own] / board.sigma_px[own]) ** 2).sum()
        + ((pose[6:] / board.aside_mm) ** 2).sum()
        for board, own, pose in zip(boards, used, numbers.poses, strict=True)
    ]
    total = float(sum(off) + (weight * (numbers.shared - SQUARE) ** 2).sum())
    return (
        total if np.isfinite(total) and numbers.shared[0] > 0.0 and (numbers.poses[:, 5] > 0.0).all() else np.inf
    )


def _covariance(
    numbers: _Numbers, boards: Sequence[SeenBoard], used: Sequence[NDArray[np.bool_]], prior: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Covariance (9, 9) of the shared numbers, each variance the larger of both kinds, and changes [px] (F,).

    The latter are those of the focal length without one frame after the other.
    """
    scale, _ = _scales(numbers)
    parts = [_reduce(frame) for frame in _linearise(numbers, boards, used)]
    total = sum(part.matrix for part in parts) + np.diag(scale**2 / prior**2)
    usual = np.linalg.inv(total)
    # Without frame i the shared numbers move by (total - own)^-1 times its right side.
    moved = np.array([np.linalg.solve(total - part.matrix, -part.right) for part in parts])
    jackknife = ((moved - moved.mean(axis=0)) ** 2).sum(axis=0) * (len(parts) - 1) / len(parts)
    wider = np.sqrt(np.maximum(1.0, jackknife / np.diag(usual))) * scale
    return np.asarray(usual * np.outer(wider, wider)), moved[:, 0] * scale[0]
