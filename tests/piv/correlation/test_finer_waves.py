"""Waves that windows do not show, from vectors that are plain means over windows, added up by hand."""

import numpy as np
import pytest

from piv.correlation.finer_waves import Evaluated, finer_px
from piv.correlation.refine import window_weights
from tests.piv.correlation.flows import rms

SIDE, STEP, SIGMA = 16, 8, 0.3
PIXELS, MARGIN = 480, 48
HOW = Evaluated(SIDE, STEP, SIGMA, [])


def random_field(rng, slope, shortest_px):
    """Both components (PIXELS, PIXELS, 2) of a field with the energy k^-slope per ln k down to a wave length."""
    k = 2 * np.pi * np.hypot(*np.meshgrid(np.fft.fftfreq(PIXELS), np.fft.fftfreq(PIXELS)))
    wanted = (k > 0) & (k < 2 * np.pi / shortest_px)
    height = np.where(wanted, np.where(k > 0, k, 1.0) ** (-0.5 * slope - 1.0), 0.0)  # k^2 of the plane per ln k
    noise = np.fft.fft2(rng.normal(size=(2, PIXELS, PIXELS)))
    return np.moveaxis(np.fft.ifft2(noise * height).real, 0, -1)


def seen(field):
    """Means under the weights of windows around nodes, and the values there; an odd side has a middle."""
    weights = window_weights(SIDE + 1, SIGMA * SIDE / (SIDE + 1))
    nodes = np.arange(MARGIN, PIXELS - MARGIN, STEP)
    around = nodes[:, None] + np.arange(SIDE + 1) - SIDE // 2
    lines = np.einsum("nwxc,w->nxc", field[around], weights / weights.sum())
    return np.einsum("nmwc,w->nmc", lines[:, around], weights / weights.sum()), field[np.ix_(nodes, nodes)]


@pytest.mark.parametrize("slope", [2.0, 3.0, 4.0, 5.0])
def test_a_spectrum_that_goes_on_tells_what_windows_miss_of_waves_below_two_of_them(slope):
    whole, longer = (random_field(np.random.default_rng(1), slope, shortest) for shortest in (2.0, 2.0 * SIDE))
    vectors, _ = seen(whole)
    shown, there = seen(whole - longer)
    told = finer_px(vectors, np.zeros(vectors.shape), HOW)
    assert rms(told) / rms(shown - there) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("windows", [2.5, 6.0])
def test_of_one_that_ends_above_them_next_to_nothing_is_told(windows):
    vectors, truth = seen(random_field(np.random.default_rng(1), 2.0, windows * SIDE))
    told = finer_px(vectors, np.zeros(vectors.shape), HOW)
    assert rms(told) < 0.2 * rms(vectors - truth)


def test_noise_is_no_flow():
    rng = np.random.default_rng(3)
    vectors, _ = seen(rng.normal(size=(PIXELS, PIXELS, 2)))
    told = finer_px(vectors, np.full(vectors.shape, rms(vectors)), HOW)
    assert rms(told) < 0.15 * rms(vectors)


def test_it_is_told_where_it_is():
    """Half of a field has no short waves: sigma says so within two windows."""
    rng = np.random.default_rng(5)
    short, long = (random_field(rng, 4.0, shortest) for shortest in (2.0, 6.0 * SIDE))
    short[:, : PIXELS // 2] = 0.0
    vectors, _ = seen(short / rms(short) + long / rms(long))
    told = finer_px(vectors, np.zeros(vectors.shape), HOW)
    quiet = (PIXELS // 2 - MARGIN) // STEP - 2 * SIDE // STEP
    assert rms(told[:, :quiet]) < 0.2 * rms(told[:, -quiet:])


def test_too_few_vectors_say_nothing():
    assert not finer_px(np.ones((5, 4, 2)), np.zeros((5, 4, 2)), HOW).any()


def test_what_a_step_hides_is_told_at_the_step():
    """Even differences vanish in its middle, and windows with two motions look noisy."""
    field = np.zeros((PIXELS, PIXELS, 2))
    middle = MARGIN + 20 * STEP
    field[middle:, :, 0], field[middle, :, 0] = 2.0, 1.0
    vectors, _ = seen(field)
    noise = np.full(vectors.shape, 0.01)
    told = finer_px(vectors, noise, HOW).mean(axis=1)
    assert told[20] > 0.1
    assert told[20] > 1.5 * max(told[18], told[22])
    assert told[[15, 25]].max() < 0.2 * told[20]
    noise[19:22] = 0.4
    np.testing.assert_allclose(finer_px(vectors, noise, HOW).mean(axis=1), told, rtol=1e-6)
