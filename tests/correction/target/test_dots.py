"""Grids of dots are found by their large dots where they hang, or refused; none is moved by a pitch."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import BoardError, TargetNotFound
from correction.target import Chessboard
from correction.target.board_search import find_board, track_board
from correction.target.corners import CornerReason, CornerSearch
from correction.target.marks import find_marks, refine_marks
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.patterns import DotGrid, Pose
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.target.drawn_boards import NOMINAL, camera, counted
from tests.slow_cases import slow_but
from tracer.board import LARGE_DOTS, Dots
from tracer.scene.scene import Scene

PITCH_MM = 3.0
WORDS = {"discs": LARGE_DOTS, "dots": Dots(0.4 * PITCH_MM), "squares": (14, 12)}
GRID = Chessboard(PITCH_MM, 0.65 * PITCH_MM, **WORDS)
FEW = (1, 4, 5, 8, 11)  # found and refused, bare and behind balls


def predict(place_mm):
    return NOMINAL.project(place_mm)


def seen(true=NOMINAL, **changed):
    """A frame of the bare grid."""
    paper = replace(DotGrid(PITCH_MM, 0.65 * PITCH_MM, **WORDS), **changed)
    return render(Scene(true, ()), paper, Sensor(), samples=4, seed=1)


@pytest.mark.slow
def test_of_some_drawn_grids_none_is_wrong():
    count, wrong, rms = counted("dots", FEW)
    assert not wrong
    assert count["right"] > 1
    assert np.median(rms) < 0.03


@pytest.mark.slow
def test_of_three_hundred_drawn_grids_none_is_wrong():
    count, wrong, rms = counted("dots", range(300))
    assert not wrong
    assert count["right"] > 180, count  # large dots of the others are hidden, or out of the frame
    assert np.median(rms) < 0.03


@pytest.mark.parametrize("away", slow_but([(0, 0), (1, 0), (0, -2)], (0, -2)))
def test_a_camera_that_is_believed_a_pitch_aside_moves_no_dot(away):
    x, y = PITCH_MM * np.array(away)
    true = camera((x, y, 300.0), (x, y), 0.02)
    found = track_board(seen(true), GRID, predict, reach=4.0)
    there = true.project(GRID.place_mm(found.index))
    assert len(found) > 120
    assert np.sqrt(np.mean((found.position_px - there) ** 2)) < 0.03
    assert len(find_board(seen(true), GRID)) == len(found)


def test_without_its_large_dots_a_grid_is_refused_where_the_camera_may_be_a_pitch_off():
    hidden = replace(NOMINAL, position_mm=(36.0, 0.0, 300.0))  # the origin is out of the frame
    paper = seen(hidden, squares=None)
    with pytest.raises(TargetNotFound, match="not the 3 large dots"):
        track_board(paper, replace(GRID, squares=None), predict, reach=4.0)
    with pytest.raises(TargetNotFound, match="not the 3 large dots"):
        find_board(paper, GRID)
    covered = seen()
    covered[:, 150:] = covered[0, 0]  # half of it, with the large dots
    with pytest.raises(TargetNotFound, match="not the 3 large dots"):
        track_board(covered, GRID, predict, reach=4.0)


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"dots": Dots(0.25 * PITCH_MM)}, "dots measure 0.4"),
        ({"discs": ((0, 0), (1, 0), (0, 3))}, "not the 3 large dots"),
        ({"dots": Dots(0.4 * PITCH_MM, bright=True)}, "other shade: change bright_dots"),
    ],
)
def test_a_board_file_that_contradicts_the_picture_is_refused(told, words):
    with pytest.raises(TargetNotFound, match=words):
        track_board(seen(), replace(GRID, **told), predict, reach=4.0)


def test_a_frame_without_dots_is_refused_and_found_once_there_is_light():
    dark = np.full_like(seen(), 20)
    with pytest.raises(TargetNotFound, match=r"no grid of dots in the frame \(largest: 0 dots"):
        track_board(dark, GRID, predict, reach=4.0)
    assert len(track_board(seen(), GRID, predict, reach=4.0)) > 120


def test_a_chessboard_is_not_taken_for_dots_nor_dots_for_a_chessboard():
    squares = render(Scene(NOMINAL, ()), Print(PITCH_MM), Sensor(), samples=2, seed=1)
    with pytest.raises(TargetNotFound, match="describe this one"):
        track_board(squares, GRID, predict, reach=4.0)
    with pytest.raises(TargetNotFound, match="no chessboard"):
        track_board(seen(), Chessboard(PITCH_MM), predict, reach=4.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"dots": Dots(0.1)},
        {"disc_mm": 0.45 * PITCH_MM},
        {"disc_mm": 0.9 * PITCH_MM},
        {"discs": ((0, 0), (0, 0))},
        {"discs": (), "dots": Dots(0.9 * PITCH_MM)},
    ],
)
def test_dots_that_cannot_tell_the_origin_are_refused(wrong):
    with pytest.raises(BoardError):
        replace(GRID, **wrong)


def test_a_dot_is_as_unsure_as_it_scatters_and_one_of_another_size_is_none():
    frame = seen(NOMINAL).astype(np.float64)
    found = find_board(frame, GRID)
    rng, places = np.random.default_rng(0), []
    before = refine_marks(
        frame, GRID, found.index, found.position_px, found.axes_px
    ).sigma_px  # a render is not exact
    for _ in range(12):
        noisy = frame + rng.normal(0.0, 40.0, frame.shape)
        fit = refine_marks(noisy, GRID, found.index, found.position_px, found.axes_px)
        places.append(np.where(fit.valid[:, None], fit.position_px, np.nan))
        sigma2 = fit.sigma_px**2 - before**2
    scatter = np.sqrt(np.nanmean(np.nanvar(places, axis=0, ddof=1)))
    assert scatter == pytest.approx(np.sqrt(np.nanmean(sigma2)), rel=0.2)
    beside = np.where((found.index == (0, 0)).all(axis=1)[:, None], (3, 3), found.index)
    fit = refine_marks(frame, GRID, beside, found.position_px, found.axes_px, search=CornerSearch())
    assert fit.reason[(found.index == (0, 0)).all(axis=1)] == [CornerReason.MISFIT]


def test_dots_are_found_however_small_and_skew_they_are_seen():
    """Three dots wide to the next, at an eighth of the pitch along x: as a ball squeezes them."""
    tilted = seen(NOMINAL, pose=Pose(turn_rad=(0.0, 1.1, 0.0)), squares=(30, 12))
    dots = find_marks(tilted, GRID)
    assert len(dots) > 150
    towards = dots.edges[np.isfinite(dots.edges).all(axis=(1, 2))]
    assert np.median(np.abs(towards).max(axis=2)) > 0.9
