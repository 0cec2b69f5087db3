"""What w does to fields and stresses that are seen aslant, against fields whose three components are known."""

import numpy as np
import pytest
import scipy

from piv.errors import PairError
from piv.statistics.out_of_plane import OutOfPlane, SlantedField, _not_negative

SIDE, WINDOWS = 60, 2.0  # vectors; in the side of a window


def turbulence(seed, strength=(1.0, 1.0, 1.0)):
    """Components (SIDE, SIDE, 3) of waves of two to five windows, of these standard deviations."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:SIDE, :SIDE]
    out = np.zeros((SIDE, SIDE, 3))
    for _ in range(60):
        angle, length = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(2.0, 5.0) * WINDOWS
        turn = 2.0 * np.pi / length * (x * np.cos(angle) + y * np.sin(angle))
        out += np.cos(turn[..., None] + rng.uniform(0.0, 2.0 * np.pi, 3))
    return out / np.sqrt(30.0) * strength


def slope_of(a, b):
    return np.broadcast_to((a, b), (SIDE, SIDE, 2)).astype(np.float64)


def seen(flow, slope):
    return flow[..., :2] - slope * flow[..., 2:]


@pytest.mark.parametrize("noise", [0.0, 0.4])
def test_sigma_is_the_error_of_single_vectors_in_turbulence(noise):
    """Nothing is told; noise of the vectors is not taken for a flow."""
    slope, rng = slope_of(0.35, -0.2), np.random.default_rng(1)
    error, sigma = [], []
    for seed in range(6):
        flow = turbulence(seed)
        sigmas = np.full((SIDE, SIDE, 2), noise)
        field = SlantedField(
            seen(flow, slope) + rng.normal(0.0, 1.0, sigmas.shape) * noise, sigmas, slope, WINDOWS
        )
        error.append(seen(flow, slope) - flow[..., :2])
        sigma.append(field.sigma(OutOfPlane().of_pair(field, 1.0)))
    error, sigma = np.array(error), np.array(sigma)
    ratio = np.sqrt((error**2).mean(axis=(0, 1, 2)) / (sigma**2).mean(axis=(0, 1, 2)))
    assert ratio == pytest.approx(1.0, abs=0.15)
    assert 0.62 < np.mean(np.abs(error) < sigma) < 0.75


def test_what_is_told_counts_in_place_of_what_is_assumed():
    flow, slope = turbulence(3) + np.array((5.0, 0.0, 0.0)), slope_of(0.3, 0.1)
    field = SlantedField(flow[..., :2], np.zeros((SIDE, SIDE, 2)), slope, WINDOWS)
    speed = np.linalg.norm(flow[..., :2], axis=-1)
    assumed = OutOfPlane().of_pair(field, 2.0)
    assert OutOfPlane(0.7).of_pair(field, 2.0) == pytest.approx(1.4)
    assert OutOfPlane(0.7).of_pair(field, np.nan) == pytest.approx(assumed)  # a speed says nothing about lengths
    assert OutOfPlane(w_over_u=0.2).of_pair(field, 2.0) == pytest.approx(np.hypot(assumed, 0.2 * speed))
    assert OutOfPlane(0.0, 0.0).of_pair(field, 2.0).max() == 0.0
    assert OutOfPlane(0.7).of_mean(field) == pytest.approx(
        assumed
    )  # what changes from pair to pair is in the scatter
    assert OutOfPlane(w_over_u=0.2).of_mean(field) == pytest.approx(0.2 * speed)
    sigma = field.sigma(np.full((SIDE, SIDE), 2.0))
    assert sigma == pytest.approx(2.0 * np.abs(slope))
    assert "(given)" not in OutOfPlane().sentence
    assert "0.7 m/s (given)" in OutOfPlane(0.7).sentence
    assert "steady: 0.2 of the speed in the plane (given)" in OutOfPlane(0.7, 0.2).sentence


def test_stresses_are_as_much_too_large_as_it_says():
    """Many pairs of a flow that is not isotropic, with w' told; and with R_uw, which sigma alone can hold."""
    strength = np.array((1.0, 0.8, 0.9))
    slope = slope_of(0.4, -0.3)
    flows = np.array([turbulence(seed, strength) for seed in range(30)])
    flows = np.concatenate((flows, flows * (1.0, 1.0, -1.0)))  # R_uw and R_vw are 0
    measured = np.array([seen(flow, slope) for flow in flows])

    def stresses(uv):
        off = uv - uv.mean(axis=0)
        return np.stack([(off[..., i] * off[..., j]).mean(axis=0) for i, j in ((0, 0), (1, 1), (0, 1))], axis=-1)

    true, found = stresses(flows[..., :2]), stresses(measured)
    told = OutOfPlane(0.9).of_stresses(found, slope)
    assert (found - true).mean(axis=(0, 1)) == pytest.approx(told.bias.mean(axis=(0, 1)), abs=0.02)
    assert told.bias[..., 0] == pytest.approx(0.16 * 0.81)
    assumed = OutOfPlane().of_stresses(found, slope)
    off = (found - true - assumed.bias).mean(axis=(0, 1))
    assert (np.abs(off) < assumed.sigma.mean(axis=(0, 1))).all()

    both = flows.copy()
    both[..., 2] = 0.4 * 0.9 * flows[..., 0] + np.sqrt(1.0 - 0.16) * flows[..., 2]  # rho = 0.4, the most
    found = stresses(np.array([seen(flow, slope) for flow in both]))
    left = np.abs((found - true).mean(axis=(0, 1)) - assumed.bias.mean(axis=(0, 1)))
    assert left[0] > 0.1
    assert (left < 2.0 * assumed.sigma.mean(axis=(0, 1))).all()


def test_holes_and_lonely_vectors_are_told_by_the_others():
    flow, slope = turbulence(2), slope_of(0.3, 0.3)
    uv = flow[..., :2].copy()
    uv[20:40, 20:40] = np.nan
    uv[30, 30] = 0.1
    slope = slope.copy()
    slope[0, 0] = np.nan
    field = SlantedField(uv, np.zeros(uv.shape), slope, WINDOWS)
    sigma = field.sigma(OutOfPlane().of_pair(field, 1.0))
    known = np.isfinite(uv).all(axis=-1) & np.isfinite(slope).all(axis=-1)
    np.testing.assert_array_equal(np.isfinite(sigma).all(axis=-1), known)
    assert sigma[30, 30, 0] == pytest.approx(0.3 * np.median(field.variation()[known]), rel=0.2)
    still = SlantedField(np.zeros(uv.shape), np.full(uv.shape, 0.1), slope, WINDOWS)
    assert still.variation().max() == 0.0


@pytest.mark.parametrize("wrong", [{"sigma_w_m_s": -0.1}, {"w_over_u": np.nan}, {"w_over_u": np.inf}])
def test_sizes_are_sizes(wrong):
    with pytest.raises(PairError, match="is a size, 0 or more"):
        OutOfPlane(**wrong)


def test_a_flow_that_noise_hides_is_not_known_to_be_still():
    """A field of noise alone: nothing is left of its variance in half of the places, and nowhere is w known."""
    rng, slope = np.random.default_rng(5), slope_of(0.3, 0.3)
    sigmas = np.full((SIDE, SIDE, 2), 0.2)
    field = SlantedField(rng.normal(0.0, 0.2, sigmas.shape), sigmas, slope, WINDOWS)
    sigma_w = OutOfPlane().of_pair(field, 1.0)
    assert sigma_w.min() > 0.0
    assert np.sqrt(np.mean(sigma_w**2)) < 0.12  # well below the noise
    still = SlantedField(np.zeros((SIDE, SIDE, 2)), np.zeros((SIDE, SIDE, 2)), slope, WINDOWS)
    assert OutOfPlane().of_pair(still, 1.0).max() == 0.0
    same = SlantedField(np.full((SIDE, SIDE, 2), 3.0), sigmas, slope, WINDOWS)  # varies by rounding alone
    assert 0.0 <= OutOfPlane().of_pair(same, 1.0).max() < 1e-6


@pytest.mark.parametrize("z", [5.0, 1.0, 0.0, -1.0, -5.0, -9.9, -10.1, -30.0, -1e9])
def test_what_a_variance_can_be_is_the_mean_of_a_normal_cut_off_at_zero(z):
    exact = scipy.stats.truncnorm.mean(-z, np.inf, loc=z) if z > -9.0 else -1.0 / z
    assert float(_not_negative(np.array(z), np.array(1.0))) == pytest.approx(exact, rel=0.03, abs=1e-12)
