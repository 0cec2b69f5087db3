"""Waves that windows do not show, by means of noisy pairs of plain means over windows, added up by hand."""

import numpy as np
import pytest

from piv.correlation.finer_waves import Evaluated
from piv.correlation.refine import window_weights
from piv.statistics.merge_tree import merge_in_order
from piv.statistics.short_waves import ShortWaves

SIDE, STEP, SIGMA = 32, 8, 0.3
PIXELS, MARGIN, PAIRS = 448, 32, 12
HOW = Evaluated(SIDE, STEP, SIGMA, [])
NODES = np.arange(MARGIN, PIXELS - MARGIN, STEP)


def random_field(rng, slope, shortest_px):
    """Both components (PIXELS, PIXELS, 2) of a field with the energy k^-slope per ln k down to a wave length."""
    k = 2 * np.pi * np.hypot(*np.meshgrid(np.fft.fftfreq(PIXELS), np.fft.fftfreq(PIXELS)))
    wanted = (k > 0) & (k < 2 * np.pi / shortest_px)
    height = np.where(wanted, np.where(k > 0, k, 1.0) ** (-0.5 * slope - 1.0), 0.0)
    noise = np.fft.fft2(rng.normal(size=(2, PIXELS, PIXELS)))
    return np.moveaxis(np.fft.ifft2(noise * height).real, 0, -1)


def seen(field):
    """Means under the weights of windows around nodes; an odd side has a middle."""
    weights = window_weights(SIDE + 1, SIGMA * SIDE / (SIDE + 1))
    around = NODES[:, None] + np.arange(SIDE + 1) - SIDE // 2
    lines = np.einsum("nwxc,w->nxc", field[around], weights / weights.sum())
    return np.einsum("nmwc,w->nmc", lines[:, around], weights / weights.sum())


def rms(values):
    return float(np.sqrt(np.mean(np.square(values[4:-4, 4:-4]))))


def missed_of(steady, noise, usual=True, limit=np.inf, seed=5):
    """What the mean of pairs of a steady field is said to miss; `noise` is that of a vector."""
    rng, shape = np.random.default_rng(seed), steady.shape[:2]
    everywhere = np.ones(shape, bool)
    fields = []
    for _ in range(PAIRS):
        rough = rng.standard_normal(steady.shape)
        fields.append(steady + noise * rough)
    limits = np.full(shape, limit)
    parts = [ShortWaves.of(field, everywhere, limits, everywhere & usual, HOW) for field in fields]
    return merge_in_order(enumerate(parts)).short_wave_sigma(np.mean(fields, axis=0))


@pytest.fixture(scope="module")
def turbulence():
    """Vectors of a spectrum that goes on, and what they miss of waves below two windows, for 4 px rms."""
    rng = [np.random.default_rng(1) for _ in range(2)]
    whole, longer = (
        random_field(each, 3.0, shortest) for each, shortest in zip(rng, (2.0, 2.0 * SIDE), strict=True)
    )
    there = (whole - longer)[np.ix_(NODES, NODES)]
    scale = 4.0 / rms(seen(whole))
    return scale * seen(whole), scale * rms(seen(whole - longer) - there)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_spectrum_that_goes_on_is_told_through_the_noise_of_pairs(turbulence, noise):
    vectors, missed = turbulence
    assert 0.02 < missed < 0.2
    assert rms(missed_of(vectors, noise, limit=10.0)) / missed == pytest.approx(1.0, abs=0.3)


def test_one_that_ends_above_a_window_and_noise_alone_miss_next_to_nothing(turbulence):
    _, missed = turbulence
    smooth = seen(random_field(np.random.default_rng(2), 5.0 / 3.0, 3.0 * SIDE))
    smooth /= rms(smooth)
    assert rms(missed_of(smooth, 0.02, limit=10.0)) < 0.3 * missed
    # Of noise a mean keeps 0.006 px.
    assert rms(missed_of(np.zeros_like(smooth), 0.02, limit=10.0)) < 0.01


def test_it_is_bounded_by_what_pairs_say_and_left_to_them_where_windows_are_smaller(turbulence):
    vectors, missed = turbulence
    bounded = missed_of(vectors, 0.0, limit=0.1 * missed)
    np.testing.assert_allclose(bounded[6:-6, 6:-6], 0.1 * missed, rtol=1e-9)
    usual = np.ones(vectors.shape[:2], bool)
    usual[:, :20] = False
    found = missed_of(vectors, 0.0, usual=usual, limit=10.0)
    assert (found[:, :20] == 0.0).all()
    assert (found[:, 20:] > 0.0).all()
    lone = ShortWaves.of(vectors, usual, np.full(usual.shape, 0.1), usual, HOW)
    assert (lone.short_wave_sigma(vectors) == 0.0).all()  # one pair has no scatter
    coarse = Evaluated(SIDE, SIDE // 2, SIGMA, [])
    two = [ShortWaves.of(vectors, usual, np.full(usual.shape, 0.1), usual, coarse) for _ in range(2)]
    assert (two[0].merge_with(two[1]).short_wave_sigma(vectors) == 0.0).all()
