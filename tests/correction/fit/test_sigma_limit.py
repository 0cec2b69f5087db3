"""Nodes of which the map is not sure enough are left out, and none of the others."""

import numpy as np
import pytest

from correction.errors import MapUsageError
from correction.fitted.map_sigma import SigmaLimit
from correction.fitted.prepared import content_key, prepare
from correction.fitted.scene_sigma import SceneSigma
from correction.maps.correction_map import CorrectionMap
from correction.node_status import NodeStatus
from tests.correction.small_scenes import small_scene
from tracer.errors import StaleMap
from tracer.strategies.sensitivity import CAMERA, SPHERE

LIMIT_PX = 0.06


@pytest.fixture(scope="module")
def scene():
    return small_scene("two_spheres_500", 240)


@pytest.fixture(scope="module")
def sigma(scene):
    """Every ball known to 20 um along each axis, the camera exactly."""
    root = np.zeros((len(CAMERA) + len(SPHERE) * len(scene.spheres), 3 * len(scene.spheres)))
    for ball in range(len(scene.spheres)):
        first = len(CAMERA) + len(SPHERE) * ball
        root[first : first + 3, 3 * ball : 3 * ball + 3] = 2e-2 * np.eye(3)
    return SceneSigma(scene.content_hash(), root)


def worst_px(found: CorrectionMap, scene, sigma) -> np.ndarray:
    """Sigma of every node (h, w), the worse axis; NaN where nothing is recovered."""
    worst = np.full(found.grid.shape, np.nan)
    behind = found.behind_glass
    worst[behind] = sigma.sigma(scene, found.pixel[0][behind]).max(axis=1) / found.grid.pitch_mm
    return worst


@pytest.mark.slow
def test_what_is_less_sure_is_left_out_and_little_else(scene, sigma):
    whole = prepare(scene).corrector.map
    kept = prepare(scene, limit=SigmaLimit(sigma, LIMIT_PX)).corrector
    worst = worst_px(whole, scene, sigma)
    unsure = kept.status == NodeStatus.UNSURE
    assert 0.01 < unsure.mean() < 0.5
    assert np.mean(kept.recovered[worst > LIMIT_PX]) < 0.02
    assert np.mean(kept.recovered[worst < 0.8 * LIMIT_PX]) > 0.98
    assert np.array_equal(kept.recovered | unsure, whole.recovered)
    corrected = kept(np.full(scene.camera.shape, 100, np.uint8))
    assert np.isnan(corrected[unsure]).all()
    assert np.isfinite(corrected[kept.recovered]).all()


def test_a_limited_map_survives_the_disk(scene, sigma, tmp_path):
    limited = SigmaLimit(sigma, LIMIT_PX).within(prepare(scene).corrector.map, scene)
    limited.save(tmp_path / "map")
    assert np.array_equal(CorrectionMap.load(tmp_path / "map").status, limited.status)


def test_a_limit_is_part_of_the_key(scene, sigma):
    keys = [content_key(scene, limit=limit) for limit in (None, SigmaLimit(sigma, 0.1), SigmaLimit(sigma, 0.2))]
    assert len(set(keys)) == 3


def test_a_limit_of_another_scene_or_of_nothing_is_refused(scene, sigma):
    with pytest.raises(StaleMap, match="calibrate again"):
        prepare(small_scene("one_sphere_500", 96), limit=SigmaLimit(sigma, 0.1))
    with pytest.raises(MapUsageError, match="leaves nothing"):
        SigmaLimit(sigma, 0.0)
