"""Plates with staggered rows, two levels, squares, triangles, missing dots or no mark: found, or refused."""

from collections import Counter
from dataclasses import replace

import cv2
import numpy as np
import pytest

from correction.errors import BoardError, FitFailed, TargetNotFound
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.fit.seen.prediction import expect
from correction.target import Chessboard
from correction.target.board_file import PrintedBoard
from correction.target.board_search import find_board, track_board
from correction.target.makers import LAVISION
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import DotGrid, Plate
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import errors_behind
from tests.correction.target.drawn_plates import drawn, printed
from tests.correction.target.test_uniform_grids import View, centre_of_picture, rim
from tests.slow_cases import slow_but
from tracer.board import Dots
from tracer.strategies.sensitivity import TargetPose

FILE = {"kind": "dots", "pitch_mm": 10.0, "dot_mm": 2.2, "rows": "staggered"}
BY_NAME = {"plate": "lavision-106-10", "dot_mm": 2.2}
MARKS = {"square": [-30.0, -5.0], "triangle": [20.0, 5.0]}


@pytest.mark.parametrize("seed", slow_but((7, 8, 11, 13, 16, 18), 7, 13))
def test_a_plate_drawn_at_random_is_found_where_it_is(seed):
    found, off = drawn(seed).find()
    assert len(found) > 80
    assert np.sqrt(np.mean(off**2) / 2.0) < 0.035
    assert off.max() < 0.3


@pytest.mark.slow
def test_of_600_plates_drawn_at_random_none_is_in_a_wrong_place():
    verdicts, rms = Counter(), []
    for seed in range(600):
        one = drawn(seed)
        try:
            off = one.find()[1]
        except TargetNotFound:
            verdicts["refused"] += 1
            continue
        verdicts["right" if np.median(off) < 0.3 else "wrong"] += 1
        rms.append(float(np.sqrt(np.mean(off**2) / 2.0)))
    assert not verdicts["wrong"], verdicts
    assert verdicts["refused"] <= 3, verdicts
    assert np.median(rms) < 0.03


def test_a_plate_that_hangs_upside_down_is_named_by_its_triangle():
    one = drawn(13)
    with pytest.raises(TargetNotFound, match=r"is turned by [+-]1[678]\d degrees"):
        replace(one, image=np.ascontiguousarray(one.image[::-1, ::-1])).find()
    assert not one.board.is_turn_symmetric
    assert len(find_board(one.image, one.board)) > 80  # no prediction is needed


@pytest.mark.parametrize(
    ("disc", "axis", "sign", "refused"),
    [((-3, 1), 0, 1, ""), ((0, -3), 1, -1, ""), ((0, -3), 1, 1, "at the border of the frame")],
)
def test_a_mark_whose_outermost_dot_the_frame_cuts_shows_the_origin_or_is_named(disc, axis, sign, refused):
    one = drawn(13)
    corners = np.array(disc) + np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    around = one.true.project(one.board.place_mm(corners))[:, axis]
    last = (sign * around).min() * sign
    border = round(0.55 * last + 0.45 * around.mean())
    cut = np.moveaxis(one.image, 1 - axis, 0)[border if sign > 0 else 0 : None if sign > 0 else border]
    image = np.ascontiguousarray(np.moveaxis(cut, 0, 1 - axis))
    if refused:
        with pytest.raises(TargetNotFound, match=refused):
            find_board(image, one.board)
        return
    found = find_board(image, one.board)
    off = found.position_px - one.true.project(found.board.place_mm(found.index))
    off[:, axis] += border if sign > 0 else 0
    assert len(found) > 80
    assert np.abs(off).max() < 0.3


def test_marks_that_are_not_in_view_and_dots_without_any_are_refused_with_the_cure():
    one = drawn(13)
    with pytest.raises(TargetNotFound, match="not the 2 interstitial marks that mark the origin"):
        replace(one, board=replace(one.board, discs=((-3, 1), (0, -4)))).find()
    dots = replace(one.board.dots, marks="large", triangle=None)
    with pytest.raises(TargetNotFound, match=r"half pitches and rows of dots are in the frame.*origin_px"):
        replace(one, board=replace(one.board, discs=(), dots=dots)).find()


def test_the_asymmetric_grid_of_opencv_is_found_as_opencv_finds_it():
    """Drawn by polygons, 4 dots a row and 11 rows, at OpenCV's object points (2 j + i % 2, i)."""
    half_mm, fine, size = 6.0, 8, (640, 512)
    view = View((0.25, -0.3, 0.1), (-20.0, -31.0))
    place = np.array([((2 * j + i % 2) * half_mm, i * half_mm) for i in range(11) for j in range(4)])
    picture, centres = np.full((size[1] * fine, size[0] * fine), 255, np.uint8), []
    for at in place:
        outline = view.project(rim(at, 4.5))
        centres.append(centre_of_picture(outline))
        cv2.fillPoly(picture, [np.rint(((outline + 0.5) * fine - 0.5) * 256.0).astype(np.int32)], 0, shift=8)
    frame = cv2.GaussianBlur(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), (0, 0), 0.8)
    board = PrintedBoard(
        **FILE | {"pitch_mm": 2.0 * half_mm, "dot_mm": 4.5}, squares=[9, 12], origin_corner=[1, 1]
    )
    nominal = View((0.25, -0.3, 0.0), (-12.0, -25.0))  # a pitch aside
    found = track_board(frame, board.board(), nominal.project, reach=3.0)
    assert found.origin_basis == "the number of its rows and columns"
    assert len(found) == 44
    away = np.linalg.norm(found.plane_mm[:, None] - place, axis=-1)
    assert away.min(axis=1).max() < 1e-9
    off = found.position_px - np.array(centres)[away.argmin(axis=1)]
    assert np.sqrt(np.mean(off**2)) < 0.02
    seen, theirs = cv2.findCirclesGrid(frame, (4, 11), flags=cv2.CALIB_CB_ASYMMETRIC_GRID)
    assert seen
    between = np.linalg.norm(theirs.reshape(-1, 1, 2) - found.position_px, axis=-1)
    assert between.min(axis=1).max() < 0.3


def test_plates_by_name_are_what_their_names_say():
    for name, (pitch_mm, step_mm) in LAVISION.items():
        assert name.endswith(f"-{pitch_mm:g}")
        board = PrintedBoard(plate=name, dot_mm=0.2 * pitch_mm).board()
        assert board.pitch_mm == pytest.approx(pitch_mm)
        assert board.depth_mm([(0, 0), (1, 0), (1, 1), (0, -1)]).tolist() == [0.0, step_mm, 0.0, step_mm]
        near = board.corner_mm([(1, 0), (0, 1), (1, -1), (1, 1)]) / pitch_mm
        assert near == pytest.approx(np.array([(0.5, 0.5), (-0.5, 0.5), (1.0, 0.0), (0.0, 1.0)]))
    board = PrintedBoard(**BY_NAME, step_mm=-2.1, marks_mm=MARKS).board()
    assert board.dots == Dots(2.2, True, "staggered", -2.1, "between", (2, -2))
    assert board.discs == ((-4, 2), (2, -2))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"plate": "lavision-100-7"}, "no plate 'lavision-100-7' is known; say one of lavision-025-3.3"),
        ({"marks_mm": MARKS, "origin_px": [1.0, 2.0]}, "say one of them"),
        ({"levels": "columns"}, "change from row to row"),
        ({"marks_mm": {"square": [-30.0, 0.0]}}, "0.5 pitches off the middle of four dots"),
        ({"missing_dots": [[1, 0]]}, "no dot stands there"),
        ({"large_dot_mm": 4.0}, "say large_dots of staggered rows"),
    ],
    ids=str,
)
def test_a_plate_that_contradicts_itself_is_refused(wrong, words):
    with pytest.raises((ValueError, BoardError), match=words):
        PrintedBoard(**BY_NAME | wrong).board()


def test_staggered_rows_are_drawn_by_their_definition():
    """Pitch 4 mm, rows 2 mm apart; a ray leans by 0.3 mm a step along y."""
    words = {"discs": ((1, 1), (2, 0)), "staggered": True}
    side = 4.0 / np.sqrt(2.0)
    flat = DotGrid(side, 1.2, dots=Dots(0.8, True), dark=0.1, bright=0.9, **words)
    on = [(0.0, 0.0), (4.0, 0.3), (2.0, 2.0), (-2.3, 2.0), (0.5, 4.0), (4.0, 4.5), (0.0, -4.0)]
    beside = [(2.0, 0.0), (0.0, 2.0), (4.0, 0.5), (0.0, 0.45)]
    assert flat.reflectance(np.array(on + beside)) == pytest.approx([0.9] * len(on) + [0.1] * 4)
    plate = Plate(side, 1.2, dots=Dots(0.8, True, "staggered", 1.0), dark=0.1, bright=0.9, **words)
    face = np.array([(0.0, 0.0), (2.0, 2.0), (2.0, 1.5), (2.0, 2.9)])
    assert plate.shade(face, face + np.array((0.0, 0.3))) == pytest.approx([0.9, 0.9, 0.9, 0.03])
    marked = DotGrid(side, 0.8, dots=Dots(0.8, True, marks="between", triangle=(1, 0)), dark=0.1, bright=0.9,
                     discs=((0, 0), (1, 0)), staggered=True)  # fmt: skip
    inside, beyond = [(0.3, 2.3), (2.0, 4.6), (2.3, 3.75)], [(0.38, 2.0), (2.3, 4.3)]
    assert marked.reflectance(np.array(inside + beyond)) == pytest.approx([0.9] * 3 + [0.1] * 2)


@pytest.mark.parametrize("levels", ["", "staggered"])
def test_staggered_dots_are_expected_where_a_ray_from_them_is_seen(levels):
    scene = misalign(at_size(demo_scene("two_spheres_500"), 504), 4).with_bodies(())
    dots = Dots(1.8, True, levels, 1.5 if levels else 0.0)
    board = Chessboard(5.0, 1.8, discs=(), dots=dots, staggered=True, scale=(1.01, 0.98))
    shown = expect(scene, TargetPose(), board)
    assert len(shown) > 100
    off = shown.pixel - scene.camera.project(board.place_mm(shown.index))
    assert np.abs(off).max() < 1e-3
    ahead = np.stack([board.place_mm(shown.index + step) for step in ((1, 0), (0, 1))], axis=1)
    ahead[..., 2] = board.place_mm(shown.index)[:, None, 2]
    axes = (scene.camera.project(ahead.reshape(-1, 3)).reshape(-1, 2, 2) - shown.pixel[:, None]).transpose(0, 2, 1)
    assert np.abs(axes - shown.axes_px).max() < 0.02 * np.abs(axes).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("levels", "discs", "marks", "scale"),
    [
        ("staggered", ((-3, 1), (0, -3)), "between", (1.0, 1.0)),
        ("", ((0, 0),), "large", (1.004, 0.997)),
        ("", ((0, 0), (2, 1)), "missing", (1.0, 1.0)),
    ],
)
def test_the_map_behind_two_balls_is_right_by_staggered_rows(levels, discs, marks, scale):
    dots = Dots(1.44, True, levels, 1.0 if levels else 0.0, marks, discs[1] if marks == "between" else None)
    board = Chessboard(4.0, 2.2 if marks == "large" else 1.44, discs=discs, dots=dots, staggered=True,
                       scale_sigma=(3e-3, 3e-3), step_sigma_mm=0.01)  # fmt: skip
    nominal = at_size(demo_scene("two_spheres_500"), 504)
    truth, paper = misalign(nominal, 3), replace(printed(board), scale=scale)
    frames = [
        TargetFrame("clear", render(truth.with_bodies(()), paper, Sensor(), samples=4, seed=1), False),
        TargetFrame("glass", render(truth, paper, Sensor(), samples=4, seed=2), True),
    ]
    fit = fit_scene(nominal, frames, board)
    error, _, compared = errors_behind(fit, truth)
    assert not fit.verdict.unlisted
    assert compared > 0.99
    assert np.sqrt(np.mean(error**2)) < 0.1  # seeds 3 and 4: 0.041 to 0.091 px, from frames of this size
    assert fit.board.scale == pytest.approx(scale, abs=1.5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shown_mm", "told_mm", "words"),
    [
        (1.2, 1.0, r"by rows, the other one 1\.(19|20)\d* mm behind .* say levels: rows and step_mm: 1\.(19|20)"),
        (1.2, 0.0, "by rows, .* the board file says nothing of levels"),
        (0.0, 1.2, "the frames show all dots on one level"),
    ],
)
def test_levels_of_staggered_rows_that_are_said_wrong_are_named(shown_mm, told_mm, words):
    def board(step_mm):
        dots = Dots(1.8, True, "staggered" if step_mm else "", step_mm)
        words = {"discs": ((0, 0), (1, 0), (0, 2)), "dots": dots, "staggered": True}
        return Chessboard(5.0, 2.7, **words, scale_sigma=(1e-4, 1e-4), step_sigma_mm=0.01)

    nominal = at_size(demo_scene("two_spheres_500"), 360)
    scene = misalign(nominal, 3).with_bodies(())
    frame = TargetFrame("clear", render(scene, printed(board(shown_mm)), Sensor(), samples=4, seed=1), False)
    with pytest.raises(FitFailed, match=words):
        fit_scene(nominal.with_bodies(()), [frame], board(told_mm))
