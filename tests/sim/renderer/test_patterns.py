"""Printed patterns against their definitions, point by point."""

import math

import numpy as np
import pytest

from sim.renderer.patterns import Chessboard, Image, ParticleSheet, Plate, Pose, place, print_particles
from tracer.board import LARGE_DOTS, Dots
from tracer.errors import SceneError


def at(pattern, *points):
    return pattern.reflectance(np.array(points, dtype=np.float64))


def test_chessboard_squares_and_discs():
    board = Chessboard(dark=0.1, bright=0.9)
    dark, bright = np.float32(0.1), np.float32(0.9)
    # Near the corners of squares, away from discs: bright if column + row is odd.
    for i in range(-3, 4):
        for j in range(-3, 4):
            want = bright if (i + j) % 2 else dark
            assert at(board, (2.5 * i + 0.1, 2.5 * j + 2.3))[0] == want, (i, j)
            disc = (i, j) in {(0, 0), (0, -1), (-1, -1)}
            other = dark if (i + j) % 2 else bright
            middle = (2.5 * i + 1.25, 2.5 * j + 1.25)
            assert at(board, middle)[0] == (other if disc else want), (i, j)
            assert at(board, (middle[0] + 0.499, middle[1]))[0] == (other if disc else want)
            assert at(board, (middle[0], middle[1] - 0.501))[0] == want


def test_chessboard_of_other_size():
    board = Chessboard(square_mm=4.0, disc_mm=2.0)
    assert at(board, (2.0, 2.9))[0] == np.float32(0.92)  # in the disc of (0, 0)
    assert at(board, (2.0, 3.1))[0] == np.float32(0.08)
    with pytest.raises(SceneError, match="disc_mm"):
        Chessboard(square_mm=1.0)


def test_pose_turns_and_moves():
    pose = Pose((1.0, 2.0, -3.0), (0.0, 0.0, math.pi / 2))
    assert pose.to_world([(1.0, 0.0), (0.0, 2.0)]) == pytest.approx(
        np.array([(1.0, 3.0, -3.0), (-1.0, 2.0, -3.0)])
    )
    tipped = Pose(turn_rad=(0.1, 0.0, 0.0))
    assert tipped.axes()[2] == pytest.approx((0.0, math.cos(0.1), math.sin(0.1)))
    assert pose.translate(z_mm=5.0).offset_mm == (1.0, 2.0, 2.0)
    assert place(Chessboard(3.0), pose) == Chessboard(3.0, pose=pose)


def test_particles_are_the_plain_sum_of_gaussians():
    sheet = print_particles((8.0, 6.0), 12.0, seed=3, density_per_px=0.05, background=0.02)
    rng = np.random.default_rng(0)
    points = rng.uniform((-5.0, -4.0), (5.0, 4.0), (3000, 2))
    r2 = ((points[:, None] - sheet.places_mm) ** 2).sum(axis=2)
    plain = 0.02 + 0.9 * np.exp(-0.5 * r2 / sheet.sigma_mm**2).sum(axis=1)
    assert sheet.reflectance(points) == pytest.approx(np.minimum(plain, 1.0), abs=2e-5)
    assert (plain > 1.0).any()
    assert sheet.reflectance(np.array([(1e9, 0.0), (-1e9, -1e9), (0.0, 4.4)])) == pytest.approx(0.02)


def test_particle_density_and_diameter_are_those_of_the_stated_scale():
    sheet = print_particles((50.0, 40.0), 12.4, seed=1)
    assert len(sheet.places_mm) == pytest.approx(0.02 * 50 * 40 * 12.4**2, abs=1)
    assert sheet.sigma_mm == pytest.approx(0.75 / 12.4)
    assert np.array_equal(sheet.places_mm, print_particles((50.0, 40.0), 12.4, seed=1).places_mm)
    assert not np.array_equal(sheet.places_mm, print_particles((50.0, 40.0), 12.4, seed=2).places_mm)


def test_shifted_particles_are_an_exact_copy():
    sheet = print_particles((20.0, 20.0), 12.0, seed=4)
    shift = np.array([0.7983, -0.31])
    points = np.random.default_rng(1).uniform(-9.0, 9.0, (5000, 2))
    moved = sheet.displace(shift).reflectance(points + shift)
    assert moved == pytest.approx(sheet.reflectance(points), abs=2e-5)
    turned = sheet.displace(lambda places: 0.1 * places[:, ::-1] * (-1.0, 1.0))
    assert turned.places_mm == pytest.approx(sheet.places_mm + 0.1 * sheet.places_mm[:, ::-1] * (-1.0, 1.0))


def test_particles_of_their_own_brightness_and_none_at_all():
    sheet = ParticleSheet(np.array([(0.0, 0.0), (1.0, 0.0)]), 0.05, np.array([0.2, 0.7]), 0.0)
    assert at(sheet, (0.0, 0.0), (1.0, 0.0)) == pytest.approx((0.2, 0.7))
    empty = ParticleSheet(np.empty((0, 2)), 0.05, background=0.25)
    assert at(empty, (0.0, 0.0), (1.0, 0.0)) == pytest.approx(0.25)
    with pytest.raises(SceneError, match="finite"):
        ParticleSheet(np.array([(0.0, np.nan)]), 0.05)


def test_image_is_exact_at_its_pixels_and_linear_between():
    values = np.random.default_rng(2).random((5, 7), dtype=np.float32)
    image = Image(values, 0.5, outside=0.3)
    rows, columns = np.mgrid[0:5, 0:7]
    nodes = np.column_stack(((columns.ravel() - 3) * 0.5, (2 - rows.ravel()) * 0.5))
    assert image.reflectance(nodes) == pytest.approx(values.ravel(), abs=1e-6)
    assert at(image, (-1.5, 1.0))[0] == values[0, 0]  # row 0 at the top, column 0 at the left
    middle = values[1:3, 4:6].mean()
    assert at(image, (0.75, 0.25)) == pytest.approx([middle], abs=1e-6)
    assert at(image, (1.6, 0.0), (0.0, -1.1), (np.nan, 0.0)) == pytest.approx(0.3)
    with pytest.raises(SceneError, match="scale them"):
        Image(values * 255.0, 0.5)


def test_a_board_of_so_many_squares_lies_on_paper():
    board = Chessboard(2.0, discs=(), squares=(5, 4), origin_corner=(2, 1), odd_bright=False, scale=(1.5, 1.0))
    dark, bright = np.float32(0.08), np.float32(0.92)
    assert at(board, (0.1, 0.1), (3.1, 0.1), (0.1, 2.1)).tolist() == [bright, dark, dark]
    inside = [(-5.9, 0.1), (8.9, 0.1), (0.1, -1.9), (3.1, 5.9)]
    beyond = [(-6.1, 0.1), (9.1, 2.1), (0.1, -2.1), (3.1, 6.1)]
    assert at(board, *inside).tolist() == [bright, bright, dark, dark]
    assert (at(board, *beyond) == bright).all()


@pytest.mark.parametrize("step_mm", [1.0, -1.0])
def test_a_ray_meets_the_face_of_a_plate_its_grooves_or_the_wall_between(step_mm):
    """Rows of 5 mm, the origin on the face or in a groove; rays lean by 0.4 mm a step along y, or by 3."""
    plate = Plate(5.0, 2.5, discs=LARGE_DOTS, dots=Dots(1.5, True, "rows", step_mm), dark=0.1, bright=0.9)
    face = np.array([(0.0, 0.0), (0.0, 5.0), (5.0, 1.0), (5.0, 6.0), (20.0, -20.6)])
    met = plate.shade(face, face + np.array((0.0, 0.4)))
    dot = {True: np.float32(0.9), False: np.float32(0.1)}
    rows = np.array([0, 1, 0, 1, -4])
    on_face = (rows % 2 == 0) == (step_mm > 0.0)
    y = face[:, 1] + np.where(on_face, 0.0, 0.4)
    near = np.abs(y - 5.0 * rows)
    radius = np.array([1.25, 0.75, 1.25, 0.75, 0.75])
    assert met.tolist() == [dot[bool(r < size)] for r, size in zip(near, radius, strict=True)]
    steep = plate.shade(face[:2], face[:2] + np.array((0.0, 3.0)))
    assert steep.tolist() == [np.float32(0.9 if face_first else 0.03) for face_first in on_face[:2]]
    with pytest.raises(SceneError, match="levels"):
        Plate(5.0, 2.5, discs=LARGE_DOTS, dots=Dots(1.5))
