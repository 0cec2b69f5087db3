"""Boards that hang straight, as people align them: every corner meets the rows of pixels alike.

Where a square is a whole number of pixels, the lock on the rows is one and the same at every corner, or drifts as
a wrong scale would.  Corners come from optics of their own with a lock of known size, or from rendered frames.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from correction.fit.adjustment import Adjustment
from correction.fit.judge.result import SceneFit
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import MeasuredFrame, TargetFrame, whitening
from correction.fit.seen.pixel_lock import NAMES, fade_of, lock_prior_px, lock_terms, with_lock, without_lock
from correction.fit.seen.smear_test import EdgeSpread
from correction.fit.solve.solver import Corners
from correction.fit.solve.unknowns import unknowns_of
from correction.fitted.map_sigma import sigma_at
from correction.grid import grid_of
from correction.target import Chessboard
from correction.target.corners import refine_corners
from sim.demo.scenes import at_size, demo_scene
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.fit.drawn_labs import photographed
from tests.correction.fit.drawn_optics import Ball, Lab, shown_mm
from tracer.camera import Camera, look_at
from tracer.scene.fit_section import FitTable
from tracer.scene.scene import Scene

SIZE_PX = 504
SQUARE_PX = 22.0
TURNS_RAD = (0.0, 0.0005, 0.001, 0.003, 0.01)


def aligned(square_px: float, roll_rad: float, rng: np.random.Generator) -> tuple[Scene, Scene, float]:
    """Nominal scene, the true one, whose camera stands beside its place and looks straight; a square [mm]."""
    nominal = at_size(demo_scene("one_sphere_500"), SIZE_PX)
    x, y, z = np.array(nominal.camera.position_mm) + rng.uniform(-0.2, 0.2, 3)
    turned = look_at((x, y, z), (x, y, 0.0), roll_rad)
    camera = replace(nominal.camera, position_mm=(x, y, z), rotation=turned)
    return nominal, nominal.with_camera(camera), square_px * z / camera.focal_px


def beside(fit: SceneFit, truth: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Error and sigma (N, 2) of the map of the bare board, corrected px."""
    pixels = np.stack(np.meshgrid(*[np.linspace(4.0, SIZE_PX - 5.0, 23)] * 2), axis=-1).reshape(-1, 2)
    pitch = grid_of(truth.camera).pitch_mm
    found, true = (shown_mm(Lab(scene.camera, ()), pixels)[0] for scene in (fit.scene, truth))
    return (found - true) / pitch, sigma_at(fit, pixels, False) / pitch


def of_corners(
    seed: int, square_px: float, roll_rad: float, lock_px: float, noise_px: float
) -> tuple[np.ndarray, np.ndarray, SceneFit, np.ndarray]:
    """Error and sigma beside the glass of a lab whose corners are drawn, its fit, and the lock found [px]."""
    rng = np.random.default_rng((33, seed))
    nominal, truth, square_mm = aligned(square_px, roll_rad, rng)
    board = Chessboard(square_mm, 0.4 * square_mm)
    balls = tuple(Ball(s.centre_mm, s.radius_mm, s.medium.n(truth.wavelength_nm)) for s in truth.spheres)
    frames = []
    for glass in (False, True):
        lab = Lab(truth.camera, balls * glass)
        scene = truth if glass else truth.with_bodies(())
        frames.append(photographed(scene, lab, board, glass, noise_px, lock_px, rng))
    bench = unknowns_of(nominal, [0.0], FitTable())
    work = Adjustment()
    fit = work.estimate(bench, bench.start, frames, ())
    return (*beside(fit, truth), fit, lock_prior_px(frames[0]) * work.lock)


@pytest.mark.parametrize("roll_rad", TURNS_RAD)
@pytest.mark.parametrize("lock_px", [pytest.param(0.0, marks=pytest.mark.slow), 0.017])
def test_a_straight_board_with_squares_of_whole_pixels_leaves_the_map_true(roll_rad, lock_px):
    error, _, fit, _ = of_corners(1, SQUARE_PX, roll_rad, lock_px, 0.015)
    used = fit.corners.inlier[~fit.corners.behind]
    assert used.mean() > 0.98
    assert fit.verdict.is_right
    assert np.abs(error).max() < 0.03


def chi_of(cases: list[tuple[int, float, float]]) -> float:
    """Root mean square of error over sigma, all labs together: seed, turn and noise of each."""
    labs = [of_corners(seed, SQUARE_PX, roll_rad, 0.017, noise_px)[:2] for seed, roll_rad, noise_px in cases]
    return float(np.sqrt(np.mean([np.mean((error / sigma) ** 2) for error, sigma in labs])))


@pytest.mark.slow
def test_sigma_beside_glass_is_no_boast_where_the_board_is_straight():
    assert chi_of([(40 + n, TURNS_RAD[n % 5], 0.015) for n in range(5)]) < 1.5  # of five labs, 1.25 of many


def test_a_lock_that_would_undo_what_the_camera_does_is_not_found_in_noise():
    """All corners of 18 px squares meet the pixels at 0.26, where a steep second sine looked better than none."""
    rng = np.random.default_rng((42, 2))
    focal_px, distance_mm, phase = 8000.0, 500.0, 0.27
    square_mm = 18.0 * distance_mm / focal_px
    middle = (503.5, 349.5)
    place = (*((np.subtract(middle, phase) % 18.0) * distance_mm / focal_px).tolist(), distance_mm)

    def seen_from(x: float, y: float, z: float) -> Scene:
        return Scene(Camera(focal_px, middle, (1008, 700), (x, y, z), look_at((x, y, z), (x, y, 0.0), 0.0)), ())

    truth, nominal = seen_from(*place), seen_from(*(np.array(place) + rng.uniform(-0.2, 0.2, 3)).tolist())
    board, lab = Chessboard(square_mm, 0.4 * square_mm), Lab(truth.camera, ())
    frames = [photographed(truth, lab, board, False, 0.015, 0.01, rng) for _ in range(2)]
    bench, work = unknowns_of(nominal, [0.0], FitTable()), Adjustment()
    fit = work.estimate(bench, bench.start, frames, ())
    error, sigma = beside(fit, truth)
    assert np.abs(lock_prior_px(frames[0]) * work.lock).max() < 0.02
    assert np.abs(error).max() < 0.02
    assert np.median(sigma) < 0.05


@pytest.mark.slow
def test_sigma_beside_glass_holds_what_a_straight_board_leaves_open():
    cases = [(200 + n, TURNS_RAD[n % 5], 0.003 + 0.012 * (n % 2)) for n in range(60)]
    assert 0.8 < chi_of(cases) < 1.25


def test_the_lock_is_found_where_corners_meet_the_rows_of_pixels_in_many_ways():
    lock_px = of_corners(1, 22.37, 0.003, 0.017, 0.005)[3]
    found = dict(zip(NAMES, lock_px, strict=True))
    for name, size in found.items():
        if "beside" in name:
            assert size == pytest.approx(-0.017 if "sin1" in name else 0.0, abs=0.0015), name


def test_sharp_edges_are_believed_to_lock_more_than_blurred_ones():
    """As the corner fit finds them in edges integrated over pixels, by their variance."""
    found = {}
    for blur_px in (0.2, 0.3, 0.4):
        u, off = np.arange(41.0), []
        for phase in np.arange(8) / 8.0:
            edges = [drawn_edge(u, 20.0 + place, blur_px) for place in (phase, 0.3)]
            corner = refine_corners(
                1000.0 + 500.0 * np.outer(edges[1], edges[0]), [[20.0, 20.0]], 18.0 * np.eye(2)
            )
            off.append(float(corner.position_px[0, 0]) - 20.0 - phase)
        first, second = np.abs(np.fft.rfft(off))[1:3] / 4.0
        found[first] = lock_prior_px(bare_of(corner.blurs_px))[0]
        assert second < first / 3.0
    assert max(found) > 0.02
    for size, believed in found.items():
        assert 0.1 * believed < size < 2.0 * believed


def drawn_edge(u: np.ndarray, place: float, blur_px: float) -> np.ndarray:
    """A step from -1 to 1, blurred and integrated over pixels of one pixel's width."""

    def area(x: np.ndarray) -> np.ndarray:
        return x * (2.0 * ndtr(x / blur_px) - 1.0) + blur_px * np.sqrt(2.0 / np.pi) * np.exp(
            -0.5 * (x / blur_px) ** 2
        )

    return area(u + 0.5 - place) - area(u - 0.5 - place)


def bare_of(blurs_px: np.ndarray) -> MeasuredFrame:
    """A frame without glass whose edges are so wide."""
    count, zeros = len(blurs_px), np.zeros_like(blurs_px)
    corners = Corners(0, False, zeros, zeros, whitening(zeros))
    spread = EdgeSpread(blurs_px**2, zeros, zeros)
    axes = np.zeros((count, 2, 2))
    return MeasuredFrame(
        "bare",
        corners,
        zeros.astype(np.int64),
        axes,
        np.full(count, ""),
        zeros[:, 0],
        zeros,
        {},
        {},
        spread=spread,
    )


def test_the_lock_fades_where_edges_lean():
    pixel = np.random.default_rng(6).uniform(0.0, 500.0, (200, 2))
    straight, leaning = (22.0 * np.array([[1.0, lean], [lean, -1.0]]) for lean in (0.01, 0.3))
    pulls = [
        np.abs(lock_terms(pixel, fade_of(np.tile(axes, (200, 1, 1))))[0]).max() for axes in (straight, leaning)
    ]
    assert pulls[1] < 0.1 * pulls[0]
    assert pulls[0] > 0.9


def test_the_pull_of_the_lock_has_the_slope_that_it_says():
    rng = np.random.default_rng(7)
    pixel, axes = rng.uniform(0.0, 500.0, (50, 2)), rng.uniform(-20.0, 20.0, (50, 2, 2))
    fade, step = fade_of(axes), 1e-5
    slope = lock_terms(pixel, fade)[1]
    ends = [lock_terms(pixel + side, fade)[0] for side in (step, -step)]
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2.0 * step), atol=1e-6)


def test_information_without_the_lock_is_what_its_covariance_says():
    locked = with_lock(unknowns_of(at_size(demo_scene("one_sphere_500"), SIZE_PX), [0.0], FitTable()))
    size, free = len(locked.names), len(locked.names) - len(NAMES)
    half = np.random.default_rng(8).normal(size=(size, size))
    normal = half @ half.T
    left = without_lock(locked, normal) + np.eye(free)
    covariance = np.linalg.inv(normal + np.eye(size))[:free, :free]
    np.testing.assert_allclose(np.linalg.inv(left), covariance, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("square_px", [SQUARE_PX, 22.37])
def test_rendered_boards_that_hang_straight_or_nearly_leave_the_map_true(square_px):
    chi2 = []
    for number, roll_rad in enumerate(TURNS_RAD):
        nominal, truth, square_mm = aligned(square_px, roll_rad, np.random.default_rng((34, number)))
        frames = []
        for glass in (False, True):
            scene = truth if glass else truth.with_bodies(())
            image = render(scene, Print(square_mm, 0.4 * square_mm), Sensor(), samples=3, seed=2 * number + glass)
            frames.append(TargetFrame("glass" if glass else "bare", image, glass))
        fit = fit_scene(nominal, frames, Chessboard(square_mm, 0.4 * square_mm))
        error, sigma = beside(fit, truth)
        print(f"{roll_rad} rad: {np.abs(error).max():.4f} px, sigma {np.median(sigma):.4f}, z {fit.values[2]:.4f}")
        assert fit.verdict.is_right
        assert fit.corners.inlier[~fit.corners.behind].mean() > 0.98
        assert np.sqrt(np.mean(error**2)) < 0.02
        chi2.append(np.mean((error / sigma) ** 2))
    assert np.sqrt(np.mean(chi2)) < 1.25
