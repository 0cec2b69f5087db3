"""Regions, statistics against a known shift, and both routes, on frames of the independent renderer."""

import numpy as np
import pytest

from correction.evaluate.carried_vectors import raw_settings, velocity_route
from correction.evaluate.regions import Region, evaluate_shift, regions_of, shift_errors
from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import Corrector
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.errors import PairError
from sim.renderer.patterns import printed_particles
from sim.renderer.render import render_irradiance
from tests.correction.small_scenes import small_scene
from tracer.errors import StaleMap
from tracer.strategies.ray_map import build_ray_map

SETTINGS = PivSettings(windows_px=(32, 32, 32))
SHIFT_MM = np.array([0.9, 0.6])


@pytest.fixture(scope="module")
def seen():
    """A ball before a particle sheet that moves by SHIFT_MM, seen by the independent renderer."""
    scene = small_scene("one_sphere_250", 504)
    ray_map = build_ray_map(scene)
    sheet = printed_particles((200.0, 200.0), scene.camera.focal_px / 250.0, seed=5)
    moved = [sheet.displaced(tuple(part * SHIFT_MM)) for part in (-0.5, 0.5)]
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


def test_the_velocity_route_agrees_in_the_middle(seen):
    scene, ray_map, cmap, frames = seen
    vectors = velocity_route(*frames, scene, ray_map, PivSettings(windows_px=(64, 32, 32)))
    error_px = (vectors.shift_mm - SHIFT_MM) / cmap.grid.pitch_mm
    radius = np.hypot(*vectors.place_mm.T) / 50.0
    direct, middle = vectors.branch == 0, (vectors.branch > 0) & (radius < 0.15)
    for where, limit in ((direct, 0.08), (middle, 0.15)):
        assert where.sum() > 10
        assert np.abs(np.median(error_px[where], axis=0)).max() < 0.03
        assert np.median(np.abs(error_px[where])) < limit


def test_a_map_of_another_scene_is_refused(seen):
    _, ray_map, _, frames = seen
    with pytest.raises(StaleMap):
        velocity_route(*frames, small_scene("two_spheres_500", 504), ray_map)


def test_errors_are_only_stated_for_measured_vectors(seen):
    _, _, cmap, frames = seen
    corrector = Corrector(cmap)
    field = evaluate_pair(corrector(frames[0]), corrector(frames[1]), corrector.recovered, settings=SETTINGS)
    errors = shift_errors(field, (1.0, 2.0))
    assert np.isnan(errors[~field.valid]).all()
    assert np.array_equal(errors[field.valid][:, 1], field.v_px[field.valid] - 2.0)


def test_frames_without_texture_are_no_pair(seen):
    scene, ray_map, _, _ = seen
    flat = np.full(scene.camera.shape, 100, np.uint16)
    with pytest.raises(PairError):
        velocity_route(flat, flat, scene, ray_map)


def test_raw_frames_get_a_larger_first_window_where_it_fits():
    assert raw_settings(SETTINGS, (500, 400)).windows_px == (64, *SETTINGS.windows_px)
    assert raw_settings(SETTINGS, (500, 50)) == SETTINGS
