"""Sigma of place and displacement against scenes drawn from the covariance and traced plainly."""

from dataclasses import replace

import numpy as np
import pytest

from correction.evaluate.regions import Region, evaluate_shift, regions_of, shift_errors
from correction.fit.solve.unknowns import unknowns_of
from correction.fitted.map_sigma import vector_map_sigma
from correction.fitted.scene_sigma import SceneSigma
from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import Corrector
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from sim.renderer.patterns import print_particles
from sim.renderer.render import render_irradiance
from tests.correction.evaluate.vectors import uniform_field
from tests.correction.small_scenes import small_scene
from tests.slow_cases import slow
from tracer.errors import StaleMap
from tracer.scene.fit_section import FitCameraTable, FitSphereTable, FitTable
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import trace

PRIORS = FitTable(
    camera=FitCameraTable(position_mm=0.05, rotation_deg=0.005, k1=0.001),
    spheres=FitSphereTable(centre_mm=0.02, radius_mm=0.004),
    n=0.0005,
)
SHIFT_PX = (4.0, -2.0)
DRAWS = 800  # their spread is known to 1/sqrt(1600)


@pytest.fixture(scope="module")
def known():
    """A bench with correlated numbers, as a fit leaves them: its sigma, its map, and what draws x."""
    scene = small_scene("tilted_pair", 252)
    low, high = scene.spheres
    scene = scene.with_bodies([replace(low, centre_mm=(-12.0, 8.0, 26.0)), high])
    bench = unknowns_of(scene, [0.0], PRIORS)
    rng = np.random.default_rng(4)
    mix = np.eye(len(bench.names)) + 0.2 * rng.normal(size=(len(bench.names),) * 2)
    columns = bench.columns[: bench.glass.stop]  # the nominal rotation vector is 0, its left Jacobian 1
    sigma = SceneSigma(scene.content_hash(), columns @ mix)
    return bench, sigma, build_correction_map(scene, build_ray_map(scene)), lambda: mix @ rng.normal(size=len(mix))


def drawn_landings(bench, draw, pixels, glass):
    for _ in range(DRAWS):
        scene = bench.scene_at(bench.full(draw()))
        yield trace(scene if glass else scene.with_bodies(()), pixels).plane_mm


@pytest.mark.slow
@pytest.mark.parametrize("glass", [True, slow(False)])
def test_sigma_is_the_spread_of_drawn_scenes(known, glass):
    bench, sigma, cmap, draw = known
    scene = bench.scene
    if not glass:
        scene = scene.with_bodies(())
        cmap = build_correction_map(scene, build_ray_map(scene))
    field = uniform_field(cmap.grid.shape, SHIFT_PX, step_px=16)
    found = vector_map_sigma(field, cmap, scene, sigma)
    half = np.array(SHIFT_PX, int) // 2
    ends = [field.grid_px.astype(int) + way * half for way in (0, -1, 1)]
    seen = [cmap.pixel[0, end[..., 1], end[..., 0]] for end in ends]
    branch = [np.where(cmap.recovered, cmap.branch[0] + 1, 0)[end[..., 1], end[..., 0]] for end in ends]
    alike = (branch[0] == branch[1]) & (branch[0] == branch[2]) & (branch[0] > 0)
    assert (np.isfinite(found.displacement_px).all(axis=-1) >= alike).all()
    pixels = np.concatenate([pixel[alike] for pixel in seen])
    landed = np.array(list(drawn_landings(bench, draw, pixels, glass))).reshape(DRAWS, 3, -1, 2)
    place = np.nanstd(landed[:, 0], axis=0) / cmap.grid.pitch_mm
    gaps = landed[:, 2] - landed[:, 1]
    gap = np.nanstd(gaps, axis=0) / cmap.grid.pitch_mm
    assert np.median(found.position_px[alike] / place) == pytest.approx(1.0, abs=0.06)
    assert np.median(found.displacement_px[alike] / gap) == pytest.approx(1.0, abs=0.06)
    assert np.mean(np.abs(found.displacement_px[alike] / gap - 1.0) < 0.25) > 0.95
    # What a draw makes of all displacements alike is no part of one against the median of the field.
    beside = np.nanstd(gaps - np.nanmedian(gaps, axis=1, keepdims=True), axis=0) / cmap.grid.pitch_mm
    assert np.median(found.relative_px[alike] / beside) == pytest.approx(1.0, abs=0.06)
    # What both ends share cancels: a displacement is known far better than a place.
    assert np.median(found.displacement_px[alike]) < 0.1 * np.median(found.position_px[alike])


def test_no_displacement_no_uncertainty_and_nothing_where_nothing_is_seen(known):
    bench, sigma, cmap, _ = known
    still = uniform_field(cmap.grid.shape, (0.0, 0.0), step_px=16)
    found = vector_map_sigma(still, cmap, bench.scene, sigma)
    seen = np.isfinite(found.position_px[..., 0])
    assert seen.any()
    assert np.nanmax(found.displacement_px) < 1e-9
    recovered = cmap.recovered[still.grid_px[..., 1].astype(int), still.grid_px[..., 0].astype(int)]
    assert not (seen & ~recovered).any()
    assert seen.sum() >= 0.99 * recovered.sum()  # at a rim, half a pixel beside a recovered node may land nowhere


def test_another_scene_is_refused(known):
    bench, sigma, cmap, _ = known
    other = small_scene("two_spheres_500", 252)
    with pytest.raises(StaleMap):
        vector_map_sigma(uniform_field(cmap.grid.shape, SHIFT_PX), cmap, other, sigma)
    with pytest.raises(StaleMap, match="calibrate again"):
        sigma.check(other)
    with pytest.raises(StaleMap, match="spheres"):
        sigma.spread(bench.scene.with_bodies(bench.scene.bodies[:1]), np.zeros((1, 2)))


# The third test of the paper, on the simulated bench: a jet behind two balls, no jump of its mean at the rim.
#
# An unsteady jet of fresh particles in a light sheet 4 mm behind two balls, with static glare on every frame.
# As in the paper: correct, subtract the time minimum of 4 frames before and after (each pulse by itself),
# normalise by the local minimum and maximum, correlate, average.


SIDE_PX = 448  # the middle of a sensor of 1008 px: the balls and 6 mm around
SPEED_PX, WIDTH_PX = 12.0, 60.0


def jet(rng):
    """Displacement [px, v down] of one moment at corrected pixels about the middle: a jet upwards that flaps."""
    phase, sway = rng.uniform(0, 2 * np.pi, 4), rng.normal(0.0, 6.0)
    middle = 0.5 * (SIDE_PX - 1)

    def field(u, v):
        x, y = u - middle, v - middle
        wide = WIDTH_PX * (1.0 - y / (4 * SIDE_PX))
        mean = SPEED_PX * np.exp(-(((x - sway * np.sin(y / 90.0 + phase[0])) / wide) ** 2))
        across = 1.0 * np.sin(x / 70.0 + phase[1]) * np.cos(y / 80.0 + phase[2])
        return across, -mean + 0.8 * np.sin(y / 75.0 + phase[3])

    return field


# Regions, and statistics against a known shift, on frames of the independent renderer.


SETTINGS = PivSettings(windows_px=(32, 32, 32))
SHIFT_MM = np.array([0.9, 0.6])


@pytest.fixture(scope="module")
def seen():
    """A ball before a particle sheet that moves by SHIFT_MM, seen by the independent renderer."""
    scene = small_scene("one_sphere_250", 504)
    ray_map = build_ray_map(scene)
    sheet = print_particles((200.0, 200.0), scene.camera.focal_px / 250.0, seed=5)
    moved = [sheet.displace(tuple(part * SHIFT_MM)) for part in (-0.5, 0.5)]
    frames = [1000.0 * render_irradiance(scene, print_, samples=3) for print_ in moved]
    return scene, ray_map, build_correction_map(scene, ray_map), frames


def test_the_image_route_finds_the_shift_behind_the_ball(seen):
    scene, _, cmap, frames = seen
    corrector = Corrector(cmap)
    field = evaluate_pair(corrector(frames[0]), corrector(frames[1]), corrector.recovered, settings=SETTINGS)
    regions = regions_of(field, cmap, scene)
    truth = (SHIFT_MM[0] / cmap.grid.pitch_mm, -SHIFT_MM[1] / cmap.grid.pitch_mm)
    result = evaluate_shift(field, regions, truth)
    direct, middle = result.regions["seen directly"], result.regions["behind glass, r < 0.75 R"]
    assert direct.count > 100
    assert middle.count > 5
    for found, limit in ((direct, 0.05), (middle, 0.10)):
        assert max(np.abs(found.bias_px)) < 0.02
        assert max(found.std_px) < limit
    assert result.valid == field.valid.sum()
    assert result.to_dict()["regions"]["seen directly"]["count"] == direct.count


def test_regions_do_not_mix_pictures(seen):
    scene, _, cmap, frames = seen
    corrector = Corrector(cmap)
    field = evaluate_pair(corrector(frames[0]), corrector(frames[1]), corrector.recovered, settings=SETTINGS)
    regions = regions_of(field, cmap, scene)
    half = field.window_px // 2
    code = np.where(cmap.recovered, cmap.branch[0].astype(int) + 1, 0)
    for row, v in enumerate(field.y_px):
        for column, u in enumerate(field.x_px):
            top, left = int(v + 0.5) - half, int(u + 0.5) - half
            window = code[top : top + 2 * half, left : left + 2 * half]
            kinds = set(np.unique(window[window > 0]))
            region = regions.region[row, column]
            if region == Region.DIRECT:
                assert kinds == {1}
            elif region == Region.GLASS:
                assert kinds == {2}
            elif region == Region.NONE:
                assert kinds == set()
    centre = scene.bodies[0].centre_mm[:2]
    some = regions.region == Region.GLASS
    places = cmap.grid.to_mm(field.grid_px)[some]
    assert np.allclose(regions.radius[some], np.linalg.norm(places - centre, axis=1) / 50.0)


def test_errors_are_only_stated_for_measured_vectors(seen):
    _, _, cmap, frames = seen
    corrector = Corrector(cmap)
    field = evaluate_pair(corrector(frames[0]), corrector(frames[1]), corrector.recovered, settings=SETTINGS)
    errors = shift_errors(field, (1.0, 2.0))
    assert np.isnan(errors[~field.valid]).all()
    assert np.array_equal(errors[field.valid][:, 1], field.v_px[field.valid] - 2.0)
