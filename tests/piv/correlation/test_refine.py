"""The parts of the refining passes against slow, obvious versions of themselves."""

import numpy as np
import pytest
from scipy import ndimage

from piv.correlation.deform import DeformedPair
from piv.correlation.denoise import LEVELS, remove_noise
from piv.correlation.kernels import lags, statistics
from piv.correlation.prepare import prepare_pair
from piv.correlation.refine import Refined, refine, window_weights
from piv.correlation.response import gain, noise_growth, parts_of, smoothing_transfer
from piv.correlation.settings import PivSettings
from piv.correlation.uncertainty import blocks_of, correlation_asymmetry, correlation_statistics
from piv.correlation.windows import window_grid
from piv.errors import PairError
from tests.piv.correlation.flows import rms


def smooth_noise(shape, seed=0, sigma_px=1.2):
    frame = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), sigma_px)
    return (frame / frame.std()).astype(np.float32)


def test_lag_sums_are_weighted_products():
    rng = np.random.default_rng(0)
    a, b, valid = rng.normal(size=(3, 24, 30)).astype(np.float32)
    whole, half = (window_weights(8, 0.3, half=half).astype(np.float32) for half in (False, True))
    starts = np.array([0, 5, 22])
    for kernel in (lags.lag_sums, lags.lag_sums.py_func):
        out = np.empty((3, lags.SUMS))
        kernel(a, b, valid, 4, starts, whole, half, np.empty((lags.SUMS, 30), np.float32), out)
        for row, start in zip(out, starts, strict=True):
            wa, wb, wv = (frame[4:12, start : start + 8].astype(float) for frame in (a, b, valid))
            expected = [
                whole @ (wa * wb) @ whole,
                whole @ (wa[:, :-1] * wb[:, 1:]) @ half,
                whole @ (wa[:, 1:] * wb[:, :-1]) @ half,
                half @ (wa[:-1] * wb[1:]) @ whole,
                half @ (wa[1:] * wb[:-1]) @ whole,
                whole @ wv**2 @ whole,
                whole @ (wv[:, :-1] * wv[:, 1:]) @ half,
                half @ (wv[:-1] * wv[1:]) @ whole,
                whole @ wa**2 @ whole,
                whole @ wb**2 @ whole,
            ]
            assert row == pytest.approx(expected, abs=1e-4)


def test_the_peak_between_lags():
    for kernel in (lags.between, lags.between.py_func):
        samples = [np.exp(-((k - 0.37) ** 2) / 2.5) for k in (-1, 0, 1)]
        assert kernel(*samples) == pytest.approx(0.37, abs=1e-12)
        assert kernel(-0.5, 1.0, 0.5) == pytest.approx(0.25)
        assert np.isnan(kernel(1.0, 1.0, 0.5))
        assert np.isnan(kernel(0.2, 0.5, 0.7))


@pytest.mark.parametrize("window_sigma", [0.0, 0.3])
def test_refinement_finds_a_fraction_of_a_pixel_and_says_where_there_is_none(window_sigma):
    frame = smooth_noise((96, 96))
    moved = ndimage.shift(frame, (-0.04, 0.06), order=5, mode="grid-wrap").astype(np.float32)
    valid = np.ones(frame.shape, np.float32)
    valid[:, :20] = 0.0
    frame[40:, 40:], moved[40:, 40:] = 0.0, 0.0
    pair = DeformedPair(frame * valid, moved * valid, valid, 1e-4)
    grid = window_grid(frame.shape, 16, 0.5)
    found = refine(pair, grid, window_sigma)
    seen = found.shift_px[1:3, 5:-1]
    assert seen == pytest.approx(np.broadcast_to((0.06, -0.04), seen.shape), abs=0.04)
    assert np.isnan(found.shift_px[-1, -1]).all()  # nothing there
    assert found.valid_fraction[0, 0] == 0.0
    assert 0.3 < found.valid_fraction[0, 2] < 0.9
    assert found.valid_fraction[0, 6] == pytest.approx(1.0, abs=1e-5)


def test_refinement_has_the_same_bits_on_any_number_of_threads():
    pair = DeformedPair(smooth_noise((96, 96), 1), smooth_noise((96, 96), 2), np.ones((96, 96), np.float32), 1e-4)
    grid = window_grid((96, 96), 16, 0.75)
    one, three = (refine(pair, grid, 0.3, threads) for threads in (1, 3))
    assert np.array_equal(one.sums, three.sums)


def test_block_sums_are_those_of_the_definition():
    a, b = smooth_noise((21, 26), 3), smooth_noise((21, 26), 4)
    mean = 0.5 * (a.astype(float) + b)
    expected = np.zeros((4, 21, 26))
    for axis, (j, i) in enumerate(((0, 1), (1, 0))):
        for y in range(1, 19):
            for x in range(1, 24):
                there = y + j, x + i
                expected[axis, y, x] = a[y, x] * b[there] - a[there] * b[y, x]
                here, next_ = mean[y, x], mean[there]
                before, beyond = mean[y - j, x - i], mean[y + 2 * j, x + 2 * i]
                expected[2 + axis, y, x] = 0.5 * (next_ - before) * next_ - here * 0.5 * (beyond - here)
    blocks = expected[:, :20, :24].reshape(4, 5, 4, 6, 4).sum(axis=(2, 4))
    for kernel in (statistics.block_sums, statistics.block_sums.py_func):
        out = np.empty((4, 5, 6), np.float32)
        kernel(a, b, 4, 0, 5, np.empty((4, 26), np.float32), out)
        assert np.abs(out - blocks).max() < 1e-4


def test_weights_are_symmetrical_and_both_kinds_sum_alike():
    for sigma in (0.0, 0.25, 0.4):
        whole, half = window_weights(32, sigma), window_weights(32, sigma, half=True)
        assert whole == pytest.approx(whole[::-1])
        assert (len(half), half.sum()) == (31, pytest.approx(whole.sum()))
    assert window_weights(32, 0.3)[0] < 0.08


def test_growth_of_noise():
    weights, smooth = window_weights(32, 0.0), smoothing_transfer(1.0, 1)
    assert noise_growth(weights, 16, []) == pytest.approx(1.0)
    growths = [noise_growth(weights, 16, [smooth] * n) for n in (1, 2, 5)]
    assert 1.0 < growths[0] < growths[1] < growths[2] < 1.15
    assert noise_growth(weights, 16, [smoothing_transfer(0.5, 1)] * 2) > 1.2
    assert noise_growth(weights, 16, [smooth], smooth) < 0.8


def test_gain_of_waves():
    waves = np.array([[2 * np.pi / length, 0.0] for length in (32.0, 64.0, 1e6)])
    one = gain(window_weights(32, 0.0), 16, [], waves)
    assert one == pytest.approx([0.0, 2 / np.pi, 1.0], abs=2e-3)
    twice = [smoothing_transfer(0.5, 3)] * 2
    more = gain(window_weights(32, 0.0), 16, twice, waves)
    assert more[1] > 0.85
    assert gain(window_weights(32, 0.0), 16, twice, waves[:, ::-1]) == pytest.approx(more)
    oblique = gain(window_weights(32, 0.0), 16, [], waves[1] + waves[1, ::-1])
    assert oblique == pytest.approx(one[1] ** 2)


def denoised_at_32_16(vectors, sigma):
    """As windows of 32 px, 16 px apart, of one pass; noise of neighbours is taken as independent."""
    one = np.zeros(32)
    one[16] = 1.0
    levels = [2.0 * level for level in LEVELS]
    growths = [np.full(sigma.shape[:2], noise_growth(one, 16, [], part)) for part in parts_of(levels)]
    good = np.ones(sigma.shape[:2], bool)
    return remove_noise(vectors, good, sigma, growths, levels, 2.0)


def test_noise_goes_and_a_wave_stays():
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:60, :60]
    sigma, inner = np.full((60, 60, 2), 0.05), np.s_[6:-6, 6:-6]
    noise = rng.normal(0, 0.05, (60, 60, 2))
    for nodes, height, least, most in ((4, 0.0, 0.02, 0.25), (4, 1.0, 0.9, 1.1), (16, 0.5, 0.25, 0.8)):
        truth = height * np.stack([np.sin(2 * np.pi * y / nodes), np.sin(2 * np.pi * x / nodes)], axis=-1)
        found = denoised_at_32_16(truth + noise, sigma)
        off = (found.vectors_px - truth)[inner]
        assert least < rms(off) / 0.05 < most
        assert rms(off) / rms(np.hypot(found.sigma_px, found.taken_px[..., None])[inner]) == pytest.approx(
            1, abs=0.2
        )
    unknown = denoised_at_32_16(truth + noise, np.full_like(sigma, np.nan))
    assert np.allclose(unknown.vectors_px, truth + noise)  # what nobody knows the noise of stays
    assert np.isnan(unknown.sigma_px).all()


def test_a_noisy_vector_counts_less():
    rng = np.random.default_rng(6)
    sigma = np.full((20, 20, 2), 0.01)
    sigma[5::6, 5::6] = 0.15
    field = rng.normal(0, 1, (20, 20, 2)) * sigma
    assert rms(denoised_at_32_16(field, sigma).vectors_px[5::6, 5::6]) < 0.012


def test_frames_of_any_scale_and_kind_become_the_same():
    frame = (1000 + 300 * smooth_noise((64, 80), 7)).astype(np.uint16)
    other = (1000 + 300 * smooth_noise((64, 80), 8)).astype(np.uint16)
    plain = prepare_pair(frame, other, None, 32)
    for change in (
        lambda f: f.astype(np.float32) * np.float32(1e20),
        lambda f: f.astype(np.int32) + 10**7,
        lambda f: f.astype(">u2"),
        lambda f: f.astype(np.float64) * 1e-30,
    ):
        pair = prepare_pair(change(frame), change(other), None, 32)
        assert np.abs(pair.a - plain.a).max() < 1e-3
        assert np.abs(pair.b - plain.b).max() < 1e-3
    masked = np.ma.masked_greater(frame, 1500)
    pair = prepare_pair(masked, other, None, 32)
    assert np.array_equal((pair.valid == 0) | (pair.filled.variance > 0), frame > 1500)


def test_what_is_masked_counts_nothing_and_leaves_no_step():
    frame, other = smooth_noise((64, 64), 9) + 5, smooth_noise((64, 64), 10) + 5
    valid = np.ones((64, 64), bool)
    valid[20:40, 20:40] = False
    dark, bright = frame.copy(), frame.copy()
    dark[~valid], bright[~valid] = 0.0, 1e6
    pairs = [prepare_pair(f, other, valid, 16) for f in (dark, bright)]
    assert np.array_equal(pairs[0].a, pairs[1].a)
    assert np.abs(pairs[0].a).max() < 6.0


@pytest.mark.parametrize(
    "bad",
    [
        {"smoothing_px": float("nan")},
        {"smoothing_px": -1.0},
        {"outlier_threshold": float("nan")},
        {"outlier_epsilon_px": -1.0},
        {"windows_px": (64.5, 32)},
        {"window_sigma": 0.05},
        {"denoise": -1.0},
        {"overlap": float("nan")},
    ],
)
def test_settings_without_sense_are_refused_by_name(bad):
    with pytest.raises(PairError, match=next(iter(bad))):
        PivSettings(**bad)


def test_no_sigma_is_larger_than_what_was_searched():
    """A peak that is flat, as where a window spans a step, has no limit of its own; the search has."""
    frames = [smooth_noise((64, 64), seed).astype(np.float32) for seed in (1, 2)]
    pair = DeformedPair(*frames, np.ones((64, 64), np.float32), 0.0)
    grid = window_grid((64, 64), 32, 0.5)
    one = np.ones(grid.shape)
    lean = correlation_asymmetry(blocks_of(pair, 1.0), grid, 0.3, np.zeros((*grid.shape, 2)))
    told = []
    for lower in np.geomspace(1e-8, 1e-2, 20):
        sums = np.full((*grid.shape, 5), 1e3 * (1.0 - lower))
        sums[..., 0] = 1e3
        refined = Refined(np.zeros((*grid.shape, 2)), one, one, sums, one, one)
        told.append(correlation_statistics(lean, refined).sigma_px)
    assert 0.3 < np.nanmax(told) <= 3.0**-0.5
