"""ChArUco boards: in every bright square a marker that says which square it is (OpenCV's aruco).

A marker is read by OpenCV; what is used of it is its number and how it is turned.  Each marker that is read puts
the patch of lattice around it at one place of the board, and a patch is placed when AGREE markers say the same and
hardly one another: half of the board may be hidden, and a marker that is misread is outvoted.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.errors import BoardError
from correction.target.board_origin import Placing
from correction.target.chessboard import QUARTER_TURNS, Chessboard
from correction.target.lattice_growth import Patch
from tracer.board import Codes

AGREE, SHARE = 2, 0.7  # markers, and of all that are read on a patch
WINDOWS_PX = 23, 3  # of the threshold, the smallest: one window is three times as fast as all of them
ENOUGH = 10  # markers, with which no smaller windows are tried
NEAR = 1.5  # squares from a marker's middle to the nearest corner of a patch


def with_codes(board: Chessboard, codes: Codes) -> Chessboard:
    """Return a board of so many squares with markers in its bright ones, as OpenCV lays it out.

    Raises
    ------
    BoardError
        It does not lay out such a board.
    """
    coded = replace(board, codes=codes)
    some = next(iter(marker_squares(coded).values()))
    return replace(coded, odd_bright=sum(some) % 2 == 1)


def marker_squares(board: Chessboard) -> dict[int, tuple[int, int]]:
    """Number of each marker -> square of the board that it is in."""
    squares, codes, (across, up) = _coded(board)
    made = _opencv_board(squares, codes)
    found = {}
    for number, corners in zip(np.ravel(made.getIds()), made.getObjPoints(), strict=True):
        x, y = np.asarray(corners)[:, :2].mean(axis=0).tolist()
        found[int(number)] = int(x) - across, squares[1] - 1 - int(y) - up  # OpenCV counts rows from the top
    return found


def marked(board: Chessboard, places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether dark cells of markers are at places (..., 2) of a board, in squares from its origin."""
    squares, codes, origin = _coded(board)
    number, dark = _markers(board)
    square = np.floor(places).astype(np.int64) + origin
    inside = np.asarray(((square >= 0) & (square < squares)).all(axis=-1))
    column, row = np.moveaxis(np.where(inside[..., None], square, 0), -1, 0)
    mine = np.where(inside, number[column, row], -1)
    cells = dark.shape[1]
    within = (places + origin - square - 0.5) / codes.marker_share + 0.5
    x, y = np.floor(within[..., 0] * cells), np.floor((1.0 - within[..., 1]) * cells)
    there = (mine >= 0) & (x >= 0) & (x < cells) & (y >= 0) & (y < cells)
    at = (np.where(there, value, 0).astype(np.int64) for value in (mine, y, x))
    return np.asarray(there & dark[tuple(at)])


@dataclass(frozen=True)
class Marker:
    """A marker: its corners (4, 2) [px] from the upper left on, clockwise, and its square of the board."""

    corners_px: NDArray[np.float64]
    square: tuple[int, int]


def read_markers(frame: NDArray[Any], board: Chessboard) -> list[Marker]:
    """Read the markers of a board in a frame (H, W)."""
    import cv2

    low, high = np.percentile(frame, (0.5, 99.5))
    grey = np.clip((frame.astype(np.float32) - low) * (255.0 / max(float(high - low), 1e-6)), 0.0, 255.0)
    squares, read = marker_squares(board), list[Marker]()
    for smallest in WINDOWS_PX:
        settings = cv2.aruco.DetectorParameters()
        settings.errorCorrectionRate = 0.0  # what is nearly a marker is none
        settings.adaptiveThreshWinSizeMin, settings.adaptiveThreshWinSizeMax = smallest, max(WINDOWS_PX)
        reader = cv2.aruco.ArucoDetector(_dictionary(_coded(board)[1].dictionary), settings)
        found, numbers, _ = reader.detectMarkers(grey.astype(np.uint8))
        read = [
            Marker(np.asarray(corners, dtype=np.float64).reshape(4, 2), squares[int(number)])
            for number, corners in zip(np.ravel(numbers) if numbers is not None else (), found, strict=True)
            if int(number) in squares
        ]
        if len(read) >= ENOUGH:
            break
    return read


def square_px(board: Chessboard, markers: Sequence[Marker]) -> float:
    """Side of a square in the frame [px], at the median of markers."""
    sides = [np.linalg.norm(one.corners_px - np.roll(one.corners_px, 1, axis=0), axis=1).mean() for one in markers]
    return float(np.median(sides)) / _coded(board)[1].marker_share


def place_by_codes(patches: Sequence[Patch], markers: Sequence[Marker]) -> list[tuple[Patch, Placing]]:
    """Place all patches of lattice on which AGREE markers say the same."""
    placed = []
    for patch in patches:
        votes = Counter(placing for one in markers if (placing := _placing(patch, one)) is not None)
        if not votes:
            continue
        best, count = votes.most_common(1)[0]
        if count >= AGREE and count >= SHARE * votes.total():
            placed.append((patch, best))
    return placed


def _placing(patch: Patch, marker: Marker) -> Placing | None:
    """Placing of a patch by one marker; None if it is not on the patch, or not turned like it."""
    corners, middle = marker.corners_px, marker.corners_px.mean(axis=0)
    nearest = int(np.argmin(np.sum((patch.position_px - middle) ** 2, axis=1)))
    axes = patch.axes_px[nearest]
    place = np.linalg.solve(axes, middle - patch.position_px[nearest])
    right = np.linalg.solve(axes, corners[1] - corners[0] + corners[2] - corners[3])
    up = np.linalg.solve(axes, corners[0] - corners[3] + corners[1] - corners[2])
    if np.abs(place).max() > NEAR or min(np.linalg.norm(right), np.linalg.norm(up)) == 0.0:
        return None
    turn = np.rint(np.stack((right / np.linalg.norm(right), up / np.linalg.norm(up)), axis=1)).astype(int)
    (a, b), (c, d) = turn.tolist()
    if ((a, b), (c, d)) not in QUARTER_TURNS:
        return None
    cell = patch.index[nearest] + np.floor(place)
    i, j = np.rint(cell + 0.5 - turn @ (np.array(marker.square) + 0.5)).astype(int).tolist()
    return Placing(((a, b), (c, d)), (i, j))


def _coded(board: Chessboard) -> tuple[tuple[int, int], Codes, tuple[int, int]]:
    """Squares and codes of a board that has them, and its corner at the origin."""
    lines = board.outer_lines
    if board.codes is None or board.squares is None or lines is None:
        raise BoardError("a board with codes has so many squares")
    across, up = (-lines[0]).tolist()
    return board.squares, board.codes, (across, up)


@lru_cache(maxsize=4)
def _markers(board: Chessboard) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Number of the marker in every square (C, R), or -1; dark cells (N, n, n) of each, rows from the top."""
    import cv2

    counts, codes, (across, up) = _coded(board)
    names, squares = _dictionary(codes.dictionary), marker_squares(board)
    number = np.full(counts, -1, np.int64)
    for marker, (i, j) in squares.items():
        number[i + across, j + up] = marker
    cells = names.markerSize + 2
    every = range(max(squares) + 1)
    dark = [np.asarray(cv2.aruco.generateImageMarker(names, marker, cells), np.int64) == 0 for marker in every]
    return number, np.array(dark, dtype=bool)


@lru_cache(maxsize=4)
def _opencv_board(squares: tuple[int, int], codes: Codes) -> Any:  # noqa: ANN401 - OpenCV has no types
    """The board as OpenCV lays it out, in squares of 1.

    Raises
    ------
    BoardError
        OpenCV knows no such markers, or not so many.
    """
    import cv2

    try:
        return cv2.aruco.CharucoBoard(squares, 1.0, codes.marker_share, _dictionary(codes.dictionary))
    except cv2.error as error:
        raise BoardError(
            f"OpenCV lays out no charuco board of {squares[0]} x {squares[1]} squares with {codes.dictionary}"
            f" ({error.err}); give what it was printed with"
        ) from None


@lru_cache(maxsize=4)
def _dictionary(name: str) -> Any:  # noqa: ANN401 - OpenCV has no types
    """OpenCV's dictionary of markers."""
    import cv2

    number = getattr(cv2.aruco, name, None) if name.startswith("DICT_") else None
    if not isinstance(number, int):
        raise BoardError(f"OpenCV has no dictionary {name!r} of markers; one is DICT_4X4_1000")
    return cv2.aruco.getPredefinedDictionary(number)
