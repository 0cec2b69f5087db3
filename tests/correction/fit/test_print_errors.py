"""What a fit to corners is worth whose lines on paper lie off, in every frame alike."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from correction.fit import glass_stage
from correction.fit.progress import Progress
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.fit.seen.prediction import expect
from correction.fit.solve.print_errors import OnPrint, _mean_between, print_errors
from correction.fit.solve.solver import Corners, residuals
from correction.fit.solve.unknowns import unknowns_of
from correction.grid import grid_of
from correction.maps.correction_map import build_correction_map
from correction.target import Chessboard
from correction.target.lattice_growth import Saddles
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import map_error_px
from tests.correction.small_scenes import small_scene
from tracer.scene.fit_section import FitTable
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.sensitivity import TargetPose
from tracer.strategies.trace import DIRECT, trace

FRAMES, SIDE, LINE, DRAWS = 4, 20, 0.01, 40
PER_SQUARE = np.array([[60.0, 8.0], [-5.0, 55.0]])  # sigmas a square: edges of 20 px, found to a third of a pixel


def corners():
    index = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), -1).reshape(-1, 2)
    return index - SIDE // 2


def fitted(rng, line, point):
    """Draw frames of one print, fit them; how far the numbers are off in sigmas that know nothing, and in ours."""
    index = corners()
    x, y = rng.normal(0.0, line, (2, SIDE))
    off = np.column_stack((x[index[:, 0]], y[index[:, 1]])) + rng.normal(0.0, point, index.shape)
    frames = []
    for height in range(FRAMES):
        i, j = index.T / SIDE
        rate = np.zeros((len(index), 2, 4))  # moved along both, nearer, turned
        rate[:, 0, 0] = rate[:, 1, 1] = 1.0
        rate[:, :, 2] = (1.0 + 0.1 * height) * np.column_stack((i, j))
        rate[:, :, 3] = np.column_stack((-j, i))
        value = off @ PER_SQUARE.T + rng.normal(0.0, 1.0, index.shape)
        frames.append((value, rate))
    rates, values = (np.concatenate([f[k].reshape(len(index) * 2, -1) for f in frames]) for k in (1, 0))
    covariance = np.linalg.inv(rates.T @ rates)
    found = covariance @ rates.T @ values[:, 0]
    left = [value - rate @ found for value, rate in frames]
    per_square = np.broadcast_to(PER_SQUARE, (len(index), 2, 2))
    printed = print_errors(
        [
            OnPrint(index, np.full(len(index), ""), height, rest, per_square, rate)
            for height, (rest, (_, rate)) in enumerate(zip(left, frames, strict=True))
        ]
    )
    own = np.mean(np.square(left)) * covariance  # a fit has all errors of its corners in their sigmas
    ours = own + covariance @ printed.spread @ covariance
    return found / np.sqrt(np.diag(covariance)), found / np.sqrt(np.diag(ours)), printed


@pytest.mark.parametrize(
    ("line", "point", "too_small"), [(0.0, 0.0, 0.9), (LINE, 0.0, 2.0), (0.0, LINE, 1.2), (LINE, 0.5 * LINE, 2.0)]
)
def test_sigma_knows_what_the_lines_and_points_of_a_print_do(line, point, too_small):
    rng = np.random.default_rng(8)
    drawn = [fitted(rng, line, point) for _ in range(DRAWS)]
    before, now = (np.sqrt(np.mean(np.square([one[k] for one in drawn]))) for k in (0, 1))
    assert 0.85 < now < 1.2
    assert before > too_small * now
    lines = np.sqrt(np.mean([np.square(one[2].lines) for one in drawn]))
    points = np.sqrt(np.mean([np.square(one[2].points) for one in drawn]))
    assert lines == pytest.approx(line, rel=0.15, abs=0.05 * LINE)
    assert points == pytest.approx(point, rel=0.3, abs=0.05 * LINE)


def test_what_stands_out_is_said_and_what_does_not_is_not():
    rng = np.random.default_rng(2)
    assert str(fitted(rng, 0.0, 0.0)[2]) == ""
    assert "lines of the print lie off by" in str(fitted(rng, LINE, 0.0)[2])


def test_a_ball_whose_numbers_follow_the_print_hides_nothing():
    """Few corners, seen sharply, that a fit has brought onto their places, say nothing of the print."""
    index, rng = corners(), np.random.default_rng(5)
    off = LINE * rng.normal(size=(2, SIDE))
    value = np.column_stack((off[0][index[:, 0]], off[1][index[:, 1]])) @ PER_SQUARE.T + rng.normal(
        size=index.shape
    )
    per_square, rate = np.broadcast_to(PER_SQUARE, (len(index), 2, 2)), np.zeros((len(index), 2, 1))
    beside = OnPrint(index, np.full(len(index), ""), 0, value, per_square, rate)
    near = (np.abs(index) < 4).all(axis=1)
    way = np.full(np.count_nonzero(near), "ball")
    through = OnPrint(index[near], way, 0, 0.1 * value[near], -8.0 * per_square[near], rate[near])
    alone, both = (print_errors(frames).lines for frames in ([beside], [beside, through]))
    assert alone == pytest.approx(both)
    assert np.mean(both) == pytest.approx(LINE, rel=0.25)


def test_what_pixels_do_to_corners_on_the_same_place_in_two_frames_is_not_the_prints():
    """Corners beside the glass lie on the same pixels with and without it, those behind it on others."""
    index, rng = corners(), np.random.default_rng(6)
    beside, through = np.full(len(index), ""), np.full(len(index), "ball")
    per_square, rate = np.broadcast_to(PER_SQUARE, (len(index), 2, 2)), np.ones((len(index), 2, 1))
    near = (np.abs(index) < 7).all(axis=1)
    for of_print in (True, False):
        alike = 2.0 * LINE * rng.normal(size=index.shape) @ PER_SQUARE.T
        bare, clear, glass = (rng.normal(size=index.shape) + alike * shared for shared in (1.0, 1.0, of_print))
        frames = [
            OnPrint(index, beside, 0, bare, per_square, rate),
            OnPrint(index[~near], beside[~near], 0, clear[~near], per_square[~near], rate[~near]),
            OnPrint(index[near], through[near], 0, glass[near], per_square[near], rate[near]),
        ]
        found = print_errors(frames)
        first, second = (found.points, found.pixels) if of_print else (found.pixels, found.points)
        assert np.mean(first) == pytest.approx(2.0 * LINE, rel=0.25)
        assert np.mean(second) < 0.4 * np.mean(first)


@pytest.mark.parametrize(
    ("low", "high"),
    [(-1.0, 2.0), (-0.0, 0.3), (-9.0, -4.0), (3.0, 3.5), (45.0, 50.0), (-60.0, -50.0), (-50.0, 50.0)],
)
def test_the_mean_of_what_lies_between_is_that_of_scipy(low, high):
    exact = scipy.stats.truncnorm.mean(low, high)
    assert _mean_between(low, high) == pytest.approx(exact, rel=1e-9, abs=1e-15)
    assert low <= exact <= high


# A print that is not as large as it was drawn, nor stretched alike both ways.


STRETCHED = Chessboard(4.0, 1.6, scale=(1.004, 0.997))


def test_corners_of_a_stretched_print_are_expected_where_rays_find_them() -> None:
    scene = small_scene("two_spheres_500", 504)
    expected = expect(scene, TargetPose(), STRETCHED)
    off = trace(scene, expected.pixel).plane_mm - STRETCHED.corner_mm(expected.index)
    assert np.abs(off).max() < 1e-5
    even = expect(scene, TargetPose(), Chessboard(4.0, 1.6))
    assert np.count_nonzero(expected.branch) > 0.9 * np.count_nonzero(even.branch) > 30
    steps = (
        np.linalg.det(expected.axes_px[expected.branch == 0]) / np.linalg.det(even.axes_px[even.branch == 0])[0]
    )
    assert np.median(steps) == pytest.approx(1.004 * 0.997, rel=1e-3)


def test_a_bench_that_grows_with_its_print_moves_no_residual_and_noise_does_not_shrink_it() -> None:
    scene = small_scene("two_spheres_500")
    print_sigma = (0.005, 0.005)
    bench = unknowns_of(scene, [0.0], FitTable(), print_sigma=print_sigma)
    assert bench.names[-3:-1] == ("print.stretch_x", "print.stretch_y")
    seen = expect(scene, TargetPose(), STRETCHED)
    noise = 0.3 * np.random.default_rng(1).standard_normal(seen.pixel.shape)
    whiten = np.broadcast_to(np.eye(2), (len(seen), 2, 2))
    corners = Corners(0, True, seen.pixel + noise, STRETCHED.corner_mm(seen.index), whiten)
    x, larger = np.zeros(len(bench.names)), 1.0 + 1e-4
    start, grown = bench.start, bench.start.copy()
    grown[:3] *= larger
    grown[bench.glass].reshape(-1, 5)[:, :4] *= larger
    grown[bench.print_place] = larger - 1.0
    by = bench.free(grown)
    assert bench.full(by) == pytest.approx(grown)
    assert not np.array_equal(start, grown)
    before, after = residuals(bench, x, corners), residuals(bench, by, corners)
    assert np.abs(before.value - after.value).max() < 1e-6
    assert (
        np.abs(before.rate @ by).max()
        < 1e-3 * np.abs(before.rate[:, :, bench.names.index("camera.z")] * by[2]).max()
    )


def test_each_way_of_the_stretch_moves_the_corners_that_way() -> None:
    scene = small_scene("two_spheres_500")
    bench = unknowns_of(scene, [0.0], FitTable(), print_sigma=(0.004, 0.003))
    seen = expect(scene, TargetPose(), STRETCHED)
    corners = Corners(0, True, seen.pixel, STRETCHED.corner_mm(seen.index), 1.0)
    exact = residuals(bench, np.zeros(len(bench.names)), corners).rate
    for axis, name in enumerate(("print.stretch_x", "print.stretch_y")):
        step = np.zeros(len(bench.names))
        step[bench.names.index(name)] = 0.5
        by = residuals(bench, step, corners).value - residuals(bench, -step, corners).value
        assert by == pytest.approx(exact[:, :, bench.names.index(name)], abs=1e-5)
        assert not by[:, 1 - axis].any()


@pytest.mark.slow
def test_a_print_that_nobody_measured_is_measured_by_the_balls() -> None:
    nominal = at_size(demo_scene("two_spheres_500"), 1008)
    truth, paper = misalign(nominal, 3), Print(3.5, 1.4, scale=(1.004, 0.997))
    frames = [
        TargetFrame("clear", render(truth.with_bodies(()), paper, Sensor(), samples=3, seed=1), False),
        TargetFrame("glass", render(truth, paper, Sensor(), samples=3, seed=2), True),
    ]
    fit = fit_scene(nominal, frames, Chessboard(3.5, 1.4, scale_sigma=(0.005, 0.005)))
    found = dict(zip(fit.names, zip(fit.values, fit.sigmas, strict=True), strict=True))
    (x, x_sigma), (y, y_sigma) = found["print.stretch_x"], found["print.stretch_y"]
    assert x - y == pytest.approx(0.007, abs=1e-5)
    assert 2e-4 < x_sigma < 2e-3  # as well as radii are known
    assert x == pytest.approx(0.004, abs=2.0 * x_sigma)
    assert y == pytest.approx(-0.003, abs=2.0 * y_sigma)
    grid = grid_of(truth.camera)
    seen = build_correction_map(truth, build_ray_map(truth), grid)
    error = np.linalg.norm(map_error_px(fit.scene, truth, seen.pixel[0][seen.recovered][::7], grid), axis=1)
    assert np.nanmax(error) < 0.5 * 2e-3 * 700.0  # of a scale unsure by so much


def test_a_stretched_print_hides_nothing_but_what_balls_hide() -> None:
    scene, wide = small_scene("two_spheres_500", 1008), Chessboard(2.0, 0.8, scale=(0.997, 1.012))
    seen = expect(scene.bare(), TargetPose(), wide)
    bare = trace(scene, seen.pixel).rays["key"] == DIRECT  # the others are behind a ball
    edges = np.stack((seen.axes_px[:, 0], seen.axes_px[:, 1]), axis=1)
    edges /= np.linalg.norm(edges, axis=2, keepdims=True)
    edges[wide.corner_sign(seen.index) < 0, 0] *= -1.0
    frames = [TargetFrame(name, np.zeros((1008, 1008), np.uint8), name == "glass") for name in ("clear", "glass")]
    board = Chessboard(2.0, 0.8, scale_sigma=(0.005, 0.005))
    work = Progress(scene, frames, board, FitTable(), lambda text: None)
    work.full = work.unknowns.start.copy()
    work.full[work.unknowns.print_place] = -0.003, 0.012
    work.bare = [SimpleNamespace(index=seen.index)]
    for frame, shown in zip(frames, (np.ones_like(bare), bare), strict=True):
        work.found_saddles[frame.name] = Saddles(seen.pixel[shown], edges[shown], np.ones(shown.sum()))
    glass_stage._follow_outlines(work)
    assert work.outlines is not None
    assert np.abs(work.outlines.move_mm[work.outlines.own_rim]).max() < 2.0
