"""Regions, and statistics against a known shift, on frames of the independent renderer."""

import numpy as np
import pytest

from correction.evaluate.regions import Region, evaluate_shift, regions_of, shift_errors
from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import Corrector
from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from sim.renderer.patterns import print_particles
from sim.renderer.render import render_irradiance
from tests.correction.small_scenes import small_scene
from tracer.strategies.ray_map import build_ray_map

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
