"""Corners behind chains of balls, rendered by optics of their own, once the bending of the view is taken off."""

import re
from functools import cache

import numpy as np
import pytest
import scipy

from correction.fit.seen.bent_view import LEFT, draw_marks
from correction.fit.seen.kernels.edges import shade_edges
from correction.fit.seen.measurement import TargetFrame, glass_frame, whitening
from correction.fit.seen.prediction import Expected, expect
from correction.fit.solve.moved_board import on_moved_board
from correction.fit.solve.solver import Corners
from correction.fit.solve.unknowns import unknowns_of
from correction.target import Chessboard
from correction.target.corners import refine_corners
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render_irradiance
from sim.renderer.sensor import Sensor
from tests.correction.fit.drawn_labs import drawn_lab
from tests.correction.fit.drawn_optics import Ball, Lab, shown_mm
from tests.correction.fit.strangers import stranger
from tests.slow_cases import slow
from tracer.scene.fit_section import FitTable
from tracer.strategies.sensitivity import TargetPose

BARE = Sensor(white_counts=53000.0, electrons_per_count=float("inf"), read_noise_counts=0.0, bits=16, blur_px=0.6)
RIM_PX = 6.0
HALF, FINE, BLUR_PX = 12, 31, 0.66  # of a corner drawn by hand: pixels to either side, points a pixel, blur
SQUARES_A_PX = np.array([[0.97, 0.26], [-0.21, 0.92]]) / 14.0


@cache
def found(name: str, square_mm: float) -> tuple[Expected, np.ndarray, np.ndarray, np.ndarray]:
    """Corners behind glass, how far off they are found, with what sigma, and what is doubted of it (N, 2)."""
    scene, board = misalign(at_size(demo_scene(name), 1008), 5), Chessboard(square_mm, 0.4 * square_mm)
    light = render_irradiance(scene, Print(square_mm, 0.4 * square_mm), samples=3, seed=1)
    shown = expect(scene, TargetPose(), board)
    shown = shown.take((shown.branch > 0) & (shown.rim_px > RIM_PX))
    frame = glass_frame(
        TargetFrame("glass", BARE.expose(light, seed=0), True), board, scene, TargetPose(), 0, True
    )
    apart, nearest = scipy.spatial.KDTree(frame.corners.pixel).query(shown.pixel)
    seen = apart < 0.5
    shown, nearest = shown.take(seen), nearest[seen]
    away = frame.corners.pixel[nearest] - shown.pixel
    return shown, away, np.hypot(frame.sigma_px[nearest], 0.01), frame.bent_px[nearest]


def left(away: np.ndarray, sigma: np.ndarray, doubt: np.ndarray) -> float:
    """Share of what was taken off by which corners are still off, as the fit of a scene weighs them."""
    return LEFT * float(np.sum(away * doubt / sigma**2) / np.sum(doubt**2 / sigma**2))


def view(even: float, twist: float, fall: float, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A made-up view: the squares of the board that pixels (..., 2) show, from a corner, and their light (...)."""
    turned = pixel @ SQUARES_A_PX.T
    along, beside = turned[..., :1], turned[..., 1:]
    bent = even * (along**2 * (0.4, 1.0) + along * beside * (0.5, -0.3)) + twist * along**3 * (1.0, -0.6)
    toward = pixel @ np.array([0.8, 0.6])
    return turned + bent, 1.0 - 0.02 * toward - fall * 1e-3 * toward**2


def found_at(image: np.ndarray) -> np.ndarray:
    """How far (2,) from the middle of an image a corner is found."""
    start = [[HALF + 0.3, HALF + 0.2]]
    fit = refine_corners(image.astype(np.float32), start, np.linalg.inv(SQUARES_A_PX), window=0.42)
    assert fit.valid.all()
    return fit.position_px[0] - HALF


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(
    ("even", "twist", "fall", "aside_px"),
    [(0.0, 0.0, 0.0, 0.0), (0.8, 0.8, 3.0, 0.004), (1.0, 1.0, 2.0, 0.015), (-0.8, 1.5, 1.0, 0.05)],
)
def test_a_corner_is_drawn_as_the_board_shows_it_through_a_bent_view(even, twist, fall, aside_px, sign):
    """Dark and bright corners, with the next edges in the window and light that falls ever faster."""
    places = np.arange(-HALF, HALF + 1.0)
    squares, light = view(even, twist, fall, np.stack(np.meshgrid(places, places), axis=-1))
    corner = np.array([[0, 0] if sign < 0 else [1, 0]])
    seen = draw_marks(squares[None], light[None], Chessboard(), corner, BLUR_PX)[0]
    points = (np.arange(FINE * len(places)) + 0.5) / FINE - HALF - 0.5
    squares, light = view(even, twist, fall, np.stack(np.meshgrid(points, points), axis=-1))
    board = 0.5 + 0.42 * sign * (1.0 - 2.0 * (np.floor(squares).sum(axis=-1) % 2.0))
    blurred = scipy.ndimage.gaussian_filter(board * light, BLUR_PX * FINE, mode="nearest")
    true = found_at(blurred[FINE // 2 :: FINE, FINE // 2 :: FINE])
    assert np.linalg.norm(true) >= aside_px
    np.testing.assert_allclose(found_at(seen), true, atol=0.004)


def test_many_corners_at_once_show_each_its_own_squares():
    """A flat view of three squares to every side, of dark and bright corners: off the edges the print itself."""
    places = np.arange(-HALF, HALF + 1.0)
    count = 9
    shift = np.linspace(-0.4, 0.4, count)[:, None, None, None] * (1.0, -0.5)
    squares = np.stack(np.meshgrid(places, places), axis=-1) / 4.5 + shift
    corner = np.array([[number // 3 % 2, 0] for number in range(count)])
    seen = draw_marks(squares, np.ones(squares.shape[:3]), Chessboard(), corner, BLUR_PX)
    bright = 1.0 - 2.0 * (np.floor(squares).sum(axis=-1) % 2.0)
    bright[corner[:, 0] == 0] *= -1.0
    away = (np.abs(squares - np.rint(squares)) > 0.35).all(axis=-1)
    assert away.mean() > 0.05
    np.testing.assert_array_equal(np.sign(seen - 1.0)[away], bright[away])


@pytest.mark.parametrize("edges", [shade_edges, shade_edges.py_func], ids=["compiled", "python"])
@pytest.mark.parametrize("whole", [True, False])
def test_edges_are_shaded_as_gradient_and_erf_of_numpy_and_scipy_say(edges, whole):
    rng = np.random.default_rng(3)
    field = np.cumsum(rng.normal(0.02, 0.05, (17, 23)), axis=1) + np.cumsum(rng.normal(0.0, 0.05, (17, 1)), axis=0)
    level = np.rint(field) if whole else np.zeros_like(field)
    slope = np.hypot(*np.gradient(field, 0.25))
    wanted = np.where(level % 2 == 0, 0.7, -0.7) * scipy.special.erf((field - level) / slope / 0.3)
    shade = np.full(field.shape, 0.7)
    edges(field, 4, 0.3, whole, shade)
    np.testing.assert_allclose(shade, wanted, rtol=0.0, atol=1e-15)


@pytest.mark.slow
def test_what_the_bending_of_a_view_does_to_corners_is_taken_off():
    shown, away, sigma, doubt = found("three_spheres_500", 2.5)
    chain = shown.ways == "sphere3 > sphere2 > sphere1"
    assert chain.sum() > 50
    assert np.linalg.norm(doubt[chain], axis=1).max() > 0.067 * LEFT
    assert abs(left(away[chain], sigma[chain], doubt[chain])) < LEFT


@pytest.mark.slow
def test_a_view_that_hardly_bends_leaves_no_doubt_of_its_corners():
    shown, _, _, doubt = found("pair_off_axis", 3.5)
    clear = shown.rim_px > 20.0
    rough = np.linalg.norm(shown.bent_px[clear], axis=1).max()  # what the size of the bending alone makes of it
    assert rough > 0.01
    assert np.linalg.norm(doubt[clear], axis=1).max() < 0.3 * rough


# Corners that a frame should show and does not: those whose windows the edge of the frame cuts tell nothing.


SIDE_MM, SIDE_PX = 16.0, 29.5  # of the squares, in the frame


def test_corners_beside_the_edge_of_the_frame_are_not_called_hidden():
    """A row of the lattice 5 px from the edge was fitted in what is left of its windows, and masked as a body."""
    scene = at_size(demo_scene("two_spheres_500"), 300).bare()
    pose = TargetPose((0.0, 3.0 * SIDE_MM / SIDE_PX, 0.0))  # the last row 4.9 px from the edge
    noise = np.random.default_rng(1).normal(1000.0, 10.0, (300, 300)).astype(np.float32)
    frame = TargetFrame("glass", noise, True, 0.0)
    lost = glass_frame(frame, Chessboard(SIDE_MM, 0.4 * SIDE_MM), scene, pose, 0, False).lost.pixel
    assert len(lost) > 40
    assert lost.min() > 0.4 * SIDE_PX  # half a window
    assert lost.max() < 299.0 - 0.4 * SIDE_PX


# A bent board is followed by derivatives that are those of its residuals, and found after a camera went aside.


BEND_PER_MM = (0.003, -0.001, 0.002)  # z = (a x^2 + 2 b x y + c y^2) / 2: 1.5 mm, 30 mm from the middle
STEP = 1e-4
LARGER = 6.0  # all ways over all corners, than one way along half the view


@pytest.mark.parametrize("glass", [False, True])
def test_derivatives_by_the_scene_are_those_of_residuals_on_a_bent_board(glass):
    """Those of a flat board are wrong by all that a bend makes of a camera that moves."""
    scene = misalign(at_size(demo_scene("pair_off_axis"), 504), 3)
    unknowns = unknowns_of(scene, [0.0], FitTable())
    balls = tuple(Ball(s.centre_mm, s.radius_mm, s.medium.n(scene.wavelength_nm)) for s in scene.spheres)
    asked = np.linspace(60.0, 440.0, 20)
    pixels = np.stack(np.meshgrid(asked, asked), axis=-1).reshape(-1, 2)
    nodes, through = shown_mm(Lab(scene.camera, balls * glass, BEND_PER_MM), pixels)
    seen = np.isfinite(nodes[:, 0]) & ((through != 0) == glass)
    pixels, (x, y) = pixels[seen], nodes[seen].T
    corners = Corners(0, glass, pixels, nodes[seen], whitening(np.full(pixels.shape, 0.01)))
    ways = np.zeros((len(x), 6, 3))
    ways[:, 2] = np.stack((0.5 * x * x, x * y, 0.5 * y * y), axis=1)
    start, bend = np.zeros(len(unknowns.names)), np.array(BEND_PER_MM)
    here = on_moved_board(unknowns, start, bend, ways, corners)
    flat = on_moved_board(unknowns, start, 0.0 * bend, ways, corners)
    fits = np.linalg.norm(here.value, axis=1) < 0.05  # sigmas: not where a view turns over
    assert np.count_nonzero(fits) > 60
    assert np.median(np.linalg.norm(flat.value[fits], axis=1)) > 10.0
    for number, name in enumerate(unknowns.names):
        step = STEP * np.eye(len(start))[number]
        after, before = (on_moved_board(unknowns, at, bend, ways, corners).value for at in (step, -step))
        truly = (after - before) / (2.0 * STEP)
        known = fits & np.isfinite(truly).all(axis=1)
        changed = np.linalg.norm((truly - flat.rate[:, :, number])[known], axis=1)
        off = np.linalg.norm((truly - here.rate[:, :, number])[known], axis=1)
        negligible = 1e-6 * np.median(
            np.linalg.norm(truly[known], axis=1)
        )  # a turn moves pixels, near and far alike
        assert np.median(off) <= 0.1 * np.median(changed) + negligible, name
    for number in range(3):
        step = STEP * bend[number] * np.eye(3)[number]
        after, before = (on_moved_board(unknowns, start, bend + by, ways, corners).value for by in (step, -step))
        truly = (after - before) / (2.0 * step[number])
        said = here.rate[:, :, len(start) + number]
        off, size = (np.linalg.norm(one[fits], axis=1) for one in (said - truly, truly))
        assert np.median(off / size) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("seed", [71151, slow(71047), slow(71111)])
def test_a_bend_is_found_though_the_camera_went_aside_for_it(seed):
    """Sigma was a fourteenth of the error: the bend was found to be a fifth of what it is.

    Its size is that of one way along half the view, the sentence's of all ways over corners beyond it as well.  A
    camera 17 to 27 mm aside makes differences that derivatives of what is free say to a tenth or worse.
    """
    lab = drawn_lab(seed, "bent board", draw=stranger)
    said = re.search(r"the board is not flat: .* seems to bend by (\d+) um", lab.fit.verdict.sentences[0])
    assert said
    assert lab.size < 1e-3 * float(said[1]) < LARGER * lab.size
    _, error, sigma = lab.beside
    assert np.sqrt(np.mean(error**2)) > 0.05
    assert 0.8 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.2
    known = lab.sigma_px.max(axis=1) < 2.0 * np.sqrt(np.mean(lab.error_px**2))
    chi = (lab.error_px / lab.sigma_px)[known]
    assert not len(chi) or 0.7 < np.sqrt(np.mean(chi**2)) < 1.3
