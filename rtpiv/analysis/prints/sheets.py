"""Contents of prints: sheets of dark shapes, or of particles, in mm about the origin of the scene.

    chessboard   squares of one side, four discs around the origin (`tracer.board`): no part of it but those
                 tells where it is, and behind a ball their view must be clear
    charuco      squares with a coded marker in every bright one (OpenCV's aruco): any corner beside two markers
                 says which one it is, so half of the board may be hidden
    dots         a square grid; three larger dots, (0, 0), (1, 0) and (0, 2), tell origin and turn
    particles    bright Gaussians on dark, at random: what a flow looks like, moved by a stage instead (the paper)

x goes to the right, y up, as the camera sees an upright board; the origin is an inner corner, or a dot.
"""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tracer.board import CHIRAL, LARGE_DOTS, Board
from tracer.errors import SceneError

Kind = Literal["chessboard", "charuco", "dots", "particles"]
Points = NDArray[np.float64]
Bounds = tuple[float, float, float, float]
MARKER = 0.7  # side of a marker in squares; 0.75 and more leave little white around it
DOT, LARGE_DOT = 0.4, 0.65  # diameters of dots in pitches
MOST_MARKERS = 1000  # of the largest set of 4 x 4 markers, whose cells are widest in print
PARTICLE_PX, PARTICLES_PER_PX = 3.0, 0.02  # as in the paper: diameter in the corrected image, and how many a pixel


@dataclass(frozen=True)
class PrintPage:
    """Shapes of one colour on a ground of the other.

    Parameters
    ----------
    kind : str
        As above.
    bounds_mm : (float, float, float, float)
        Left, lower, right and upper edge.
    polygons : list of (N, 2) float64
        Corners of dark areas [mm].
    discs : (M, 3) float64
        Centre and diameter [mm] of discs.
    disc_dark : (M,) bool
        Whether each is dark; drawn after the polygons.
    particles_mm : (P, 2) float64
        Centres of particles.
    particle_mm : float
        Their diameter, four standard deviations of the Gaussian.
    about : dict
        What the board file says besides the kind.
    """

    kind: Kind
    bounds_mm: Bounds
    polygons: list[Points] = field(default_factory=list)
    discs: Points = field(default_factory=lambda: np.zeros((0, 3)))
    disc_dark: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    particles_mm: Points = field(default_factory=lambda: np.zeros((0, 2)))
    particle_mm: float = 0.0
    about: dict[str, Any] = field(default_factory=dict)


def chessboard(size_mm: tuple[float, float], square_mm: float) -> PrintPage:
    """Return the board that `rtpiv calibrate` knows best: squares, and four discs around the origin.

    Parameters
    ----------
    size_mm : (float, float)
        Width and height; whole squares fill it.
    square_mm : float
        Side of a square.

    Returns
    -------
    PrintPage
        With discs of 0.4 squares.
    """
    board = Board(square_mm, round(0.4 * square_mm, 9), discs=CHIRAL)
    columns, rows = _whole(size_mm, square_mm, most=0)
    dark = [_box(i, j, square_mm) for i in range(*columns) for j in range(*rows) if (i + j) % 2 == 0]
    centres = (np.array(board.discs) + 0.5) * square_mm
    discs = np.column_stack((centres, np.full(len(centres), board.disc_mm)))
    on_bright = np.array(board.discs).sum(axis=1) % 2 == 1
    about: dict[str, Any] = {
        "square_mm": square_mm,
        "disc_mm": board.disc_mm,
        "discs": [list(square) for square in board.discs],
        "squares": [columns[1] - columns[0], rows[1] - rows[0]],
        "origin_corner": [-columns[0], -rows[0]],  # from the lower left corner of the board
    }
    return PrintPage("chessboard", _bounds(columns, rows, square_mm), dark, discs, on_bright, about=about)


def charuco(size_mm: tuple[float, float], square_mm: float, layout: str = "new") -> PrintPage:
    """Return a chessboard with a coded marker in each bright square, as OpenCV lays it out.

    Parameters
    ----------
    size_mm : (float, float)
        Width and height; whole squares fill it, as many as there are markers for.
    square_mm : float
        Side of a square.
    layout : {"new", "legacy"}
        Which squares carry markers where the number of rows is even.

    Returns
    -------
    PrintPage
        Its `about` has what `cv2.aruco.CharucoBoard` asks for, and the corner that is the origin.
    """
    import cv2

    columns, rows = _whole(size_mm, square_mm, most=2 * MOST_MARKERS)
    across, up = columns[1] - columns[0], rows[1] - rows[0]
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    board = cv2.aruco.CharucoBoard((across, up), square_mm, MARKER * square_mm, dictionary)
    board.setLegacyPattern(layout == "legacy")
    height_mm = up * square_mm
    to_ours = np.array([columns[0] * square_mm, rows[0] * square_mm])

    def ours(points: Points) -> Points:
        """OpenCV counts y downwards from the upper edge."""
        return np.asarray(np.column_stack((points[:, 0], height_mm - points[:, 1])) + to_ours)

    dark = []
    taken = {
        (int(x // square_mm), int(y // square_mm))
        for x, y in (np.asarray(corners)[:, :2].mean(axis=0) for corners in board.getObjPoints())
    }
    for i in range(across):
        for j in range(up):  # from the top
            if (i, j) not in taken:
                box = np.array([[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]], np.float64)
                dark.append(ours(box * square_mm))
    for number, corners in zip(np.ravel(board.getIds()), board.getObjPoints(), strict=True):
        bits = dictionary.generateImageMarker(int(number), dictionary.markerSize + 2)
        corner = np.asarray(corners, np.float64)[0, :2]
        cell = MARKER * square_mm / len(bits)
        for row, start, end in _dark_runs(np.asarray(bits) == 0):
            box = np.array([[start, row], [end, row], [end, row + 1], [start, row + 1]], np.float64)
            dark.append(ours(corner + box * cell))
    about: dict[str, Any] = {
        "square_mm": square_mm,
        "marker_mm": round(MARKER * square_mm, 9),
        "squares": [across, up],
        "dictionary": "DICT_4X4_1000",
        "layout": layout,
        "origin_corner": [-columns[0], -rows[0]],  # from the lower left corner of the board
    }
    return PrintPage("charuco", _bounds(columns, rows, square_mm), dark, about=about)


def dots(size_mm: tuple[float, float], pitch_mm: float) -> PrintPage:
    """Return a square grid of dots, three of them larger.

    Parameters
    ----------
    size_mm : (float, float)
        Width and height.
    pitch_mm : float
        From dot to dot.

    Returns
    -------
    PrintPage
        With dots of 0.4 pitches, the larger ones of 0.65.
    """
    columns, rows = _whole(size_mm, pitch_mm, most=0)
    i, j = np.meshgrid(np.arange(columns[0] + 1, columns[1]), np.arange(rows[0] + 1, rows[1]))
    index = np.column_stack((i.ravel(), j.ravel()))
    large = (index[:, None] == np.array(LARGE_DOTS)).all(axis=2).any(axis=1)
    discs = np.column_stack((index * pitch_mm, np.where(large, LARGE_DOT, DOT) * pitch_mm))
    about: dict[str, Any] = {
        "pitch_mm": pitch_mm,
        "dot_mm": round(DOT * pitch_mm, 9),
        "large_dot_mm": round(LARGE_DOT * pitch_mm, 9),
        "squares": [columns[1] - columns[0], rows[1] - rows[0]],  # a dot at each of their inner corners
        "origin_corner": [-columns[0], -rows[0]],
    }
    return PrintPage(
        "dots", _bounds(columns, rows, pitch_mm), discs=discs, disc_dark=np.ones(len(discs), bool), about=about
    )


def particles(size_mm: tuple[float, float], px_per_mm: float, seed: int) -> PrintPage:
    """Return random particles, as many and as wide in the corrected image as the paper's.

    Parameters
    ----------
    size_mm : (float, float)
        Width and height.
    px_per_mm : float
        Of the corrected image.
    seed : int
        The same seed prints the same sheet.

    Returns
    -------
    PrintPage
        0.02 particles a pixel, 3 px in diameter.
    """
    rng = np.random.default_rng(seed)
    count = rng.poisson(PARTICLES_PER_PX * px_per_mm**2 * size_mm[0] * size_mm[1])
    places = (rng.random((count, 2)) - 0.5) * size_mm
    diameter = round(PARTICLE_PX / px_per_mm, 9)
    about: dict[str, Any] = {"particles": count, "particle_mm": diameter, "seed": seed, "size_mm": list(size_mm)}
    right, upper = 0.5 * size_mm[0], 0.5 * size_mm[1]
    return PrintPage(
        "particles", (-right, -upper, right, upper), particles_mm=places, particle_mm=diameter, about=about
    )


def _whole(size_mm: tuple[float, float], side_mm: float, most: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last line of columns and rows of squares, the origin as near to the middle as lines lie."""
    across, up = (int(length / side_mm + 1e-9) for length in size_mm)
    if min(across, up) < 4:
        raise SceneError(
            f"{size_mm[0]:g} x {size_mm[1]:g} mm hold {across} x {up} squares of {side_mm:g} mm, and a board needs"
            " 4 x 4; take a larger paper, or smaller squares"
        )
    if most and across * up > most:
        fewer = (most / (across * up)) ** 0.5
        across, up = int(across * fewer), int(up * fewer)
    return (-(across // 2), across - across // 2), (-(up // 2), up - up // 2)


def _bounds(columns: tuple[int, int], rows: tuple[int, int], side_mm: float) -> Bounds:
    return columns[0] * side_mm, rows[0] * side_mm, columns[1] * side_mm, rows[1] * side_mm


def _box(i: int, j: int, side_mm: float) -> Points:
    return np.array([[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]], np.float64) * side_mm


def _dark_runs(dark: NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """Row, first and last column of cells that are dark side by side: fewer seams in print."""
    runs = []
    for row, line in enumerate(dark):
        edges = np.flatnonzero(np.diff(np.concatenate(([0], line.astype(np.int8), [0]))))
        runs += [(row, int(start), int(end)) for start, end in edges.reshape(-1, 2)]
    return runs
