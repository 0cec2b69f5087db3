"""Widths of spots, parabolas of best focus, and what depth of field a scene needs."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from rtpiv.analysis.focus import BestFocus, FocusScan, Spots, best_focus, parts_of, spot_variances_px2, spots_in
from sim.demo.scenes import at_size, demo_scene


def spots(sigma_px, seed=0, side=200, share=0.02, noise=0.0):
    rng = np.random.default_rng(seed)
    light = gaussian_filter((rng.random((side, side)) < share) * 5000.0, sigma_px, mode="wrap")
    return [light + 40.0 + noise * rng.standard_normal(light.shape) for _ in range(2)]


@pytest.mark.parametrize("sigma_px", [0.8, 1.2, 2.0, 3.5])
@pytest.mark.parametrize("noise", [0.0, 30.0])
def test_the_width_of_overlapping_spots_in_noise_is_found(sigma_px, noise):
    part = np.ones((200, 200), np.bool_)
    found = np.mean([spots_in(*spots(sigma_px, seed, noise=noise), part).variance_px2 for seed in range(6)])
    assert found == pytest.approx(sigma_px**2, rel=0.15)


def test_slow_light_and_what_lies_outside_do_not_count():
    first, second = spots(1.5)
    part = np.zeros((200, 200), np.bool_)
    part[40:160, 40:160] = True
    ramp = 3.0 * np.arange(200.0)[None, :]
    clean = spots_in(first, second, part).variance_px2
    first[:40], second[:40] = 4000.0, 0.0
    assert spots_in(first + ramp, second + ramp, part).variance_px2 == pytest.approx(clean, rel=0.05)
    assert np.isnan(spots_in(ramp * 0.0, ramp[::-1] * 0.0, part).variance_px2)


def test_the_vertex_is_found_with_an_honest_sigma():
    rng = np.random.default_rng(0)
    z = np.arange(-20.0, 21.0, 4.0)
    off = []
    for _ in range(300):
        s2 = (1.0 + 0.02 * (z - 1.7) ** 2) * (1.0 + 0.05 * rng.standard_normal(len(z)))
        best = best_focus("beside", z, s2)
        assert not best.why
        off.append((best.z_mm - 1.7, best.sigma_mm))
    errors, sigmas = np.array(off).T
    assert abs(errors.mean()) < 0.1
    assert errors.std() == pytest.approx(np.sqrt(np.mean(sigmas**2)), rel=0.35)


def test_grain_far_from_focus_is_not_taken_for_sharpness():
    places = [Spots(0.8, 1.0), Spots(9.0, 8.0), Spots(2.0, 50.0), Spots(1.5, 90.0), Spots(2.1, 40.0)]
    np.testing.assert_array_equal(np.isfinite(spot_variances_px2(places)), [False, False, True, True, True])


def test_a_scan_that_ends_too_early_says_so():
    z = np.arange(0.0, 40.0, 5.0)
    assert "the end of where it shows" in best_focus("x", z, 1.0 + 0.01 * (z - 60.0) ** 2).why
    gap = np.array([-20.0, -10.0, 0.0, 100.0, 110.0, 120.0])
    assert "too far apart" in best_focus("x", gap, 1.0 + 0.01 * (gap - 95.0) ** 2).why
    assert (
        "only 3 places" in best_focus("x", np.arange(-20.0, 21.0, 10.0), np.array([9.0, 2.0, 1.0, 2.0, 9.0])).why
    )
    assert "too few" in best_focus("x", z, np.full(len(z), np.nan)).why


def test_blur_that_does_not_change_is_no_peak_at_an_end():
    """A pinhole, or a depth of field that is deeper than the scan: more places of the kind tell nothing."""
    z = np.arange(-12.0, 13.0, 4.0)
    rng = np.random.default_rng(3)
    for _ in range(20):
        why = best_focus("x", z, 1.0 + 0.02 * rng.standard_normal(len(z))).why
        assert "as sharp everywhere" in why
        assert "add places" not in why
    assert "as sharp everywhere" not in best_focus("x", z, 1.0 + 0.002 * (z - 1.0) ** 2).why


def test_eq_1_both_ways():
    best = (BestFocus("beside", 0.1, 0.2, 3.0), BestFocus("balls: centre", 125.1, 0.5, 4.0))
    best += (BestFocus("balls: rim", float("nan"), float("nan"), float("nan"), "no peak"),)
    scan = FocusScan("camera", np.zeros(1), {}, best, 0.14, 22.0, 532.0)
    assert scan.needed_mm == pytest.approx(125.0)
    assert scan.depth_mm == pytest.approx(83.3, rel=1e-3)
    assert scan.needed_f_number == pytest.approx(27.0, abs=0.1)
    assert scan.needed_sigma_mm == pytest.approx(np.hypot(0.2, 0.5))


def test_parts_follow_the_line_of_sight():
    parts = parts_of(at_size(demo_scene("two_spheres_500"), 400))
    assert list(parts) == ["beside", "sphere2+sphere1: centre", "sphere2+sphere1: halfway", "sphere2+sphere1: rim"]
    assert parts["sphere2+sphere1: centre"][200, 200]
    assert parts["beside"][10, 10]
    assert not any(part[200, 200 + 70] for part in parts.values())  # by the silhouette
    assert sum(part.astype(int) for part in parts.values()).max() == 1
