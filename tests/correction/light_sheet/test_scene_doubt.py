"""What an unsure scene makes of the sheet: errors that all cells share do not become less with their number."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fitted.scene_sigma import SceneSigma
from correction.light_sheet.disparities import Disparities
from correction.light_sheet.double_views import double_views
from correction.light_sheet.self_calibration import fit_plane, scene_doubt
from tests.correction.light_sheet.particle_frames import camera, moved
from tracer.strategies.sensitivity import CAMERA, SPHERE, landings

KNOWN = np.zeros(3), np.diag([0.5**2, 0.01**2, 0.01**2])


def cells(height_mm, common_mm, count=40):
    """Cells of one kind that all see a height, to 0.02 mm each."""
    rng = np.random.default_rng(1)
    one = np.ones(count)
    return Disparities(
        rng.uniform(-20.0, 20.0, (count, 2)), np.arange(count), np.zeros(count, int), 0.2 * one,
        height_mm + 0.02 * rng.normal(size=count), 0.02 * one, np.full((count, 1), common_mm), 0.0 * one,
        0.1 * one, one, np.full(count, 50), (0.03, 0.01), 0.1,
    )  # fmt: skip


def test_what_all_cells_share_stays_in_the_sigma():
    alone, shared = (fit_plane(cells(0.1, common), *KNOWN) for common in (0.0, 0.08))
    assert np.sqrt(alone.covariance[0, 0]) < 0.005
    assert np.sqrt(shared.covariance[0, 0]) == pytest.approx(0.08, rel=0.05)
    assert shared.step[0] == pytest.approx(alone.step[0], abs=0.01)
    assert shared.step.shape == (3,)


def test_a_kind_that_is_told_to_be_wrong_counts_less():
    good, wrong = cells(0.0, 0.0), cells(0.3, 0.3)
    both = {name: np.concatenate((getattr(good, name), value)) for name, value in vars(wrong).items()
            if isinstance(value, np.ndarray)}  # fmt: skip
    found = fit_plane(Disparities(**{**vars(good), **both}), *KNOWN)
    assert abs(found.step[0]) < 0.02


@pytest.mark.parametrize("axis", [0, 2])
def test_heights_move_as_traced_views_do(axis):
    """A ball elsewhere: what was seen at one place in both views is not any more, by as much as is said."""
    scene = camera("three_spheres_500", 252).scene
    views = double_views(scene, step=2, most=80)
    cell = np.arange(len(views.kind)) % 7  # so few that all places of a cell count
    root = np.zeros((len(CAMERA) + len(SPHERE) * len(scene.spheres), 1))
    step = 1e-4
    root[len(CAMERA) + 2 * len(SPHERE) + axis, 0] = step
    told = scene_doubt(scene, views, cell, SceneSigma(scene.content_hash(), root))
    there = moved(scene, 2, step * np.eye(3)[axis])
    off = [landings(there, views.chief_px[:, k]).point_mm - landings(scene, views.chief_px[:, k]).point_mm
           for k in (0, 1)]  # fmt: skip
    gap = np.sum((off[1] - off[0]) * views.towards, axis=1) / views.parallax
    assert told.shape == (7, 1)
    assert np.abs(gap).max() > 0.5 * step
    for number in range(7):
        assert told[number, 0] == pytest.approx(np.mean(gap[cell == number]), rel=0.02, abs=0.01 * step)


def test_the_plane_itself_is_no_doubt_of_the_glass():
    scene = camera("three_spheres_500", 252).scene
    views = double_views(scene, step=4, most=60)
    root = np.zeros((len(CAMERA) + len(SPHERE) * len(scene.spheres), 2))
    sigma = SceneSigma(scene.content_hash(), root).in_light_sheet(replace(scene, sheet=None))
    assert not scene_doubt(scene, views, np.zeros(len(views.kind), int), sigma).any()
