"""ChArUco boards of both layouts, and boards that are not what their file says: right, or refused with the cause.

Drawn by OpenCV, straight from the front: its pictures share nothing with what reads them.
"""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from correction.errors import TargetNotFound
from correction.target.board_file import PrintedBoard, read_board
from correction.target.board_search import find_board, track_board
from tests.correction.target.photographs import FOLDER
from tests.slow_cases import slow

NAMES = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
SIDE_PX, MARGIN = 36, 2  # of a square, and squares of paper around
MIDDLE = 0.37, -0.21  # of the origin, from a whole pixel


@cache
def drawn(columns, rows, legacy, noise=2.0):
    """A board from the front; with a function from its points [mm], squares of 1 mm, to pixels."""
    board = cv2.aruco.CharucoBoard((columns, rows), 1.0, 0.7, NAMES)
    board.setLegacyPattern(legacy)
    fine = 4 * SIDE_PX
    print_ = np.full(((rows + 2 * MARGIN) * fine, (columns + 2 * MARGIN) * fine), 255, np.uint8)
    print_[MARGIN * fine : -MARGIN * fine, MARGIN * fine : -MARGIN * fine] = board.generateImage(
        (columns * fine, rows * fine), marginSize=0
    )
    shifted = cv2.warpAffine(
        print_, np.array([(1.0, 0.0, 4.0 * MIDDLE[0]), (0.0, 1.0, 4.0 * MIDDLE[1])]), print_.shape[::-1],
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    seen = cv2.GaussianBlur(shifted, (0, 0), 3.0).reshape(print_.shape[0] // 4, 4, -1, 4).mean(axis=(1, 3))
    image = 30.0 + 0.75 * seen + np.random.default_rng(1).normal(0.0, noise, seen.shape)
    across, up = columns // 2, rows // 2

    def project(places_mm):
        x, y = np.asarray(places_mm, float)[:, 0], np.asarray(places_mm, float)[:, 1]
        u = (x + across + MARGIN) * SIDE_PX - 0.5 + MIDDLE[0]
        return np.column_stack((u, (MARGIN + rows - up - y) * SIDE_PX - 0.5 + MIDDLE[1]))

    image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    image.flags.writeable = False  # shared by all that ask for it
    return image, project


def oblique(side, tilt_deg, blur, noise, quality, columns=9, rows=8):
    """A legacy board seen at an angle, points of its print sampled 5 x 5 to a pixel; and its corners [px]."""
    board = cv2.aruco.CharucoBoard((columns, rows), 1.0, 0.7, NAMES)
    board.setLegacyPattern(True)
    print_ = board.generateImage((columns * 96, rows * 96), marginSize=0)
    width, height = round((columns + 3.5) * side), round((rows + 3.5) * side)
    turn = cv2.Rodrigues(np.deg2rad((0.7 * tilt_deg, 0.7 * tilt_deg, 12.0)))[0]
    lens = np.array([(17.0 * side, 0, 0.5 * width - 0.31), (0, 17.0 * side, 0.5 * height - 0.77), (0, 0, 1)])
    view = lens @ np.column_stack((turn[:, :2], (0.0, 0.0, 17.0)))
    view = view @ np.array([(1, 0, -0.5 * columns), (0, 1, -0.5 * rows), (0, 0, 1)])
    seen, back = np.zeros((height, width)), np.linalg.inv(view)
    v, u = np.indices(seen.shape)
    for du, dv in np.mgrid[-2:3, -2:3].reshape(2, -1).T / 5.0:
        x, y, z = back @ np.stack((u + du, v + dv, np.ones_like(u))).reshape(3, -1)
        i, j = np.floor(96 * x / z).astype(int), np.floor(96 * y / z).astype(int)
        there = (i >= 0) & (i < 96 * columns) & (j >= 0) & (j < 96 * rows)
        seen += np.where(there, print_[np.where(there, j, 0), np.where(there, i, 0)], 255).reshape(seen.shape) / 25
    image = 30.0 + 0.75 * cv2.GaussianBlur(seen, (0, 0), blur)
    image = np.clip(np.rint(image + np.random.default_rng(1).normal(0.0, noise, seen.shape)), 0, 255).astype(
        np.uint8
    )
    if quality:
        image = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 0)
    corners = {}
    for i in range(1, columns):
        for j in range(1, rows):
            x, y, z = view @ (i, j, 1.0)
            corners[i - columns // 2, rows - j - rows // 2] = x / z, y / z
    return image, corners


@pytest.mark.parametrize(
    ("side", "tilt_deg", "blur", "noise", "quality", "off_px"),
    [
        (16, 25, 0.7, 2, 0, 0.03),
        (28, 30, 1.0, 3, 75, 0.04),
        slow(40, 25, 2.0, 2, 0, 0.03),
        slow(48, 0, 1.0, 2, 30, 0.03),
    ],
)
def test_corners_beside_markers_lie_where_they_were_drawn(side, tilt_deg, blur, noise, quality, off_px):
    """OpenCV's cornerSubPix lies 0.1 to 0.5 px beside: markers reach into its window of half a square."""
    image, corners = oblique(side, tilt_deg, blur, noise, quality)
    found = find_board(image, told(9, 8))
    assert len(found) == len(corners) == 56
    truth = np.array([corners[i, j] for i, j in found.index.tolist()])
    ours = np.linalg.norm(found.position_px - truth, axis=1)
    assert np.median(ours) < off_px
    assert ours.max() < 4.0 * off_px
    half, stop = max(3, side // 4), (3, 100, 1e-4)
    theirs = cv2.cornerSubPix(image, np.array(truth[:, None], np.float32), (half, half), (-1, -1), stop)
    assert np.median(np.linalg.norm(theirs[:, 0] - truth, axis=1)) > 3.0 * np.median(ours)


def told(columns, rows, layout=None, dictionary="DICT_5X5_100", **more):
    """The board as its file describes it."""
    file = PrintedBoard(
        kind="charuco", square_mm=1.0, marker_mm=0.7, squares=[columns, rows], dictionary=dictionary,
        origin_corner=[columns // 2, rows // 2], layout=layout, **more,
    )  # fmt: skip
    return file.board()


@pytest.mark.parametrize(("columns", "rows"), [(9, 8), slow(12, 10), (11, 7)])
@pytest.mark.parametrize("legacy", [True, False])
def test_the_layout_is_seen(columns, rows, legacy):
    image, project = drawn(columns, rows, legacy)
    layout = ("legacy" if legacy else "new") if rows % 2 == 0 else ""
    for board in (told(columns, rows), told(columns, rows, layout or None)):
        found = find_board(image, board)
        assert len(found) == (columns - 1) * (rows - 1)
        assert np.abs(found.position_px - project(found.plane_mm)).max() < 0.2
        assert found.board.codes.layout == layout


@pytest.mark.parametrize("legacy", [True, slow(False)])
def test_another_layout_than_described_is_named(legacy):
    image, _ = drawn(11, 8, legacy)
    shown, described = ("legacy", "new") if legacy else ("new", "legacy")
    with pytest.raises(TargetNotFound, match=f"layout {described}, which.* agree with layout {shown}; give that"):
        find_board(image, told(11, 8, described))
    found = find_board(image, told(11, 8, shown))  # as advised
    assert len(found) == 70


def test_a_board_that_rtpiv_printed_before_it_named_layouts_is_a_new_one():
    assert told(11, 8, bars_mm=[5.0, 5.0]).codes.layout == "new"


def test_a_part_of_a_board_that_shows_no_layout_is_refused_and_read_with_the_layout_given():
    image, project = drawn(11, 8, True)
    part = image.copy()
    part[:, : 4 * SIDE_PX] = part[:, -5 * SIDE_PX :] = 90  # neither end of a row
    with pytest.raises(TargetNotFound, match=r"agree with both layouts of the board.*give its layout"):
        find_board(part, told(11, 8))
    found = find_board(part, told(11, 8, "legacy"))
    assert np.abs(found.position_px - project(found.plane_mm)).max() < 0.2
    nearby = track_board(part, told(11, 8), project, reach=0.4)
    assert np.abs(nearby.position_px - project(nearby.plane_mm)).max() < 0.2


SQUARES_OFF = [((0, 1), True), ((1, 0), False)]  # a row more, and a column
MORE_OFF = [
    slow((0, -2), False),
    slow((-1, 0), True),
    slow((2, 0), True),
    slow((0, -1), False),
    slow((0, 2), True),
]


@pytest.mark.parametrize(("by", "legacy"), [*SQUARES_OFF, *MORE_OFF])
def test_a_wrong_number_of_squares_is_refused(by, legacy):
    image, project = drawn(11, 8, legacy)
    with pytest.raises(TargetNotFound, match=r"check squares|count its (rows|columns)"):
        track_board(image, told(11 + by[0], 8 + by[1]), project, reach=6.0)


@pytest.mark.slow
def test_a_wrong_dictionary_is_named():
    image, _ = drawn(9, 8, False)
    with pytest.raises(TargetNotFound, match=r"shows \d+ markers of DICT_5X5_1000, .* names DICT_4X4_1000"):
        find_board(image, told(9, 8, dictionary="DICT_4X4_1000"))


def test_markers_that_are_too_soft_to_be_read_are_refused_and_read_once_they_are_sharp():
    image, _ = drawn(9, 8, False)
    with pytest.raises(TargetNotFound, match=r"^0 markers of the board could be read.*check focus"):
        find_board(cv2.GaussianBlur(image, (0, 0), 5.0), told(9, 8))
    assert len(find_board(image, told(9, 8))) == 56


@pytest.mark.parametrize("turn", [lambda image: image[:, ::-1], slow(np.flipud), slow(np.transpose)])
def test_markers_show_a_mirror_image(turn):
    image, _ = drawn(9, 8, True)
    with pytest.raises(TargetNotFound, match=r"is a mirror image: \d+ markers.*ReverseX"):
        find_board(np.ascontiguousarray(turn(image)), told(9, 8))


def test_a_board_upside_down_is_named_with_its_turn():
    image, project = drawn(9, 8, True)
    with pytest.raises(TargetNotFound, match=r"turned by [+-]180 degrees"):
        track_board(np.ascontiguousarray(image[::-1, ::-1]), told(9, 8), project, reach=6.0)


def test_a_digital_board_is_read_from_paper_at_full_scale():
    board = cv2.aruco.CharucoBoard((9, 8), 1.0, 0.7, NAMES)
    image = np.full((8 * 40 + 80, 9 * 40 + 80), 255, np.uint8)
    image[40:-40, 40:-40] = board.generateImage((360, 320), marginSize=0)
    assert np.mean(image == 255) > 0.33
    found = find_board(image, told(9, 8))
    u, v = found.position_px.T
    assert len(found) == 56
    assert np.abs(u - (40 * (found.index[:, 0] + 4) + 39.5)).max() < 0.1
    assert np.abs(v - (40 * (4 - found.index[:, 1]) + 39.5)).max() < 0.1


@pytest.mark.skipif(not FOLDER.is_dir(), reason="photographs of boards are not beside this checkout")
def test_photographs_of_a_legacy_board_are_in_place():
    """OpenCV says which corner is which; its corners scatter by 0.2 to 0.35 px, three times as much."""
    board = read_board(FOLDER / "pivlab_charuco" / "board.yaml").board()
    judge = cv2.aruco.CharucoBoard(
        board.squares, 8.0, 6.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    )
    judge.setLegacyPattern(True)
    for path in sorted((FOLDER / "pivlab_charuco").glob("[mt]*.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        found = find_board(image, board)
        assert found.board == replace(found.board, codes=replace(board.codes, layout="legacy"))
        seen, numbers, _, _ = cv2.aruco.CharucoDetector(judge).detectBoard(image)
        there = {
            (int(n) % 10 + 1 - 5, 7 - int(n) // 10 - 4): place
            for n, place in zip(numbers.ravel(), seen.reshape(-1, 2), strict=True)
        }
        common = [n for n, (i, j) in enumerate(found.index.tolist()) if (i, j) in there]
        theirs = np.array([there[i, j] for i, j in found.index[common].tolist()])
        assert len(common) > 20
        assert np.median(np.linalg.norm(found.position_px[common] - theirs, axis=1)) < 0.5, path.name
        assert _scatter(found.index[common], found.position_px[common]) < 0.15, path.name
        assert _scatter(found.index[common], found.position_px[common]) < 0.5 * _scatter(
            found.index[common], theirs
        )


def _scatter(index, place):
    """Rms of places about a smooth map of order 3 [px]."""
    x, y = (index / 5.0).T
    terms = np.stack([x**k * y**m for k in range(4) for m in range(4 - k)], axis=-1)
    off = place - terms @ np.linalg.lstsq(terms, place, rcond=None)[0]
    return float(np.sqrt(np.sum(off**2) / 2.0 / (len(place) - terms.shape[1])))
