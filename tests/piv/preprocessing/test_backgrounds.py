"""Backgrounds of whole series, the intensity cap, and which steps may stand where."""

import numpy as np
import pytest

from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from piv.errors import FrameError, PairError, SeriesError
from piv.preprocessing.pod import _gram, pod_patterns, rank_before_flat, without_patterns
from piv.preprocessing.preparation import Preparation, intensity_capped, min_max_normalised
from piv.preprocessing.series_light import series_mean, series_minimum, without_light


def test_minimum_and_mean_are_brute_force_and_take_a_generator():
    frames = np.random.default_rng(1).integers(0, 65536, (31, 7, 8)).astype(np.uint16)
    assert np.array_equal(series_minimum(iter(frames)), frames.min(axis=0))
    exact = np.array([[sum(int(f[y, x]) for f in frames) / 31 for x in range(8)] for y in range(7)], np.float32)
    assert np.array_equal(series_mean(iter(frames)), exact)
    assert np.array_equal(without_light(frames[3], frames.min(axis=0)), frames[3] - frames.min(axis=0).astype(int))


@pytest.mark.parametrize("of", [series_minimum, series_mean])
def test_series_that_are_none_are_refused(of):
    square = np.zeros((4, 4), np.uint16)
    with pytest.raises(SeriesError, match="there are 1"):
        of(iter([square]))
    with pytest.raises(SeriesError, match="there are 0"):
        of(iter([]))
    with pytest.raises(FrameError, match="those before it"):
        of([square, np.zeros((4, 5), np.uint16)])
    with pytest.raises(FrameError, match="one camera"):
        without_light(square, np.zeros((4, 5)))


def flickering(rng, count=40, side=96):
    """Two reflections that flicker each for itself, particles elsewhere in every frame; frames, and the light."""
    row, column = np.indices((side, side))
    one = 900.0 * np.exp(-((row - 30) ** 2 + (column - 40) ** 2) / 60.0)
    two = 700.0 * np.exp(-((row - 70) ** 2 + (column - 60) ** 2) / 90.0)
    light = 35.0 + rng.uniform(0.4, 1.0, (count, 1, 1)) * one + rng.uniform(0.4, 1.0, (count, 1, 1)) * two
    particles = np.zeros((count, side, side))
    for each in particles:
        places = rng.integers(1, side - 1, (300, 2))
        for shift in (-1, 0, 1):
            each[places[:, 0] + shift, places[:, 1]] += 150.0 / (1 + shift**2)
            each[places[:, 0], places[:, 1] + shift] += 75.0 / (1 + shift**2)
    frames = light + particles + rng.normal(0.0, 2.0, light.shape)
    return np.clip(np.rint(frames), 0, 4095).astype(np.uint16), particles


def test_patterns_take_reflections_that_flicker_and_leave_the_particles():
    frames, particles = flickering(np.random.default_rng(2))
    patterns = pod_patterns(frames.__getitem__, len(frames))
    assert len(patterns) == 3  # the mean light, and two that flicker
    gram = np.einsum("iyx,jyx->ij", patterns, patterns, dtype=np.float64)
    assert gram == pytest.approx(np.eye(3), abs=1e-5)
    left = np.array([without_patterns(frame, patterns) for frame in frames])
    bright = particles - particles.mean(axis=(1, 2), keepdims=True)
    alike = [np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in zip(left, bright, strict=True)]
    assert np.median(alike) > 0.95  # 3 of 40 parts of their light go with the patterns: 0.96
    assert min(alike) > 0.9
    lowest = series_minimum(iter(frames))
    plain = [np.corrcoef((f - lowest.astype(float)).ravel(), b.ravel())[0, 1]
             for f, b in zip(frames, bright, strict=True)]  # fmt: skip
    assert np.median(plain) < 0.8  # what flickers is in the minimum only where it is dimmest


def test_patterns_do_not_depend_on_how_frames_are_blocked(monkeypatch):
    frames, _ = flickering(np.random.default_rng(3), count=24, side=64)
    whole = pod_patterns(frames.__getitem__, len(frames))
    monkeypatch.setattr("piv.preprocessing.pod.BLOCK", 5)
    monkeypatch.setattr("piv.preprocessing.pod.TILE_PX", 777)
    assert np.array_equal(pod_patterns(frames.__getitem__, len(frames)), whole)


def test_inner_products_of_full_scale_frames_are_exact():
    frames = np.full((13, 40, 50), 65535, np.uint16)
    frames[3, 0, 0] = 65534
    gram = _gram(frames.__getitem__, 13)
    assert gram[0, 1] == 2000 * 65535**2
    assert gram[0, 3] == 2000 * 65535**2 - 65535
    assert gram[3, 3] == 1999 * 65535**2 + 65534**2


def test_a_flat_spectrum_has_no_patterns_but_the_mean():
    rng = np.random.default_rng(4)
    frames = (100 + rng.normal(0, 10, (50, 60, 60))).round().astype(np.uint16)
    assert len(pod_patterns(frames.__getitem__, 50)) == 1
    assert rank_before_flat(np.array([9.0, 5.0, 1.2, 1.1, 1.0, 1.0, 0.9, 0.9, 0.8])) == 2


def test_patterns_that_cannot_be_are_refused():
    rng = np.random.default_rng(5)
    few = rng.integers(0, 99, (11, 8, 8)).astype(np.uint16)
    with pytest.raises(SeriesError, match="need 12 frames"):
        pod_patterns(few.__getitem__, 11)
    with pytest.raises(FrameError, match="whole counts"):
        pod_patterns(lambda n: few[0].astype(np.float32), 12)
    with pytest.raises(FrameError, match="those before it"):
        pod_patterns(lambda n: few[0, : 8 - n // 9], 12)
    with pytest.raises(FrameError, match="one camera"):
        without_patterns(few[0], np.zeros((1, 8, 9), np.float32))


def test_the_cap_is_median_and_two_deviations_and_leaves_nan_alone():
    frame = np.random.default_rng(6).exponential(100.0, (50, 60)).astype(np.float32)
    frame[3, 3], frame[4, 4] = 1e5, np.nan
    limit = np.nanmedian(frame) + 2 * np.nanstd(frame.astype(float))
    capped = intensity_capped(frame)
    assert np.nanmax(capped) == pytest.approx(limit, rel=1e-6)
    assert np.isnan(capped[4, 4])
    assert np.array_equal(capped[frame < limit], frame[frame < limit])
    assert np.isnan(intensity_capped(np.full((5, 5), np.nan))).all()
    with pytest.raises(FrameError, match="positive number"):
        intensity_capped(frame, deviations=0.0)
    with pytest.raises(FrameError, match="mask has shape"):
        intensity_capped(frame, np.ones((2, 2), bool))


@pytest.mark.parametrize("step", [min_max_normalised, intensity_capped])
def test_steps_for_corrected_frames_are_the_same_at_every_place(step):
    """Shift-invariant: a frame rolled by any way gives the result rolled by it."""
    frame = np.random.default_rng(7).gamma(0.3, 200.0, (96, 96)).astype(np.float32)
    inside = (slice(40, 60), slice(40, 60))
    for way in ((1, 0), (0, 3), (7, -5)):
        rolled = np.roll(step(np.roll(frame, way, (0, 1))), (-way[0], -way[1]), (0, 1))
        assert rolled[inside] == pytest.approx(step(frame)[inside], abs=1e-5)


@pytest.mark.parametrize("step", ["min-max", "cap"])
def test_steps_move_no_vector(step, particle_pair):
    pair = particle_pair(lambda u, v: (2.4 + 0 * u, 0.7 + 0 * u), (256, 256), seed=9)
    everywhere = np.ones((256, 256), bool)
    frames = [Preparation((step,)).apply(frame.astype(np.float32), everywhere) for frame in pair]
    field = evaluate_pair(*frames, settings=PivSettings(uncertainty=False))
    assert np.mean(field.u_px) == pytest.approx(2.4, abs=0.005)
    assert np.mean(field.v_px) == pytest.approx(0.7, abs=0.005)


def test_steps_have_an_order_and_one_background():
    whole = Preparation(("pod", "cap", "min-max"))
    assert whole.background == "pod"
    assert len(whole.descriptions) == 3
    assert Preparation(()).background is None
    frame = np.ones((3, 3), np.float32)
    assert Preparation(("pod",)).apply(frame, np.ones((3, 3), bool)) is frame
    for steps, words in (
        (("mean", "pod"), "only one background"),
        (("cap", "mean"), "raw frames come first"),
        (("cap", "cap"), "given twice"),
        (("clahe",), "moves correlation peaks"),
        (("wiener",), "no step 'wiener'"),
    ):
        with pytest.raises(PairError, match=words):
            Preparation(steps)
