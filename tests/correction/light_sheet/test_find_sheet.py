"""The light sheet found in simulated frames, and the ways in which it must not be found."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import SheetError
from correction.fitted.scene_sigma import SceneSigma
from correction.light_sheet import disparities, self_calibration
from correction.light_sheet.self_calibration import find_sheet
from tests.correction.light_sheet.particle_frames import camera, frames_of, moved
from tests.slow_cases import slow
from tracer.light_sheet import LightSheet
from tracer.strategies.sensitivity import CAMERA, SPHERE

TRUTH = (0.3, 0.2, -0.15)
SIZE_PX, PAIRS = 400, 12


@pytest.fixture(scope="module")
def three():
    """Three balls in a row: a broad ring is seen directly and through two of them."""
    flow_camera = camera("three_spheres_500", SIZE_PX, TRUTH[0], TRUTH[1:])
    return flow_camera.scene, frames_of(flow_camera, PAIRS)


@pytest.fixture(autouse=True)
def few_places(monkeypatch):
    """Enough for these frames, and quick."""
    monkeypatch.setattr(self_calibration, "MOST_PLACES", 4000)
    monkeypatch.setattr(disparities, "MODELLED", 300)
    monkeypatch.setattr(disparities, "LEAST_MODELLED", 12)


def numbers(sheet):
    return np.array([sheet.z_mm, sheet.tilt_x_deg, sheet.tilt_y_deg])


def sigmas(sheet):
    return np.array([sheet.sigma_mm, sheet.tilt_sigma_deg, sheet.tilt_sigma_deg])


def test_height_and_tilt_are_found_within_their_sigma(three):
    found = find_sheet(*three)
    assert not found.verdicts
    assert (np.abs(numbers(found.sheet) - TRUTH) < 3.5 * sigmas(found.sheet)).all()
    assert found.sheet.sigma_mm < 0.05
    assert found.sheet.tilt_sigma_deg < 0.15
    depth, size = np.abs(found.cells.common_mm[:, 2 * len(np.unique(found.cells.kind)) :].T)
    assert depth.max() > 1e-4  # what is not known of these two stays in the sigma, however many cells there are
    assert size.max() > 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [1e-3, slow(0.0)])
def test_a_sheet_that_is_known_is_left_where_it_is(three, sigma):
    scene, pairs = three
    known = LightSheet(*TRUTH, sigma, sigma, thickness_mm=1.1)
    found = find_sheet(replace(scene, sheet=known), pairs)
    np.testing.assert_allclose(numbers(found.sheet), TRUTH, atol=3e-3)
    assert found.sheet.sigma_mm <= 1e-3


@pytest.mark.slow
def test_a_moved_ball_is_no_sheet(three):
    scene, pairs = three
    found = find_sheet(moved(scene, 1, (0.1, 0.0, 0.0)), pairs)
    assert "a body is not where the scene has it" in " ".join(found.verdicts)
    assert found.sheet.z_mm == 0.0
    assert found.sheet.sigma_mm == 0.5


@pytest.mark.slow
def test_a_ball_moved_along_the_view_is_no_sheet_far_from_what_was_known(three):
    scene, pairs = three
    found = find_sheet(moved(scene, 2, (0.0, 0.0, 0.3)), pairs)
    assert "a body is not where the scene has it" in " ".join(found.verdicts)
    assert found.sheet.z_mm == 0.0
    assert found.sheet.sigma_mm == 0.5


@pytest.mark.slow
@pytest.mark.parametrize("step_mm", [0.4, 0.6])
def test_a_ball_moved_along_the_view_makes_no_sheet_up(three, step_mm):
    """It looks like another height: what is given is right within its sigma, or left as it was and said.

    Views of one kind only, as in these frames, tell no smaller moves from a sheet within what was known of it.
    """
    scene, pairs = three
    found = find_sheet(moved(scene, 2, (0.0, 0.0, step_mm)), pairs)
    if found.verdicts:
        assert found.sheet.sigma_mm == 0.5 or abs(found.sheet.z_mm - TRUTH[0]) < 3.5 * found.sheet.sigma_mm
    else:
        assert (np.abs(numbers(found.sheet) - TRUTH) < 3.5 * sigmas(found.sheet)).all()


@pytest.mark.slow
def test_a_scene_that_is_unsure_makes_the_sheet_unsure(three):
    """A ball 0.08 mm beside its place along the view, and a fit that knew it to 0.08 mm."""
    scene, pairs = three
    step = 0.08
    beside = moved(scene, 2, (0.0, 0.0, step))
    root = np.zeros((len(CAMERA) + len(SPHERE) * len(scene.spheres), 1))
    root[len(CAMERA) + 2 * len(SPHERE) + 2, 0] = step
    told = find_sheet(beside, pairs, SceneSigma(beside.content_hash(), root))
    assert abs(told.sheet.z_mm - TRUTH[0]) < 2.0 * told.sheet.sigma_mm < 0.8


@pytest.mark.slow
def test_a_scene_that_is_wrong_and_believed_makes_the_sheet_wrong(three):
    """What the sigma of the fit is for."""
    scene, pairs = three
    exact = find_sheet(moved(scene, 2, (0.0, 0.0, 0.08)), pairs)
    assert abs(exact.sheet.z_mm - TRUTH[0]) > 3.0 * exact.sheet.sigma_mm


def test_nothing_seen_twice_is_said(three):
    scene, pairs = three
    found = find_sheet(scene.with_bodies(()), pairs)
    assert "no particle of this view is seen twice" in found.verdicts[0]
    assert found.sheet == LightSheet()


def test_frames_without_particles_tell_nothing(three):
    scene, _ = three
    rng = np.random.default_rng(1)
    noise = [tuple(rng.normal(40.0, 2.0, (2, *scene.camera.shape)).astype(np.float32)) for _ in range(10)]
    found = find_sheet(scene, lambda: iter(noise))
    assert "do not agree anywhere" in found.verdicts[0]
    assert found.sheet == LightSheet()


@pytest.mark.parametrize("count", [0, 4])
def test_few_pairs_are_refused(three, count):
    scene, pairs = three
    with pytest.raises(SheetError, match=f"{count} pairs of frames .* give 10 or more"):
        find_sheet(scene, lambda: iter(list(pairs())[:count]))


@pytest.mark.slow
def test_sparse_particles_behind_one_ball_do_not_weigh_down_their_own_places():
    """With a few particles in each square of pixels, weights followed them and no sheet was found."""
    flow_camera = camera("one_sphere_500", 504, 0.25)
    found = find_sheet(flow_camera.scene, frames_of(flow_camera, 20))
    assert abs(found.sheet.z_mm - 0.25) < min(0.03, 4.0 * found.sheet.sigma_mm)
    assert found.sheet.thickness_mm < 2.0  # 1.0 mm in truth
