"""Hot pixels are told from images of particles that are as small as a pixel and coincide by chance."""

import numpy as np

from piv.preprocessing.hot_pixels import hot_pixels

SHAPE = (160, 160)


def bright(seed, share):
    """Single bright pixels (H, W) of random heights."""
    rng = np.random.default_rng(seed)
    return np.where(rng.random(SHAPE) < share, rng.uniform(100.0, 200.0, SHAPE), 0.0).astype(np.float32)


def test_only_what_is_bright_in_both_frames_more_often_than_by_chance_is_hot():
    a, b, valid = 20.0 + bright(1, 0.05), 20.0 + bright(2, 0.05), np.ones(SHAPE, bool)
    assert np.count_nonzero((a > 100) & (b > 100)) > 50
    assert hot_pixels(a, b, valid) is None
    defects = bright(3, 0.01)
    hot = hot_pixels(a + defects, b + defects, valid)
    assert hot is not None
    assert hot[defects > 0].mean() > 0.9
    assert hot.mean() < 0.015
