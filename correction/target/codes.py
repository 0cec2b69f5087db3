"""ChArUco boards: in every bright square a marker that says which square it is (OpenCV's aruco).

A marker is read by OpenCV; what is used of it is its number and how it is turned.  Each marker that lies in the
middle of a square of a patch, as large as the patch says, puts the patch at one place of the board.  A patch is
placed when AGREE markers name one place and no other place is named but by a misread marker.

Boards with an even number of rows exist in two layouts, which exchange the squares that carry markers (OpenCV
before and since 4.6).  Where the board file does not name the layout, the one that the markers agree with is used.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.errors import BoardError, TargetNotFound
from correction.target.board_origin import Placing
from correction.target.chessboard import QUARTER_TURNS, Chessboard
from correction.target.lattice_growth import Patch
from tracer.board import Codes

AGREE = 2  # markers
MISREAD, SURE_OF_ONE = 0.04, 6  # share of markers that may be misread; of so many that agree, one anyway
CENTRED, AS_LARGE, ALONG = 0.15, 0.2, 0.97  # marker in its square: squares off, relative size, cosine to the axes
LAYOUTS = "new", "legacy"
# Readings of a frame: smallest window of the threshold [px], enlargement, markers with which no other is tried.
# One window is three times as fast as all of them; small or soft markers need an enlarged, sharpened copy.
READINGS = (23, 1, 10), (3, 1, SURE_OF_ONE), (3, 2, 0)
SHARPENED, SHARPENED_PX = 1.5, 1.5  # gain, and width of what is taken off [px of the frame]
CELL_PX, LIKELY = 3.0, 0.25  # width of a cell that is read in usual focus; share of bright squares that say it
DICTIONARIES = *(f"DICT_{n}X{n}_1000" for n in (4, 5, 6, 7)), "DICT_ARUCO_ORIGINAL"


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


def layouts_of(board: Chessboard) -> list[Chessboard]:
    """Return the board in each layout that there is of it: one, if the number of rows is odd."""
    squares, codes, _ = _codes_of(board)
    if squares[1] % 2:
        return [board]
    return [with_codes(board, replace(codes, layout=layout)) for layout in LAYOUTS]


def marker_squares(board: Chessboard) -> dict[int, tuple[int, int]]:
    """Number of each marker -> square of the board that it is in."""
    squares, codes, (across, up) = _codes_of(board)
    made = _opencv_board(squares, codes)
    found = {}
    for number, corners in zip(np.ravel(made.getIds()), made.getObjPoints(), strict=True):
        x, y = np.asarray(corners)[:, :2].mean(axis=0).tolist()
        found[int(number)] = int(x) - across, squares[1] - 1 - int(y) - up  # OpenCV counts rows from the top
    return found


def marker_cells(board: Chessboard, places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask of the dark cells of markers at places (..., 2) of a board, in squares from its origin."""
    squares, codes, origin = _codes_of(board)
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
    """A marker: its corners (4, 2) [px] from the upper left on, clockwise, and its number."""

    corners_px: NDArray[np.float64]
    number: int


def read_markers(frame: NDArray[Any], board: Chessboard, dictionary: str = "") -> list[Marker]:
    """Read the markers of a board in a frame (H, W), or all of another dictionary."""
    import cv2

    low, high = np.percentile(frame, (0.5, 99.5))
    grey = np.clip((frame.astype(np.float32) - low) * (255.0 / max(float(high - low), 1e-6)), 0.0, 255.0)
    known, read = marker_squares(board), list[Marker]()
    settings = cv2.aruco.DetectorParameters()
    settings.errorCorrectionRate = 0.0  # what is nearly a marker is none
    settings.adaptiveThreshWinSizeMax = max(window for window, _, _ in READINGS)
    reader = cv2.aruco.ArucoDetector(_dictionary(dictionary or _codes_of(board)[1].dictionary), settings)
    for window, times, enough in READINGS[:-1] if dictionary else READINGS:
        if times > 1:
            grey = cv2.resize(grey, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC)
            soft = cv2.GaussianBlur(grey, (0, 0), SHARPENED_PX * times)
            grey = np.clip(grey + SHARPENED * (grey - soft), 0.0, 255.0)
        settings.adaptiveThreshWinSizeMin = window
        reader.setDetectorParameters(settings)
        found, numbers, _ = reader.detectMarkers(grey.astype(np.uint8))
        again = [
            Marker((np.asarray(corners, dtype=np.float64).reshape(4, 2) + 0.5) / times - 0.5, int(number))
            for number, corners in zip(np.ravel(numbers) if numbers is not None else (), found, strict=True)
            if dictionary or int(number) in known
        ]
        read = max(read, again, key=len)
        if len(read) >= enough:
            break
    return read


def square_px(board: Chessboard, markers: Sequence[Marker]) -> float:
    """Side of a square in the frame [px], at the median of markers."""
    sides = [np.linalg.norm(one.corners_px - np.roll(one.corners_px, 1, axis=0), axis=1).mean() for one in markers]
    return float(np.median(sides)) / _codes_of(board)[1].marker_share


def place_by_codes(
    patches: Sequence[Patch], markers: Sequence[Marker], board: Chessboard
) -> list[tuple[Chessboard, list[tuple[Patch, Placing]]]]:
    """Place all patches of lattice on which markers agree.

    Returns
    -------
    list of (Chessboard, list of (Patch, Placing))
        The board in the layout that the markers show, and its patches; both layouts where markers that agree do
        not tell them apart, and none where nothing is placed.

    Raises
    ------
    TargetNotFound
        Markers contradict one another, or the layout that the board file names.
    """
    if not markers:
        return []
    counted = {one: [_votes(patch, markers, one) for patch in patches] for one in layouts_of(board)}
    agreeing = {one: sum(max(votes.values(), default=0) for votes in found) for one, found in counted.items()}
    most, named = max(agreeing.values()), _codes_of(board)[1].layout
    best = [one for one, count in agreeing.items() if count == most]
    if named and board in counted:
        if board not in best:
            raise TargetNotFound(
                f"the markers lie in other squares than in layout {named}, which the board file names: {most}"
                f" agree with layout {_codes_of(best[0])[1].layout}; give that one"
            )
        best = [board]
    placed = [(one, _place_by_markers(patches, counted[one], one)) for one in best]
    reasons = [found for _, found in placed if isinstance(found, str)]
    if len(reasons) == len(placed):
        raise TargetNotFound(reasons[0])
    return [(one, found) for one, found in placed if found and not isinstance(found, str)]


def _place_by_markers(
    patches: Sequence[Patch], counted: Sequence[Counter[Placing]], board: Chessboard
) -> list[tuple[Patch, Placing]] | str:
    """Patches with the places that their markers give them, or why these contradict each other."""
    placed = []
    for patch, votes in zip(patches, counted, strict=True):
        counts = votes.most_common()
        if not counts or counts[0][1] < AGREE:
            continue
        (placing, count), *others = counts
        against = sum(other for _, other in others)
        if against > max(count >= SURE_OF_ONE, MISREAD * count) or any(other >= AGREE for _, other in others):
            return _contradiction(board, count, against)
        placed.append((patch, placing))
    return placed


def _contradiction(board: Chessboard, count: int, against: int) -> str:
    """Say that markers name several places, with what usually is the cause."""
    (columns, rows), codes, _ = _codes_of(board)
    layout = f" in layout {codes.layout}" if codes.layout else ""
    if count < SURE_OF_ONE:
        return (
            f"{count} markers agree where the board is, and {against} contradict them: so few may be misread, as"
            " in a soft or mirrored view; bring more light or a sharper focus, so that more markers are read, or"
            " check squares, dictionary and layout in board.yaml"
        )
    return (
        f"{count} markers agree where the board is, and {against} are in other squares than on a board of"
        f" {columns} x {rows} squares{layout}: check squares, dictionary and layout (new, or legacy: OpenCV before"
        " 4.6, calib.io) in board.yaml"
    )


def why_no_codes(frame: NDArray[Any], board: Chessboard, markers: Sequence[Marker], patch: Patch) -> str:
    """Say why markers place nothing of a patch: too few, those of another dictionary, or mirrored ones."""
    _, codes, _ = _codes_of(board)
    mirrored = why_mirrored(frame, board, markers, patch)
    if mirrored:
        return mirrored
    least = _least_other(markers, patch)
    for other in DICTIONARIES:
        found = [] if other == codes.dictionary else read_markers(frame, board, other)
        if len(found) > least:
            return (
                f"the frame shows {len(found)} markers of {other}, and the board file names {codes.dictionary};"
                " give the dictionary that the board was printed with"
            )
    cell_px = np.linalg.norm(patch.axes_px, axis=1).mean() * codes.marker_share
    cell_px /= _dictionary(codes.dictionary).markerSize + 2
    cause = f"their cells are {cell_px:.1f} px wide, {CELL_PX:g} px are needed: " if cell_px < CELL_PX else ""
    cure = "use larger squares or more magnification" if cause else "check focus, light and glare"
    return (
        f"{len(markers)} markers of the board could be read, which are too few to tell which squares are in view;"
        f" {cause}{cure}, or give the dictionary that it was printed with"
    )


def why_mirrored(frame: NDArray[Any], board: Chessboard, markers: Sequence[Marker], patch: Patch) -> str:
    """Say that a frame shows more markers from right to left; "" where it does not."""
    mirrored = read_markers(np.ascontiguousarray(frame[:, ::-1]), board)
    if len(mirrored) <= _least_other(markers, patch):
        return ""
    return (
        f"the frame is a mirror image: {len(mirrored)} markers can be read in it only from right to left; set"
        " ReverseX or ReverseY of the camera back, or mirrored: true in the camera section of the scene where"
        " it looks at the target by a mirror"
    )


def _least_other(markers: Sequence[Marker], patch: Patch) -> float:
    """Return the number that other markers must exceed: small or soft cells are misread as a few of any kind."""
    return max(AGREE, 2 * len(markers), LIKELY * 0.5 * len(patch.index))


def _votes(patch: Patch, markers: Sequence[Marker], board: Chessboard) -> Counter[Placing]:
    """Count the markers in squares of a patch by where on the board they put it."""
    squares = marker_squares(board)
    return Counter(
        placing for one in markers if (placing := _placing(patch, one, squares[one.number])) is not None
    )


def _placing(patch: Patch, marker: Marker, square: tuple[int, int]) -> Placing | None:
    """Placing of a patch by one marker; None if it is in no square of the patch, or of another size or turn."""
    corners, middle = marker.corners_px, marker.corners_px.mean(axis=0)
    nearest = int(np.argmin(np.sum((patch.position_px - middle) ** 2, axis=1)))
    axes = patch.axes_px[nearest]
    place = np.linalg.solve(axes, middle - patch.position_px[nearest])
    if np.abs(np.abs(place) - 0.5).max() > CENTRED:
        return None
    right = np.linalg.solve(axes, corners[1] - corners[0] + corners[2] - corners[3])
    up = np.linalg.solve(axes, corners[0] - corners[3] + corners[1] - corners[2])
    sides = np.stack((right, up), axis=1)
    length = np.linalg.norm(sides, axis=0)
    if length.min() == 0.0:
        return None
    turn = np.rint(sides / length).astype(int)
    (a, b), (c, d) = turn.tolist()
    if ((a, b), (c, d)) not in QUARTER_TURNS or ((sides / length) * turn).sum(axis=0).min() < ALONG:
        return None
    cell = patch.index[nearest] + np.floor(place)
    i, j = np.rint(cell + 0.5 - turn @ (np.array(square) + 0.5)).astype(int).tolist()
    return Placing(((a, b), (c, d)), (i, j))


def _codes_of(board: Chessboard) -> tuple[tuple[int, int], Codes, tuple[int, int]]:
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

    counts, codes, (across, up) = _codes_of(board)
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
        board = cv2.aruco.CharucoBoard(squares, 1.0, codes.marker_share, _dictionary(codes.dictionary))
    except cv2.error as error:
        raise BoardError(
            f"OpenCV lays out no charuco board of {squares[0]} x {squares[1]} squares with {codes.dictionary}"
            f" ({error.err}); give what it was printed with"
        ) from None
    board.setLegacyPattern(codes.layout == "legacy")
    return board


@lru_cache(maxsize=4)
def _dictionary(name: str) -> Any:  # noqa: ANN401 - OpenCV has no types
    """OpenCV's dictionary of markers."""
    import cv2

    number = getattr(cv2.aruco, name, None) if name.startswith("DICT_") else None
    if not isinstance(number, int):
        raise BoardError(f"OpenCV has no dictionary {name!r} of markers; one is DICT_4X4_1000")
    return cv2.aruco.getPredefinedDictionary(number)
