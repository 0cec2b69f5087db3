"""The slant in a mean: its own part of sigma, of stresses and of the file, and what is told of w in it."""

from dataclasses import replace

import numpy as np
import pytest

from correction.evaluate.regions import Region
from piv.statistics.out_of_plane import OutOfPlane
from rtpiv.analysis.campaign.merge import merge_means
from rtpiv.analysis.series.series_mean import mean_vectors
from rtpiv.analysis.series.split_focus import BEHIND, join_means
from tests.rtpiv.analysis.series.small_series import flow_run
from tests.rtpiv.analysis.series.test_light_sheet_series import EXACT, mean_in
from tests.rtpiv.analysis.series.test_split_focus import REGION, SHAPE, mean_of

SLOPE = np.broadcast_to((0.3, -0.2), (*SHAPE, 2))


def test_it_is_a_part_of_its_own():
    plain = mean_of(2.0, 0.5, 0)
    told = replace(plain, slope=SLOPE, out_of_plane=OutOfPlane(sigma_w_m_s=0.4, w_over_u=0.1))
    assert plain.slant_sigma_m_s is None
    speed = np.linalg.norm(plain.mean_m_s, axis=-1, keepdims=True)
    assert told.slant_sigma_m_s == pytest.approx(0.1 * speed * np.abs(SLOPE))
    assert told.total_sigma_m_s == pytest.approx(np.hypot(plain.total_sigma_m_s, told.slant_sigma_m_s))
    for name in ("mean_m_s", "sigma_m_s", "local_sigma_m_s", "stresses_m2_s2"):
        np.testing.assert_array_equal(getattr(told, name), getattr(plain, name))
    assert told.perspective_stresses.bias[..., 2] == pytest.approx(-0.06 * 0.16)

    before, after = (mean_vectors(mean, {}) for mean in (plain, told))
    assert not [name for name in before.fields if name.startswith("slant_")]
    assert not before.by_place
    np.testing.assert_array_equal(np.stack([after.by_place[name] for name in ("dxdz", "dydz")], axis=-1), SLOPE)
    assert "out_of_plane" not in before.attributes
    for name, wanted, unit in (
        ("slant_sigma_v", told.slant_sigma_m_s[..., 1], "m s-1"),
        ("slant_R_uu", told.perspective_stresses.bias[..., 0], "m2 s-2"),
        ("slant_sigma_R_uv", told.perspective_stresses.sigma[..., 2], "m2 s-2"),
    ):  # fmt: skip
        np.testing.assert_array_equal(after.fields[name][0], wanted)
        assert after.units[name] == unit
    assert after.attributes["out_of_plane"] == told.out_of_plane.sentence
    assumed = mean_vectors(replace(told, out_of_plane=OutOfPlane()), {})
    assert "assumed, isotropic" in assumed.attributes["out_of_plane"]


def test_means_of_several_runs_keep_the_slopes_of_their_vectors():
    first, second = (replace(mean_of(1.0, 0.1, k), slope=SLOPE * (k + 1.0)) for k in (0, 1))
    joined = join_means(first, second, REGION)
    np.testing.assert_array_equal(joined.mean.slope[joined.source == BEHIND], 2.0 * SLOPE[joined.source == BEHIND])
    assert (
        np.isnan(joined.mean.slope[REGION == Region.NONE]).all()
        == (joined.source[REGION == Region.NONE] == 0).all()
    )
    merged = merge_means(("one", "two"), (first, second)).mean
    assert merged.slope == pytest.approx(1.5 * SLOPE)  # as many pairs each
    assert merge_means(("one", "two"), (first, replace(second, slope=None))).mean.slope is None
    assert join_means(first, replace(second, slope=None), REGION).mean.slope is None


def test_the_mean_of_a_series_has_the_perspective_of_its_camera(tmp_path):
    """Without glass: a camera 500 mm before the plane, above its middle; rows of the file go up."""
    mean = mean_in(tmp_path / "one", flow_run(tmp_path, 2), EXACT)
    x, y = np.meshgrid(mean.x_mm, mean.y_mm)
    far = np.hypot(x, y) < 0.45 * (mean.x_mm[-1] - mean.x_mm[0])
    assert mean.slope[..., 0][far] == pytest.approx(-x[far] / 500.0, abs=2e-3)
    assert mean.slope[..., 1][far] == pytest.approx(-y[far] / 500.0, abs=2e-3)
