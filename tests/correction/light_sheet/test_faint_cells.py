"""Cells too faint to be matched alone tell their heights all the same, and noise draws them to no side.

No frame is drawn and no optics is tested: planes of products are those of a sheet at a known height, with noise.
Whether the optics behind them are right is for frames of the simulator (`test_find_sheet.py`).
"""

from dataclasses import replace

import numpy as np
import pytest

from correction.light_sheet import disparities
from correction.light_sheet.double_views import ACROSS, double_views
from correction.light_sheet.layers import Model
from correction.light_sheet.self_calibration import _cells, _inside
from tests.correction.light_sheet.particle_frames import camera
from tracer.light_sheet import LightSheet

HEIGHT_MM, REACH, REACH_MM, DRAWS = 0.2, 5, 1.2, 4
NOISE = 0.35  # of the highest peak of a tenth of the frames: a cell tells its height to 0.3 mm


@pytest.fixture(scope="module")
def ring():
    """The ring that two balls show twice, where a lag is 3 mm of height, and what layers make of its cells."""
    scene = replace(camera("two_spheres_500", 1008, crop_px=560).scene, sheet=LightSheet(0.0)).in_light_sheet()
    views = _inside(double_views(scene, step=2), scene.camera.shape, REACH)
    views, cell = _cells(views, scene)
    with pytest.MonkeyPatch.context() as few:
        few.setattr(disparities, "MODELLED", 300)
        few.setattr(disparities, "LEAST_MODELLED", 12)
        models = disparities._models(scene, views, cell, np.ones(len(cell)), REACH, REACH_MM)
    return scene, views, cell, models


@pytest.mark.slow
def test_faint_cells_are_all_heard(ring, monkeypatch):
    scene, views, cell, models = ring
    monkeypatch.setattr(disparities, "_models", lambda *_: models)
    true = np.array([HEIGHT_MM, 0.0, disparities.USUAL_SPREAD2[0], disparities.USUAL_SIZE[0]])
    planes = np.array([model.plane(true) for model in models]).reshape(len(models), -1, 2 * ACROSS + 1)
    places = np.bincount(cell)
    noise = NOISE * planes.max() * np.sqrt(places.mean() / places)[:, None, None]
    rng = np.random.default_rng(3)
    off = []
    for _ in range(DRAWS):
        drawn = planes + noise * rng.standard_normal((disparities.BLOCKS, *planes.shape))
        found = disparities._match_planes(scene, views, cell, np.ones(len(cell)), drawn, REACH_MM)
        assert len(found.kind) == len(models)  # none is left out for what noise made of it
        weight = found.height_sigma_mm**-2.0
        off.append((weight @ found.height_mm / weight.sum() - HEIGHT_MM) * np.sqrt(weight.sum()))
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.7
    assert abs(np.mean(off)) < 3.0 / np.sqrt(DRAWS)


def test_a_step_from_a_match_finds_what_a_search_finds(ring):
    """One step is enough from as far as cells lie from their mean, and takes other light for no other height."""
    model = ring[-1][1]
    usual = [disparities.USUAL_SPREAD2[0], disparities.USUAL_SIZE[0]]
    free = [disparities.HEIGHT, disparities.SHIFT]
    plane = 3.0 * model.plane(np.array([0.1, 0.05, *usual])) + 0.2
    start = model.fit(plane, np.array([0.0, 0.0, *usual]), free)
    np.testing.assert_allclose(start.values[:2], (0.1, 0.05), atol=1e-3)
    beside = 3.0 * model.plane(np.array([0.4, 0.15, *usual])) + 0.2
    np.testing.assert_allclose(model.beside(beside, start, free)[:2], (0.4, 0.15), atol=0.02)


def test_a_cell_that_shows_no_layer_tells_nothing(ring, monkeypatch):
    """Or next to nothing: one step from a match may lead anywhere then, and its sigma has to say so."""
    scene, views, cell, models = ring
    dark = models[0]
    faint = Model(dark.height_mm, 1e-26 * dark.small, 1e-26 * dark.large)
    none = Model(dark.height_mm, 0.0 * dark.small, 0.0 * dark.large)
    monkeypatch.setattr(disparities, "_models", lambda *_: [faint, none, *models[2:]])
    true = np.array([HEIGHT_MM, 0.0, disparities.USUAL_SPREAD2[0], disparities.USUAL_SIZE[0]])
    planes = np.array([model.plane(true) for model in models]).reshape(len(models), -1, 2 * ACROSS + 1)
    noise = NOISE * planes.max() * np.random.default_rng(3).standard_normal((disparities.BLOCKS, *planes.shape))
    found = disparities._match_planes(scene, views, cell, np.ones(len(cell)), planes + noise, REACH_MM)
    assert np.isfinite(found.height_mm).all()
    assert 1 not in found.number
    assert (found.height_sigma_mm[found.number == 0] > 10.0 * np.median(found.height_sigma_mm)).all()
