import numpy as np
import pytest

from piv.correlation.settings import PivSettings
from piv.errors import FrameError
from piv.preprocessing.preparation import min_max_normalised
from tests.piv.fixed_windows import evaluate_pair


def test_min_max_brings_particles_to_one_height_and_leaves_empty_spots_low():
    frame = np.full((60, 60), 100.0, np.float32)
    for k, height in enumerate((40, 400, 4000)):
        frame[10 + 20 * k, 10 + 20 * k] += height
    frame[50, 10] += 3  # noise
    result = min_max_normalised(frame, least_range=20)
    assert [result[10 + 20 * k, 10 + 20 * k] for k in range(3)] == pytest.approx([1.0, 1.0, 1.0], abs=1e-5)
    assert result[50, 10] == pytest.approx(0.15, abs=1e-5)
    assert result.min() == pytest.approx(0.0, abs=1e-5)


def test_masked_and_nan_pixels_neither_spread_nor_come_back():
    frame = np.full((30, 30), 100.0, np.float32)
    frame[10, 10] = 200
    frame[14, 14] = np.nan
    valid = np.ones((30, 30), bool)
    valid[:, 20:] = False
    frame[:, 20:] = 1e6
    result = min_max_normalised(frame, 20, valid)
    assert np.isnan(result[14, 14])
    assert np.isnan(result[:, 20:]).all()
    assert result[10, 10] == pytest.approx(1.0, abs=1e-5)
    assert np.count_nonzero(np.isnan(result)) == 301
    assert result[:, 19] == pytest.approx(np.zeros(30), abs=1e-5)


def test_normalisation_moves_no_vector(particle_pair):
    pair = particle_pair(lambda u, v: (2.4 + 0 * u, 0.7 + 0 * u), (256, 256), seed=9)
    field = evaluate_pair(
        *(min_max_normalised(frame, 200) for frame in pair), settings=PivSettings(uncertainty=False)
    )
    assert np.mean(field.u_px) == pytest.approx(2.4, abs=0.005)
    assert np.mean(field.v_px) == pytest.approx(0.7, abs=0.005)
    assert np.std(field.u_px) < 0.008


def test_calls_that_make_no_sense_are_named():
    with pytest.raises(FrameError, match="least_range"):
        min_max_normalised(np.zeros((4, 4)), 0)
    with pytest.raises(FrameError, match="2-D"):
        min_max_normalised(np.zeros(4), 1)
    with pytest.raises(FrameError, match="mask has shape"):
        min_max_normalised(np.zeros((4, 4)), 1, np.ones((4, 5), bool))


def test_the_least_range_comes_from_the_noise_of_the_frame():
    rng = np.random.default_rng(2)
    frame = rng.normal(100.0, 3.0, (200, 200)).astype(np.float32)
    frame[::12, ::12] += 900
    by_itself, said = min_max_normalised(frame), min_max_normalised(frame, 18.0)
    assert np.abs(by_itself - said).max() < 0.1
    assert not min_max_normalised(np.zeros((20, 20))).any()


def test_noise_alone_stays_low():
    """A frame divided by its own noise would be as high between particles as upon them."""
    frame = np.random.default_rng(3).normal(100.0, 3.0, (200, 200)).astype(np.float32)
    spread = float(np.std(min_max_normalised(frame)))
    assert spread == pytest.approx(1.0 / 6.0, rel=0.05)
