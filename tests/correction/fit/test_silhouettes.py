"""Balls found by the corners that they hide; what hides them is asked of the independent renderer's optics."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.seen.measurement import bare_frame
from correction.fit.seen.silhouettes import find_outlines, outlines_of
from correction.fit.solve.contact import push_apart
from correction.fit.solve.unknowns import unknowns_of
from correction.target import Chessboard
from correction.target.lattice_growth import find_saddles
from rtpiv.templates.files import scene_of
from rtpiv.templates.lab import Lab
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.kernels.rays import last_way
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.correction.fit.benches import photograph
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene

SQUARE_MM = 3.5
CHANCE = 0.03  # of a corner that is missed, or found where none is


def corners_and_hidden(truth: Scene, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the lattice in view, and whether glass is in the way to them."""
    camera = truth.camera
    along = SQUARE_MM * np.arange(-30, 31)
    corners = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    corners = np.column_stack((corners, np.zeros(len(corners))))
    pixel = camera.project(corners)
    inside = ((pixel > 0.0) & (pixel < np.array(camera.sensor_px) - 1.0)).all(axis=1)
    corners, eye = corners[inside], np.array(camera.position_mm)
    tables = tables_of(truth, Pose(), None)
    way = corners - eye
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    chain = [last_way(*eye, *w, tables.world)[6:] for w in way.tolist()]
    hidden = np.array([passed <= 0.0 or crossed != 0 for passed, crossed in chain])
    wrong = np.random.default_rng(seed).random(len(hidden)) < CHANCE
    return corners, hidden ^ wrong


def told(truth: Scene, move_mm: np.ndarray) -> Scene:
    """The scene with its balls somewhere else."""
    table = truth.sphere_table()
    table[:, :3] += move_mm
    rows = push_apart(table, 1e-5)[:, :3].tolist()
    return truth.with_bodies(
        [replace(ball, centre_mm=tuple(row)) for ball, row in zip(truth.spheres, rows, strict=True)]
    )


def found(truth: Scene, believed: Scene, seed: int):
    corners, hidden = corners_and_hidden(truth, seed)
    outlines = outlines_of(believed, truth.camera, np.ones(len(truth.spheres), bool), corners, hidden, SQUARE_MM)
    assert outlines is not None
    off = [np.subtract(a.centre_mm, b.centre_mm) for a, b in zip(truth.spheres, believed.spheres, strict=True)]
    return outlines, np.array(off)


@pytest.mark.parametrize(
    ("name", "seed"),
    [("pair_off_axis", 0), ("pair_off_axis", 1), ("pyramid_500", 2), ("pyramid_500", 3), ("three_spheres_500", 4)],
)
def test_balls_are_seen_where_they_stand(name, seed):
    """Up to 5 mm off, all together or one by itself."""
    truth = at_size(demo_scene(name), 504)
    rng = np.random.default_rng((1, seed))
    move = rng.normal(size=3) * (1.0, 1.0, 0.5)
    move *= rng.uniform(2.0, 5.0) / np.linalg.norm(move)
    moves = np.tile(move, (len(truth.spheres), 1))
    if seed % 2:
        moves[1:] = 0.0
    outlines, off = found(truth, told(truth, moves), seed)
    left = np.hypot(*(outlines.move_mm - off)[outlines.own_rim, :2].T)
    assert outlines.own_rim.any()
    assert left.max() < 1.0
    assert np.median(left) < 0.5
    assert outlines.explained > 0.93


def test_what_is_off_is_said_and_what_is_not_is_not():
    truth = at_size(demo_scene("pair_off_axis"), 504)
    right, _ = found(truth, truth, 1)
    assert right.in_words(1.0) == ""
    together, _ = found(truth, told(truth, np.array([[-3.0, 0.0, 0.0]] * 2)), 1)
    assert "rims of sphere1, sphere2 are all seen" in together.in_words(1.0)
    assert "mm to the right" in together.in_words(1.0)
    alone, _ = found(truth, told(truth, np.array([[0.0, 0.0, 0.0], [0.0, 3.7, 0.0]])), 1)
    assert "rim of sphere2 is seen 3." in alone.in_words(1.0)
    assert "below" in alone.in_words(1.0)
    assert "sphere1" not in alone.in_words(1.0)


def test_a_ball_stands_beside_its_rim_if_it_is_moved_sideways_and_not_if_it_is_moved_in_depth():
    truth = at_size(demo_scene("pair_off_axis"), 504)
    moved = told(truth, np.array([[0.0, 0.0, 0.0], [0.0, 3.7, 0.0]]))
    outlines, _ = found(truth, moved, 1)
    least_mm = 0.8 * SQUARE_MM
    assert outlines.beside(moved, least_mm).tolist() == [False, True]
    assert not outlines.beside(truth, least_mm).any()
    assert not outlines.beside(told(truth, np.array([[0.0, 0.0, 3.0]] * 2)), least_mm).any()


def test_a_ball_behind_another_goes_with_it():
    truth = at_size(demo_scene("three_spheres_500"), 504)
    outlines, _ = found(truth, told(truth, np.array([[2.0, 3.0, 0.0]] * 3)), 2)
    assert outlines.own_rim.tolist() == [False, False, True]
    assert np.all(outlines.move_mm[:2, 1] < -1.0)


def test_a_lattice_that_says_nothing_moves_nothing():
    truth = at_size(demo_scene("pair_off_axis"), 504)
    corners, _ = corners_and_hidden(truth, 1)
    free = np.ones(2, bool)
    for hidden in (np.zeros(len(corners), bool), np.ones(len(corners), bool)):
        assert outlines_of(truth, truth.camera, free, corners, hidden, SQUARE_MM) is None
    assert outlines_of(truth, truth.camera, free, corners[:20], np.arange(20) < 10, SQUARE_MM) is None


def test_a_ball_that_is_held_stays():
    truth = at_size(demo_scene("pair_off_axis"), 504)
    corners, hidden = corners_and_hidden(truth, 1)
    believed = told(truth, np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    outlines = outlines_of(believed, truth.camera, np.array([True, False]), corners, hidden, SQUARE_MM)
    assert np.all(outlines.move_mm[1] == 0.0)


def test_a_ball_in_the_middle_of_a_heap_has_no_rim_of_its_own() -> None:
    """Gaps show a little of it, at which others hide as well: it was seen 1 mm beside its place, and followed."""
    base = at_size(demo_scene("two_spheres_500"), 504)
    ring = [(50.1 * np.cos(k * np.pi / 3.0), 50.1 * np.sin(k * np.pi / 3.0), 25.1) for k in range(6)]
    top = [(28.95 * np.cos(a), 28.95 * np.sin(a), 66.2) for a in (np.pi / 2.0, 7.0 * np.pi / 6.0, -np.pi / 6.0)]
    places = [(0.0, 0.0, 25.1), *ring, *top]
    one = base.spheres[0]
    heap = base.with_bodies(
        [replace(one, name=f"b{k}", centre_mm=place, radius_mm=25.0) for k, place in enumerate(places)]
    )
    outlines, _ = found(heap, heap, 1)
    assert not outlines.own_rim[0]
    assert not outlines.own_rim[7:].any()
    assert outlines.own_rim[1:7].any()


def test_the_board_behind_a_tube_shows_no_outline_of_the_balls_in_it():
    """The wall moves the lattice, beside the balls too: balls followed the edge of their tube by a centimetre."""
    lab = Lab(arrangement="tube", layers=1, plane=2.0, balls=4, ball_mm=15.0, gap_mm=5.0, lens_mm=25.0)
    nominal, side = at_size(scene_of(lab), 400), 5.0
    truth, board = misalign(nominal, 1, is_packed=True), Chessboard(side, 0.4 * side)
    clear, glass = photograph(truth.bare(), False, 0.0, 1, side), photograph(truth, True, 0.0, 2, side)
    bare, _ = bare_frame(clear, board, truth.camera.project, 0)
    least = 0.01 * float(np.median(find_saddles(clear.image).strength))

    def outlines(scene: Scene):
        unknowns = unknowns_of(scene.with_camera(truth.camera), [0.0], FitTable())
        return find_outlines(unknowns, unknowns.start, bare, find_saddles(glass.image), least, 0, board)

    assert outlines(nominal) is None
    assert outlines(nominal.with_bodies(nominal.spheres)) is not None  # a scene without the tube
