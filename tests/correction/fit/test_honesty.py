"""Is one sigma one sigma?  Scenes drawn from the prior, corners with known noise, true error of the fitted map."""

from dataclasses import replace

import numpy as np

from correction.fit.adjustment import Adjustment, root_of
from correction.fit.seen.measurement import MeasuredFrame, whitening
from correction.fit.seen.prediction import expect
from correction.fit.solve.considered import ShapeRoot
from correction.fit.solve.solver import Corners
from correction.fit.solve.unknowns import Unknowns, unknowns_of
from correction.fitted.map_sigma import sigma_at
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene
from tracer.scene.fit_section import FitCameraTable, FitSphereTable, FitTable
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose
from tracer.strategies.trace import trace

BOARD = Chessboard(5.0, 2.0)
NOISE_PX = 0.05
PRIORS = FitTable(
    camera=FitCameraTable(position_mm=0.5, rotation_deg=0.05, k1=0.02),
    spheres=FitSphereTable(centre_mm=0.15, radius_mm=0.02),
    n=0.002,
)


def seen(scene: Scene, glass: bool, rng: np.random.Generator) -> MeasuredFrame:
    """What a perfect detector with noise would report."""
    shown = expect(scene if glass else scene.with_bodies(()), TargetPose(), BOARD)
    shown = shown.take(shown.rim_px > 6.0)
    pixel = shown.pixel + rng.normal(0.0, NOISE_PX, shown.pixel.shape)
    sigma = np.full_like(pixel, NOISE_PX)
    corners = Corners(0, glass, pixel, BOARD.corner_mm(shown.index), whitening(sigma))
    way = np.array([" > ".join(names) for names in shown.branches])[shown.branch]
    return MeasuredFrame("drawn", corners, shown.index, shown.axes_px, way, shown.rim_px, sigma, {}, {})


def bench_off_axis() -> Unknowns:
    scene = at_size(demo_scene("pair_off_axis"), 700)
    low, high = scene.spheres  # clear of the plane and of each other, so that no draw is impossible
    low, high = replace(low, centre_mm=(-14.0, 9.0, 23.0)), replace(high, centre_mm=(20.0, -12.0, 70.0))
    return unknowns_of(scene.with_bodies([low, high]), [0.0], PRIORS)


def drawn(bench: Unknowns, rng: np.random.Generator) -> Scene:
    return bench.scene_at(bench.full(np.clip(rng.normal(size=len(bench.names)), -2.5, 2.5)))


def test_sigma_is_the_spread_of_landing_points_under_the_covariance():
    """Draw scenes of round balls from the covariance, trace them, compare the spread: nothing linearised here."""
    bench, rng = bench_off_axis(), np.random.default_rng(42)
    truth = drawn(bench, rng)
    fit = Adjustment().estimate(bench, bench.start, [seen(truth, glass, rng) for glass in (False, True)], ())
    fit = replace(fit, root=fit.unknowns.columns @ root_of(fit.covariance), shapes=ShapeRoot())
    pixels = fit.corners.pixel[fit.corners.behind & fit.corners.inlier][::7]
    predicted = sigma_at(fit, pixels, True)
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(fit.covariance)
    landing = [
        trace(
            fit.unknowns.scene_at(fit.unknowns.full(fit.x + root @ rng.normal(size=len(fit.x)))), pixels
        ).plane_mm
        for _ in range(150)
    ]
    np.testing.assert_allclose(np.std(landing, axis=0), predicted, rtol=0.25)
