"""A print that is not as large as it was drawn, nor stretched alike both ways."""

from types import SimpleNamespace

import numpy as np
import pytest

from correction.fit import glass_stage
from correction.fit.progress import Progress
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.fit.seen.prediction import expect
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
