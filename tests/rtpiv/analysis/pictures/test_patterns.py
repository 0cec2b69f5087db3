"""What hangs on the plane in computer-generated pictures, and what a frame is taken for."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from correction.target import Chessboard
from correction.target.codes import with_codes
from rtpiv.analysis.pictures.kernels.patterns import add_particles
from rtpiv.analysis.pictures.patterns import (
    MarkerBoard,
    Particles,
    Target,
    pattern_view,
    shows_particles,
    square_for,
)
from rtpiv.analysis.through_glass import coarsen_scene
from tests.rtpiv.analysis.test_plane_share import GLASS, scene_of
from tracer.board import Codes
from tracer.bodies import Sphere

POINTS = np.random.default_rng(3).uniform(-12.0, 12.0, (500, 2))
POINTS[7] = np.nan
MASK = (1 << 64) - 1


def drawn(pattern, points=POINTS):
    picture = np.zeros((len(points), pattern.channels), np.float32)
    pattern.add(points, picture)
    return picture


def test_the_target_is_that_of_the_bench():
    board = Chessboard(2.5, 1.0)
    known = np.isfinite(POINTS).all(axis=1)
    picture = drawn(Target(board))[:, 0]
    assert (picture[known] == board.shade(POINTS[known])).all()
    assert picture[7] == 0.0


def test_markers_lie_on_the_diagonal_in_their_colours():
    board = MarkerBoard(2.5)
    places = np.array([[k * 2.5 * 1.2 * 2**0.5, -k * 2.5 * 1.2 * 2**0.5] for k in (-1, 0, 1, 2)])
    colours = drawn(board, places)
    assert colours[1] == pytest.approx([1.0, 1.0, 1.0])
    assert colours[2] == pytest.approx([214 / 255, 39 / 255, 40 / 255])
    assert len({tuple(colour) for colour in colours.tolist()}) == 4
    assert drawn(board, np.array([[1.0, 20.0], [4.0, 20.0]]))[:, 0] == pytest.approx([0.12, 0.88])


def test_particles_are_few_bright_and_the_same_every_time():
    points = np.stack(np.meshgrid(np.linspace(-40, 40, 300), np.linspace(-40, 40, 300)), axis=-1).reshape(-1, 2)
    picture = drawn(Particles(2.0, 0.8), points)[:, 0]
    assert (picture == drawn(Particles(2.0, 0.8), points)[:, 0]).all()
    assert 0.01 < np.mean(picture > 0.3) < 0.2
    assert picture.max() <= 1.0


@pytest.mark.parametrize("kind", ["discs", "plain", "charuco"])
def test_any_board_is_drawn_as_it_is(kind):
    board = Chessboard(2.5, 1.0, squares=(9, 8), origin_corner=(3, 4), scale=(1.01, 0.99))
    if kind != "discs":
        board = replace(board, discs=(), odd_bright=False)
    board = with_codes(board, Codes("DICT_4X4_50", 0.7)) if kind == "charuco" else board
    points = np.random.default_rng(1).uniform(-14.0, 18.0, (3000, 2))
    assert np.array_equal(drawn(Target(board), points)[:, 0], board.shade(points))


def shuffled(i: int, j: int, turn: int) -> float:
    """A number in [0, 1) of a cell, in integers of any length."""
    word = (i * 0x9E3779B97F4A7C15 ^ j * 0xC2B2AE3D27D4EB4F) + turn * 0x165667B19E3779F9 & MASK
    word = (word ^ word >> 30) * 0xBF58476D1CE4E5B9 & MASK
    word = (word ^ word >> 27) * 0x94D049BB133111EB & MASK
    return ((word ^ word >> 31) >> 11) * 2.0**-53


@pytest.mark.parametrize("diameter", [0.5, 1.0, 2.0])
def test_particles_are_the_sum_of_all_nine_near_a_point(diameter):
    """Wherever the points come from: along a row, back and forth, with some that no ray reaches between them."""
    rng, cell = np.random.default_rng(4), 2.0
    points = np.stack((np.linspace(-9.0, 9.0, 150), np.full(150, 0.3)), axis=1)
    points = np.concatenate((points, rng.uniform(-9.0, 9.0, (100, 2)), points[::-3]))
    points[rng.integers(0, len(points), 20)] = np.nan
    wanted = np.zeros(len(points))
    for k, (x, y) in enumerate(points.tolist()):
        if not math.isfinite(x):
            continue
        for i, j in product(range(math.floor(y / cell) - 1, math.floor(y / cell) + 2), range(-1, 2)):
            j += math.floor(x / cell)
            square = (x - (j + shuffled(i, j, 1)) * cell) ** 2 + (y - (i + shuffled(i, j, 2)) * cell) ** 2
            wanted[k] += (0.3 + 0.7 * shuffled(i, j, 3)) * math.exp(-8.0 * square / diameter**2)
    picture = np.zeros((len(points), 1), np.float32)
    add_particles(points, cell, diameter, np.empty((9, 3)), picture)
    assert np.abs(picture[:, 0] - np.minimum(wanted, 1.0)).max() < 1e-7  # float32
    assert np.count_nonzero(wanted > 0.2) >= 10


def test_the_camera_sees_the_board_through_a_ball_and_nothing_behind_a_black_one():
    ball = Sphere("ball", (0.0, 0.0, 20.0), 20.0, GLASS)
    bare, glass = (
        pattern_view(scene_of(*bodies, px_per_mm=1.0), MarkerBoard(2.5), samples=2) for bodies in ((), (ball,))
    )
    assert (bare[0] == glass[0]).all()
    assert np.mean(bare[190:210, 190:210] != glass[190:210, 190:210]) > 0.5
    black = Sphere("ball", (0.0, 0.0, 20.0), 20.0, None)
    assert (
        pattern_view(scene_of(black, px_per_mm=1.0), Target(Chessboard(2.5, 1.0)), 1)[195:205, 195:205] == 0.0
    ).all()


def test_progress_hears_of_every_ray_map():
    heard = []

    def watched(items, total, what):
        for item in items:
            heard.append((total, what))
            yield item

    pattern_view(scene_of(px_per_mm=1.0), MarkerBoard(2.5), 2, watched)
    assert heard == [(4, "what the camera sees")] * 4


def test_a_frame_is_taken_for_what_it_shows():
    scene = scene_of(Sphere("ball", (0.0, 0.0, 40.0), 40.0, GLASS))
    noise = np.random.default_rng(1).normal(0.0, 0.02, scene.camera.shape)
    assert shows_particles(pattern_view(scene, Particles(2.5, 1.2), 2) + noise)
    assert not shows_particles(pattern_view(scene, Target(Chessboard(2.5, 1.0)), 2) + noise)
    assert shows_particles(np.zeros((20, 20), np.uint16))


@pytest.mark.parametrize(
    ("width", "square"), [(160.0, 2.5), (16.0, 0.25), (1.0, 0.02), (70.0, 1.0), (3000.0, 50.0)]
)
def test_squares_are_round_numbers(width, square):
    assert square_for(width) == pytest.approx(square)


def test_a_coarser_camera_sees_the_same_view():
    scene = scene_of(px_per_mm=1.0)
    width, height = scene.camera.sensor_px
    assert coarsen_scene(scene, width).camera == scene.camera
    coarse = coarsen_scene(scene, width // 4).camera
    assert coarse.sensor_px == (width // 4, height // 4)
    of_fours = np.array([[1.5, 1.5], [401.5 - 4.0, 201.5]])  # middles of blocks of four pixels a side
    fine = scene.camera.directions(of_fours)
    assert coarse.directions((of_fours - 1.5) / 4.0) == pytest.approx(fine, abs=1e-12)
