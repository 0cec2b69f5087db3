"""Derivatives, profiles and steps of fields that are known, and what their sigma covers."""

import numpy as np
import pytest
from scipy import ndimage

from piv.statistics.derived import Axis, PlaneField, divergence, jet_axis, profile, rates, rim_steps

X, Y = np.linspace(-30.0, 30.0, 41), np.linspace(-20.0, 24.0, 31)
GRID_X, GRID_Y = np.meshgrid(X, Y)


def field(u, v, sigma=0.01, length=0.0):
    uv = np.stack((u + 0 * GRID_X, v + 0 * GRID_X), axis=-1)
    return PlaneField(X, Y, uv, np.full_like(uv, sigma), length)


def test_a_rotation_turns_and_does_not_diverge():
    turning = field(-0.3 * GRID_Y, 0.3 * GRID_X)
    inner = (slice(1, -1), slice(1, -1))
    found = {name: value for name, (value, _) in rates(turning).items()}
    assert found["vorticity"][inner] == pytest.approx(0.6)
    assert found["swirling_strength"][inner] == pytest.approx(0.3)
    assert found["divergence"][inner] == pytest.approx(0.0, abs=1e-12)
    assert found["shear"][inner] == pytest.approx(0.0, abs=1e-12)
    assert all(np.isnan(value[0]).all() for value in found.values())


def test_a_shear_turns_as_it_strains_and_swirls_nowhere():
    found = {name: value[1:-1, 1:-1] for name, (value, _) in rates(field(0.4 * GRID_Y, 0.0)).items()}
    assert found["vorticity"] == pytest.approx(-0.4)
    assert found["shear"] == pytest.approx(0.4)
    assert found["swirling_strength"] == pytest.approx(0.0, abs=1e-12)
    plane = field(0.2 * GRID_X, 0.1 * GRID_Y)
    np.testing.assert_allclose(rates(plane)["divergence"][0][1:-1, 1:-1], divergence(plane)[0][1:-1, 1:-1])


def test_sigma_of_the_swirling_strength_covers_where_it_turns_and_is_no_less_where_it_does_not():
    rng = np.random.default_rng(4)
    for turn, least, most in ((0.3, 0.66, 0.71), (0.0, 0.66, 1.0)):
        inside = []
        for _ in range(200):
            u, v = 0.02 * rng.normal(size=(2, *GRID_X.shape))
            value, sigma = rates(field(u - turn * GRID_Y, v + turn * GRID_X, 0.02))["swirling_strength"]
            inside.append(np.abs(value - turn)[1:-1, 1:-1] < sigma[1:-1, 1:-1])
        assert least < np.mean(inside) < most


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 2, 2.5])
def test_a_round_flow_conserves_mass_about_its_axis_only(angle):
    """u_s = a s, u_r = -a r/2 has no divergence in space and a/2 in the plane."""
    axis = Axis((1.3, -2.0), angle)
    along, normal = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    s = (GRID_X - 1.3) * along[0] + (GRID_Y + 2.0) * along[1]
    r = axis.across(GRID_X, GRID_Y)
    flow = 0.2 * s[..., None] * along - 0.1 * r[..., None] * normal
    round_jet = field(flow[..., 0], flow[..., 1])
    inner = (slice(1, -1), slice(1, -1))
    assert divergence(round_jet)[0][inner] == pytest.approx(0.1)
    assert divergence(round_jet, axis)[0][inner] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("length", [0.0, 1.5])
def test_sigma_of_derivatives_covers(length):
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(400, *GRID_X.shape, 2))
    if length:  # smoothing by a Gaussian of deviation l leaves exp(-d^2/(4 l^2))
        noise = ndimage.gaussian_filter(noise, (0, length / 1.5, length / (Y[1] - Y[0]), 0), mode="wrap")
    noise *= 0.02 / noise.std()
    for name in ("divergence", "vorticity", "shear"):
        inside = []
        for each in noise:
            value, sigma = rates(field(each[..., 0], each[..., 1], 0.02, length))[name]
            inside.append(np.abs(value[1:-1, 1:-1]) < sigma[1:-1, 1:-1])
        assert 0.64 < np.mean(inside) < 0.72


def test_a_profile_is_that_of_the_field_along_any_line():
    linear = field(0.1 * GRID_X - 0.2 * GRID_Y, 1.0 + 0.3 * GRID_X)
    linear.uv[5, 7] = np.nan
    found = profile(linear, (-25.0, -15.0), (25.0, 20.0))
    assert found.distance[-1] == pytest.approx(np.hypot(50.0, 35.0))
    known = np.isfinite(found.uv).all(axis=1)
    x, y = found.points[known].T
    assert found.uv[known] == pytest.approx(np.stack((0.1 * x - 0.2 * y, 1.0 + 0.3 * x), axis=-1))
    assert known.mean() > 0.9
    assert not known.all()
    assert np.isnan(profile(linear, (100.0, 0.0), (120.0, 0.0)).uv).all()


@pytest.mark.parametrize("turned", [False, True])
def test_the_axis_of_a_jet_is_found(turned):
    across, along = (GRID_X, GRID_Y) if not turned else (GRID_Y, GRID_X)
    jet = 5.0 * np.exp(-((across - 2.0 - 0.1 * along) ** 2) / 30.0)
    made = field(0.1 * jet, jet) if not turned else field(-jet, -0.1 * jet)
    axis = jet_axis(made)
    assert axis is not None
    distance = axis.across(*(np.array([2.0 + 0.1 * 5.0, 5.0])[:: -1 if turned else 1]))
    assert abs(distance) < 0.3
    heading = np.array([np.cos(axis.angle_rad), np.sin(axis.angle_rad)])
    assert heading @ (np.array([-0.995, -0.0995]) if turned else np.array([0.0995, 0.995])) > 0.99
    assert jet_axis(field(np.nan, np.nan)) is None


@pytest.mark.slow
def test_steps_across_a_rim_come_out_of_a_curved_flow():
    rng = np.random.default_rng(5)
    r = np.hypot(GRID_X, GRID_Y)
    inside, outside = r < 13.0, r > 16.0
    steps, smooth = [], []
    for _ in range(40):
        noise = rng.normal(0.0, 0.02, (*GRID_X.shape, 2))
        u, v = 0.002 * GRID_X * GRID_Y + 0.05 * GRID_Y, 3.0 - 0.004 * GRID_X**2
        for target, step in ((steps, 0.1), (smooth, 0.0)):
            made = field(u + noise[..., 0] + step * inside, v + noise[..., 1] - 2 * step * inside, 0.02)
            made.uv[(r >= 13.0) & (r <= 16.0)] = np.nan
            target.append(rim_steps(made, outside, inside, (0.0, 0.0), 9.0))
    assert len(steps[0].place) == 24
    assert np.mean([each.step for each in steps], axis=(0, 1)) == pytest.approx([0.1, -0.2], abs=0.005)
    covered = np.mean([np.abs(each.step) < each.sigma for each in smooth])
    assert 0.63 < covered < 0.78  # sigma is not less than what residuals say
    nothing = rim_steps(field(0.0, 0.0), outside & False, inside, (0.0, 0.0), 9.0)
    assert nothing.step.shape == (0, 2)
