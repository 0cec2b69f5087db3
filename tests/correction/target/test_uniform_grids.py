"""Grids of dots that are all alike, or have one large dot: lattice and origin, in frames drawn by polygons."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from correction.errors import TargetNotFound
from correction.target import Chessboard
from correction.target.board_file import PrintedBoard
from correction.target.board_search import find_board, track_board
from tests.slow_cases import one_in_three, slow
from tracer.board import Dots

SIZE_PX, FOCAL_PX, AWAY_MM = (640, 512), 1600.0, 400.0
PITCH_MM, DOT_MM, LARGE_MM = 8.0, 3.0, 4.6
DOTS = 13, 9  # columns and rows of dots
FINE = 8  # parts of a pixel along a side
REACH = 4.0  # pitches
GRID = Chessboard(
    PITCH_MM, DOT_MM, discs=(), dots=Dots(DOT_MM), squares=(DOTS[0] + 1, DOTS[1] + 1), origin_corner=(7, 5)
)


@dataclass(frozen=True)
class View:
    """A pinhole camera: the turn of the target about its x, y and z [rad], and its place [mm]."""

    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    place_mm: tuple[float, float] = (0.0, 0.0)

    def project(self, place_mm):
        rotation = cv2.Rodrigues(np.array((self.turn_rad[0], self.turn_rad[1], 0.0)))[0]
        rotation = rotation @ cv2.Rodrigues(np.array((0.0, 0.0, self.turn_rad[2])))[0]
        there = np.asarray(place_mm, float) @ rotation.T + (*self.place_mm, 0.0)
        depth = AWAY_MM - there[..., 2]
        u = 0.5 * (SIZE_PX[0] - 1) + FOCAL_PX * there[..., 0] / depth
        v = 0.5 * (SIZE_PX[1] - 1) - FOCAL_PX * there[..., 1] / depth
        return np.stack((u, v), axis=-1)


def rim(centre_mm, diameter_mm):
    angle = np.linspace(0.0, 2.0 * np.pi, 96, endpoint=False)
    x, y = centre_mm[0] + 0.5 * diameter_mm * np.cos(angle), centre_mm[1] + 0.5 * diameter_mm * np.sin(angle)
    return np.stack((x, y, np.zeros_like(x)), axis=-1)


def centre_of_picture(outline):
    """Centroid of the area within an outline."""
    moments = cv2.moments((outline - outline.mean(axis=0)).astype(np.float32))
    return outline.mean(axis=0) + np.array((moments["m10"], moments["m01"])) / moments["m00"]


def indices():
    i, j = np.meshgrid(np.arange(DOTS[0]) - 6, np.arange(DOTS[1]) - 4)
    return np.stack((i.ravel(), j.ravel()), axis=-1)


def drawn(view, large=(), bright=False, noise=2.0, blur_px=0.7, uneven=0.0, seed=0):
    """A frame, and where the middle of each dot's picture is by its index."""
    fine = np.zeros((SIZE_PX[1] * FINE, SIZE_PX[0] * FINE), np.uint8)
    centres = {}
    for index in map(tuple, indices().tolist()):
        outline = view.project(rim(PITCH_MM * np.array(index), LARGE_MM if index in large else DOT_MM))
        centres[index] = centre_of_picture(outline)
        at = np.rint(((outline + 0.5) * FINE - 0.5) * 256.0).astype(np.int32)
        cv2.fillPoly(fine, [at], 255, shift=8)
    cover = cv2.GaussianBlur(
        cv2.resize(fine, SIZE_PX, interpolation=cv2.INTER_AREA).astype(float), (0, 0), blur_px
    )
    light = 40.0 + 160.0 * (cover if bright else 255.0 - cover) / 255.0
    v, u = np.indices(light.shape) / max(light.shape) - 0.5
    light *= 1.0 + uneven * (u - 0.5 * v)
    noisy = light + np.random.default_rng(seed).normal(0.0, noise, light.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), centres


def assert_right(found, centres, least):
    assert len(found) >= least
    off = found.position_px - np.array([centres[tuple(index)] for index in found.index.tolist()])
    assert np.abs(off).max() < 0.5
    assert np.sqrt(np.mean(off**2)) < 0.03


CONDITIONS = {
    "clear": {},
    "bright on dark": {"bright": True},
    "noisy": {"noise": 5.0},
    "blurred": {"blur_px": 2.0},
    "unevenly lit": {"uneven": 1.0},
    "noisy, unevenly lit, bright": {"noise": 4.0, "uneven": 0.8, "bright": True},
}
TURNS = [(0.0, 0.0, 0.05), (0.5, 0.0, 0.1), (-0.2, 0.48, -0.2)]


@pytest.mark.parametrize(("turn", "name"), one_in_three(TURNS, [*CONDITIONS]))
def test_a_grid_in_view_as_a_whole_is_placed_by_its_number_of_dots(name, turn):
    true = View(turn, (9.0, -6.0))  # more than a pitch aside
    about = CONDITIONS[name]
    frame, centres = drawn(true, **about)
    board = replace(GRID, dots=Dots(DOT_MM, about.get("bright", False)))
    found = track_board(frame, board, View().project, reach=REACH)
    assert_right(found, centres, len(centres))
    assert found.origin_basis == "the number of its rows and columns"


@pytest.mark.parametrize(("turn", "name"), one_in_three(TURNS, [*CONDITIONS]))
def test_one_large_dot_is_the_origin_of_a_grid_that_is_partly_out_of_view(name, turn):
    true, nominal = View(turn, (57.0, -42.0)), View((0.0, 0.0, 0.0), (42.0, -30.0))
    about = CONDITIONS[name]
    frame, centres = drawn(true, large=((0, 0),), **about)
    dots = Dots(DOT_MM, about.get("bright", False))
    board = replace(GRID, disc_mm=LARGE_MM, discs=((0, 0),), dots=dots, squares=None, origin_corner=None)
    found = track_board(frame, board, nominal.project, reach=REACH)
    assert_right(found, centres, 50)
    assert len(found) < len(centres)
    assert not found.origin_basis


def placed_at_random(seed):
    """Rms error [px] of a grid in a frame drawn by its number, placed by one of four means in turn."""
    rng, means = np.random.default_rng(seed), ("number", "large dot", "pointed", "camera")[seed % 4]
    tilt, towards = np.deg2rad(rng.uniform(0.0, 30.0)), rng.uniform(0.0, 2.0 * np.pi)
    place = rng.uniform(-1.0, 1.0, 2) * ((10.0, 8.0) if means == "number" else (55.0, 40.0))
    turn = tilt * np.cos(towards), tilt * np.sin(towards), rng.uniform(-0.3, 0.3)
    true, bright = View(turn, tuple(place)), bool(rng.integers(2))
    light = {"noise": rng.uniform(1.0, 6.0), "blur_px": rng.uniform(0.5, 2.2), "uneven": rng.uniform(-1.0, 1.0)}
    large = ((0, 0),) if means == "large dot" else ()
    frame, centres = drawn(true, large, bright, **light, seed=seed)
    board, reach = replace(GRID, dots=Dots(DOT_MM, bright)), REACH
    nominal = View(place_mm=tuple(place + rng.uniform(-20.0, 20.0, 2)))
    if means == "pointed":
        board = replace(board, origin_px=tuple(centres[0, 0] + rng.uniform(-5.0, 5.0, 2)))
    elif means != "number":
        board = replace(board, disc_mm=LARGE_MM, discs=large, squares=None, origin_corner=None)
    if means == "camera":
        reach, nominal = 0.5, replace(true, place_mm=tuple(place + 0.25 * PITCH_MM * rng.uniform(-1.0, 1.0, 2)))
    found = track_board(frame, board, nominal.project, reach=reach)
    off = found.position_px - np.array([centres[tuple(index)] for index in found.index.tolist()])
    assert np.abs(off).max() < 0.5, seed
    return np.sqrt(np.mean(off**2))


@pytest.mark.slow
def test_of_eight_grids_drawn_at_random_all_are_right():
    assert np.median([placed_at_random(seed) for seed in range(8)]) < 0.03


@pytest.mark.slow
def test_of_240_grids_drawn_at_random_all_are_right():
    assert np.median([placed_at_random(seed) for seed in range(240)]) < 0.02


def test_a_grid_of_which_rows_are_out_of_view_is_refused_until_its_origin_is_pointed_at():
    true, nominal = View((0.3, 0.0, 0.05), (60.0, 8.0)), View((0.0, 0.0, 0.0), (50.0, 0.0))
    frame, centres = drawn(true)
    with pytest.raises(TargetNotFound, match=r"may be any of 5 places on a grid of 13 x 9.*origin_px"):
        track_board(frame, GRID, nominal.project, reach=REACH)
    u, v = centres[0, 0]
    found = track_board(frame, replace(GRID, origin_px=(u + 4.0, v - 5.0)), nominal.project, reach=REACH)
    assert_right(found, centres, 60)
    assert "origin_px" in found.origin_basis
    half = 0.5 * (centres[0, 0] + centres[1, 0])
    with pytest.raises(TargetNotFound, match="points at no dot"):
        track_board(frame, replace(GRID, origin_px=tuple(half)), nominal.project, reach=REACH)


@pytest.mark.parametrize("aside", [slow(0.0), 0.2, slow(-0.25)])
def test_a_camera_that_is_known_to_less_than_half_a_pitch_places_a_grid_and_says_so(aside):
    true = View((0.0, 0.0, 0.02), (40.0, 8.0))
    frame, centres = drawn(true)
    near = replace(true, place_mm=(40.0 + aside * PITCH_MM, 8.0))
    for reach in (None, 0.4):
        found = track_board(frame, replace(GRID, squares=None), near.project, reach=reach)
        assert_right(found, centres, 60)
        assert found.origin_basis == "the camera as described"


@pytest.mark.parametrize("reach", [None, 0.4])
def test_a_camera_between_two_dots_is_refused_rather_than_the_nearer_one_taken(reach):
    true = View((0.0, 0.0, 0.02), (40.0, 8.0))
    frame, _ = drawn(true)
    between = replace(true, place_mm=(40.0 + 0.45 * PITCH_MM, 8.0))
    with pytest.raises(TargetNotFound, match="any of 2 places"):
        track_board(frame, replace(GRID, squares=None), between.project, reach=reach)


def test_a_wrong_number_of_dots_is_refused():
    frame, _ = drawn(View())
    with pytest.raises(TargetNotFound, match="no part of a grid of 12 x 9"):
        track_board(frame, replace(GRID, squares=(13, 10)), View().project, reach=REACH)
    with pytest.raises(TargetNotFound, match="any of 2 places on a grid of 14 x 9"):
        track_board(frame, replace(GRID, squares=(15, 10)), View().project, reach=REACH)


def test_dots_of_another_size_are_refused():
    frame, _ = drawn(View())
    with pytest.raises(TargetNotFound, match=r"dots measure 0\.40"):
        track_board(frame, replace(GRID, dots=Dots(4.8)), View().project, reach=REACH)


def test_a_large_dot_beyond_what_the_camera_may_be_off_is_none():
    frame, _ = drawn(View(), large=((5, 0),))
    board = replace(GRID, disc_mm=LARGE_MM, discs=((0, 0),), squares=None, origin_corner=None)
    with pytest.raises(TargetNotFound, match=r"5\.0 pitches from where"):
        track_board(frame, board, View().project, reach=REACH)
    with pytest.raises(TargetNotFound, match="same after a turn; give a prediction"):
        find_board(frame, board)


FILE = {"kind": "dots", "pitch_mm": PITCH_MM, "dot_mm": DOT_MM}


def test_a_board_file_without_large_dots_describes_a_grid_of_dots_that_are_all_alike():
    board = PrintedBoard(**FILE, squares=[14, 10], origin_corner=[7, 5], origin_px=[320.0, 256.0]).board()
    assert board.is_plain
    assert board == replace(GRID, scale_sigma=board.scale_sigma, origin_px=(320.0, 256.0))
    one = PrintedBoard(**FILE, large_dot_mm=LARGE_MM, large_dots=[[0, 0]]).board()
    assert one.discs == ((0, 0),)
    assert one.is_turn_symmetric


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"large_dots": [[0, 0]]}, "needs large_dot_mm"),
        ({"large_dot_mm": LARGE_MM, "origin_px": [1.0, 2.0]}, "leave it out"),
    ],
    ids=str,
)
def test_a_board_file_that_contradicts_itself_is_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        PrintedBoard(**FILE | wrong)
