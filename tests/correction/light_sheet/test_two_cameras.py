"""The plane of a light sheet from disparities: a known plane, its sigma, outliers, and what no plane explains."""

import numpy as np
import pytest

from correction.errors import SheetError
from correction.light_sheet.two_cameras import fit_sheet, name_moved
from tracer.light_sheet import LightSheet

PLANE = np.array([0.4, 0.01, -0.02])
SIGMA_MM = 0.01


def disparity(rng, slope_spread=0.1):
    """Places, disparities of the plane with noise, sigmas, and slopes that differ from place to place."""
    place = rng.uniform(-30.0, 30.0, (400, 2))
    slope = np.array([0.3, 0.0]) + slope_spread * rng.standard_normal((400, 2))
    height = PLANE[0] + place @ PLANE[1:]
    sigma = SIGMA_MM * rng.uniform(0.5, 2.0, (400, 2))
    return place, -slope * height[:, None] + sigma * rng.standard_normal((400, 2)), sigma, slope


@pytest.mark.slow
def test_the_plane_and_its_sigma():
    off, said = [], []
    for seed in range(60):
        found = fit_sheet(*disparity(np.random.default_rng(seed)), 1.0)
        off.append(found.plane - PLANE)
        said.append(np.sqrt(np.diagonal(found.covariance)))
    ratio = np.array(off) / np.array(said)
    assert np.sqrt(np.mean(np.square(ratio))) == pytest.approx(1.0, abs=0.15)
    assert np.abs(ratio.mean(axis=0)).max() < 0.4


def test_rims_that_are_wrong_pull_little():
    place, apart, sigma, slope = disparity(np.random.default_rng(3))
    apart[:40] += 0.5
    found = fit_sheet(place, apart, sigma, slope, 1.0)
    assert found.plane[0] == pytest.approx(PLANE[0], abs=0.01)
    assert found.residual_sigma < 1.5


def test_a_camera_that_stands_elsewhere_is_left_over():
    place, apart, sigma, slope = disparity(np.random.default_rng(4))
    apart[:, 1] += 0.1
    found = fit_sheet(place, apart, sigma, slope, 1.0)
    assert found.residual_sigma > 2.0
    assert found.residual_mm > 0.02


def test_overlapping_windows_are_worth_less():
    given = disparity(np.random.default_rng(5))
    whole, quarter = (fit_sheet(*given, share) for share in (1.0, 0.25))
    np.testing.assert_allclose(quarter.covariance, 4.0 * whole.covariance)


def test_a_shift_of_all_places_is_in_sigma():
    place, apart, sigma, slope = disparity(np.random.default_rng(8), slope_spread=0.02)
    alone, common = (fit_sheet(place, apart, sigma, slope, 1.0, mm) for mm in (0.0, 0.02))
    shifted = fit_sheet(place, apart + np.array([0.02, 0.0]), sigma, slope, 1.0)
    moved = abs(shifted.plane[0] - alone.plane[0])
    assert moved > 0.05  # 0.02 mm over a slope of 0.3
    assert np.sqrt(common.covariance[0, 0] - alone.covariance[0, 0]) == pytest.approx(moved, rel=0.1)


def test_the_sheet_is_over_the_known_one():
    found = fit_sheet(*disparity(np.random.default_rng(6)), 1.0)
    sheet = found.sheet(LightSheet(z_mm=1.0, tilt_x_deg=0.5, thickness_mm=0.8))
    assert sheet.z_mm == pytest.approx(1.0 + found.plane[0])
    assert sheet.slopes[0] == pytest.approx(np.tan(np.deg2rad(0.5)) + found.plane[1])
    assert sheet.thickness_mm == 0.8
    known = sheet.root() @ sheet.root().T
    assert known[0, 0] == pytest.approx(found.covariance[0, 0])
    assert known[0, 1] == pytest.approx(found.covariance[0, 1], rel=0.01, abs=1e-12)


def test_views_that_are_alike_tell_nothing():
    place, apart, sigma, slope = disparity(np.random.default_rng(7))
    with pytest.raises(SheetError, match="alike"):
        fit_sheet(place, apart, sigma, 0.0 * slope, 1.0)
    with pytest.raises(SheetError, match="too few places"):
        fit_sheet(place, np.nan * apart, sigma, slope, 1.0)


def pose_rates(rng, place):
    """Derivatives of landing points by the poses of two cameras: each looks through a ball elsewhere."""
    found = []
    for middle in (-12.0, 12.0):
        rates = np.zeros((len(place), 2, 6))
        rates[:, 0, 0] = rates[:, 1, 1] = 1.0
        rates[:, :, 2] = -place / 500.0
        rates[:, 0, 4], rates[:, 1, 3] = 500.0, -500.0
        rates[:, 0, 5], rates[:, 1, 5] = -place[:, 1], place[:, 0]
        behind = np.hypot(place[:, 0] - middle, place[:, 1]) < 10.0
        rates[behind] *= -0.6 + 0.1 * rng.standard_normal((behind.sum(), 1))[..., None]
        found.append(rates)
    return found


@pytest.mark.parametrize("view", [0, 1])
@pytest.mark.parametrize(
    "change", [(0.1, 0, 0, 0, 0, 0), (0, 0.1, 0, 0, 0, 0), (0, 0, 0, 2e-4, 0, 0), (0, 0, 0.3, 0, 0, 0)]
)
def test_the_camera_that_was_moved_is_named(view, change):
    rng = np.random.default_rng(11)
    place, apart, sigma, slope = disparity(rng)
    rates = pose_rates(rng, place)
    signed = [rates[0], -rates[1]]
    apart = apart + signed[view] @ np.array(change, float)
    alone = fit_sheet(place, apart, sigma, slope, 1.0)
    found = name_moved(alone, (place, apart, sigma, slope), signed, 1.0)
    assert found.moved == (view,)
    shift = np.sqrt(np.square(rates[view] @ np.array(change, float)).sum(axis=1).mean())
    assert 0.5 * shift < found.moved_mm < 1.3 * shift  # another sheet explains a part of it


def test_no_camera_is_named_without_cause():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        place, apart, sigma, slope = disparity(rng)
        rates = pose_rates(rng, place)
        data = place, apart, sigma, slope
        assert name_moved(fit_sheet(*data, 1.0), data, [rates[0], -rates[1]], 1.0).moved == ()


def test_a_shift_that_no_ball_shows_names_both():
    rng = np.random.default_rng(12)
    place, apart, sigma, slope = disparity(rng)
    rates = np.zeros((len(place), 2, 6))
    rates[:, 0, 0] = rates[:, 1, 1] = 1.0
    data = place, apart + np.array([0.0, 0.1]), sigma, slope
    assert name_moved(fit_sheet(*data, 1.0), data, [rates, -rates], 1.0).moved == (0, 1)


def test_a_move_that_looks_like_another_height_of_the_sheet_is_noticed_by_that():
    rng = np.random.default_rng(13)
    place, apart, sigma, slope = disparity(rng, slope_spread=0.0)
    rates = np.zeros((len(place), 2, 6))
    rates[:, 0, 0] = rates[:, 1, 1] = 1.0
    rates[:, :, 2] = -place / 500.0
    rates[:, 0, 4], rates[:, 1, 3] = 500.0, -500.0
    rates[:, 0, 5], rates[:, 1, 5] = -place[:, 1], place[:, 0]
    of_views = [rates, -rates]

    def seen(shift_mm):
        data = place, apart + np.array([shift_mm, 0.0]), sigma, slope
        return name_moved(fit_sheet(*data, 1.0), data, of_views, 1.0)

    quiet, height_mm = seen(0.0), 0.2
    assert quiet.unseen[0] > 1e3  # no pose explains it better than the sheet
    least = quiet.least_noticed(height_mm)
    assert least[0] == pytest.approx(0.3 * height_mm, rel=0.01)  # slopes that differ by 0.3
    assert least[1] == quiet.unseen[1] < 0.01
    for times in (0.9, 1.1):
        moved = seen(times * least[0])
        assert moved.moved == ()
        assert (abs(moved.plane[0] - quiet.plane[0]) > height_mm) == (times > 1.0)
    np.testing.assert_array_equal(quiet.least_noticed(np.inf), quiet.unseen)
