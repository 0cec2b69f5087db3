"""Photographs of boards taken by others, and what cameras and files do to them.

OpenCV judges: its own finder and `cornerSubPix` say where corners are, its own poses which corner is which.
The photographs lie beside the checkout and are read where they are.
"""

import json
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from correction.errors import TargetNotFound
from correction.target import Chessboard
from correction.target.board_search import track_board
from tests.correction.target.drawn_boards import REACH_MM, drawn
from tests.supplied import ROOT

FOLDER = ROOT.parent / "shared" / "cases" / "real"
SETS = {"opencv/opencv_left.json": "left", "opencv/opencv_right.json": "right", "gopro/ahmed.json": "calib"}
BY_HAND = {  # the outer four inner corners [px] where glare hides the board from OpenCV's finder
    "calibration_frame1025.jpg": [(460.0, 515.0), (1182.0, 520.0), (432.0, 980.0), (1170.0, 1028.0)]
}
STRAY_PX, STRAY_BLUR = (
    1.0,
    0.25,
)  # so far from its place a corner is wrong; of the blur of its edges


@dataclass(frozen=True)
class Photograph:
    """A frame, its board, where OpenCV sees the corner with each index, and what the camera is believed to see."""

    name: str
    image: np.ndarray
    board: Chessboard
    corners: dict
    matrix: np.ndarray  # (3, 3): pixels of the photograph -> pixels of this image
    project: object

    def predict(self, places_mm):
        """Pixels of board points (M, 3), by OpenCV's pose and lens."""
        seen = np.column_stack((self.project(places_mm), np.ones(len(places_mm)))) @ self.matrix.T
        return seen[:, :2] / seen[:, 2:]

    def changed(self, image, matrix=None):
        """Return another image of the same view, moved by a matrix."""
        step = np.eye(3) if matrix is None else np.array(matrix, float)
        corners = {key: (step @ (*place, 1.0))[:2] for key, place in self.corners.items()}
        return replace(self, image=image, corners=corners, matrix=step @ self.matrix)


def photographs(every=1):
    """All photographs of which a pose is known, or skip."""
    if not FOLDER.is_dir():
        pytest.skip("photographs of boards are not beside this checkout")
    found = []
    for name, start in SETS.items():
        about = json.loads((FOLDER / name).read_text())
        for path in sorted((FOLDER / name).parent.glob(f"{start}*.jpg")):
            if path.name in about["poses"] or path.name in BY_HAND:
                found.append((path, about))
    return [_photograph(path, about) for path, about in found[::every]]


def _photograph(path, about):
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    (nx, ny), side = about["inner_corners"], about["square"]
    matrix, lens = np.array(about["K"]), np.array(about.get("dist", [0.0] * 5))
    if path.name in BY_HAND:
        outer = side * np.array([(x, y, 0.0) for y in (0, ny - 1) for x in (0, nx - 1)])
        turn, away = (
            value.ravel() for value in cv2.solvePnP(outer, np.array(BY_HAND[path.name]), matrix, lens)[1:]
        )
    else:
        turn, away = (np.array(about["poses"][path.name][name]) for name in ("rvec", "tvec"))
    board = Chessboard(side, discs=(), squares=(nx + 1, ny + 1))
    first = np.array((nx // 2, ny // 2))  # OpenCV counts from the upper left inner corner, rightwards and down

    def project(places_mm):
        places = np.asarray(places_mm, float).reshape(-1, 3)
        own = places * (1.0, -1.0, -1.0) + np.append(first * side, 0.0)
        seen = own @ cv2.Rodrigues(turn)[0].T + away
        pixel = cv2.projectPoints(own, turn, away, matrix, lens)[0].reshape(-1, 2)
        hidden = (seen[:, 2] <= 0.0) | (np.hypot(*seen.T[:2]) > 1.5 * np.abs(seen[:, 2]))
        return np.where(hidden[:, None], np.nan, pixel)

    index = np.array([(i - first[0], first[1] - j) for j in range(ny) for i in range(nx)])
    place = project(board.place_mm(index)).astype(np.float32)
    narrow = min(np.linalg.norm(np.diff(place.reshape(ny, nx, 2), axis=axis), axis=2).min() for axis in (0, 1))
    half = max(3, int(0.25 * narrow))
    stop = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4
    fine = cv2.cornerSubPix(image, place.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), stop).reshape(-1, 2)
    corners = {(int(i), int(j)): p.astype(float) for (i, j), p in zip(index, fine, strict=True)}
    return Photograph(path.name, image, board, corners, np.eye(3), project)


def drawn_board(seed):
    """Return a drawn board behind balls as if it were a photograph, and squares its camera may be off."""
    one = drawn(seed)
    columns, rows = one.board.squares or (33, 33)
    grid = np.stack(np.meshgrid(np.arange(-columns, columns + 1), np.arange(-rows, rows + 1)), axis=-1).reshape(
        -1, 2
    )
    index = grid[one.board.has_corner(grid)]
    places = one.true.project(one.board.place_mm(index))
    corners = {(i, j): place for (i, j), place in zip(index.tolist(), places, strict=True)}
    project = one.nominal.project
    image = _grey(one.image * (220.0 / np.percentile(one.image, 99.0)))
    found = Photograph(one.about, image, one.board, corners, np.eye(3), project)
    return found, REACH_MM / one.board.square_mm


def flipped(one, rng):
    """A mirror image, or a frame turned by half, of which the camera knows nothing: no place in it is right."""
    way = int(rng.integers(3))
    image = (one.image[:, ::-1], one.image[::-1], one.image[::-1, ::-1])[way]
    return replace(one, image=np.ascontiguousarray(image), corners={}, name=f"{one.name} flipped {way}")


def mirrored(one, rng):
    """A camera with ReverseX, and known to have it."""
    matrix = [(-1, 0, one.image.shape[1] - 1), (0, 1, 0), (0, 0, 1)]
    return one.changed(np.ascontiguousarray(one.image[:, ::-1]), matrix)


def noisy(one, rng):
    """White noise, as of a camera with much gain."""
    return one.changed(_grey(one.image + rng.normal(0.0, rng.uniform(4.0, 12.0), one.image.shape)))


def packed(one, rng):
    """JPEG of little quality."""
    code = cv2.imencode(".jpg", one.image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(15, 50))])[1]
    return one.changed(cv2.imdecode(code, cv2.IMREAD_GRAYSCALE))


def blurred(one, rng):
    """Out of focus."""
    return one.changed(cv2.GaussianBlur(one.image, (0, 0), rng.uniform(1.0, 2.5) * one.image.shape[1] / 640.0))


def glaring(one, rng):
    """A reflex of a lamp, which ends at full scale."""
    v, u = np.indices(one.image.shape) / one.image.shape[1]
    spot = rng.uniform(0.2, 0.8), rng.uniform(0.15, 0.6)
    far = np.hypot(u - spot[0], v - spot[1])
    light, wide = rng.uniform(80.0, 300.0), rng.uniform(0.05, 0.2)
    return one.changed(_grey(one.image + light * np.exp(-((far / wide) ** 2))))


def dim(one, rng):
    """A tenth to a half of the light, in whole counts."""
    return one.changed(_grey(one.image * rng.uniform(0.1, 0.5)))


def hidden(one, rng):
    """A hand, or an edge of something, before a part of the board."""
    shape, image = np.array(one.image.shape), one.image.copy()
    size = (shape * rng.uniform(0.15, 0.5, 2)).astype(int)
    v, u = (rng.uniform(0.0, 1.0, 2) * (shape - size)).astype(int)
    image[v : v + size[0], u : u + size[1]] = int(rng.integers(0, 255))
    return one.changed(image)


def cropped(one, rng):
    """A sensor that ends within the board."""
    height, width = one.image.shape
    v, u = int(rng.uniform(0.0, 0.3) * height), int(rng.uniform(0.0, 0.3) * width)
    rows, columns = int(rng.uniform(0.5, 0.7) * height), int(rng.uniform(0.5, 0.7) * width)
    return one.changed(
        np.ascontiguousarray(one.image[v : v + rows, u : u + columns]), [(1, 0, -u), (0, 1, -v), (0, 0, 1)]
    )


def shrunk(one, rng):
    """Fewer pixels."""
    by = rng.uniform(0.5, 0.9)
    size = tuple(round(by * side) for side in one.image.shape[::-1])
    x, y = (new / old for new, old in zip(size, one.image.shape[::-1], strict=True))
    return one.changed(
        cv2.resize(one.image, size, interpolation=cv2.INTER_AREA),
        [(x, 0, 0.5 * x - 0.5), (0, y, 0.5 * y - 0.5), (0, 0, 1)],
    )


def turned(one, rng):
    """The camera turned by a quarter, or by half, and known to be."""
    height, width = one.image.shape
    quarters = int(rng.integers(1, 4))
    matrix = np.eye(3)
    for _ in range(quarters):
        matrix = np.array([(0, 1, 0), (-1, 0, width - 1), (0, 0, 1)]) @ matrix
        width, height = height, width
    return one.changed(np.ascontiguousarray(np.rot90(one.image, quarters)), matrix)


DEGRADED = noisy, packed, blurred, glaring, dim, hidden, cropped, shrunk, turned, mirrored


def degraded(one, seed, ways=DEGRADED):
    """Return a photograph with one to three things done to it, and their names."""
    rng = np.random.default_rng((seed, 56))
    names = []
    for which in rng.permutation(len(ways))[: rng.integers(1, 4)].tolist():
        one = ways[which](one, rng)
        names.append(ways[which].__name__)
    return one, f"{one.name} {seed}: {', '.join(names)}"


def verdict(one, reach=None, off_squares=(0.0, 0.0), strays=0.0):
    """Say "right", "refused" or "wrong", with how many corners are found, or why none, or by how much.

    `strays` is the share of corners that may lie more than a pixel off.
    """
    off_mm = np.append(np.array(off_squares) * one.board.square_mm, 0.0)
    try:
        found = track_board(one.image, one.board, lambda place: one.predict(place + off_mm), reach=reach)
    except TargetNotFound as error:
        return "refused", str(error)
    off = np.array(
        [
            np.linalg.norm(one.corners.get((i, j), np.full(2, np.inf)) - place)
            for (i, j), place in zip(found.index.tolist(), found.position_px, strict=True)
        ]
    )
    stray = np.count_nonzero(off > np.maximum(STRAY_PX, STRAY_BLUR * found.blurs_px.max(axis=1)))
    if stray > strays * len(off) or off.max() > 0.3 * np.linalg.norm(found.axes_px, axis=1).mean():
        return "wrong", f"{stray} of {len(off)}, by up to {off.max():.1f} px"
    return "right", len(off)


def _grey(values):
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
