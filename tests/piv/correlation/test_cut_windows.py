"""Windows that a mask cuts: bends of the flow count, those of noise that no filter has taken off do not."""

import numpy as np
import pytest
import scipy

from piv.correlation.cut_windows import cut_px
from piv.correlation.refine import window_weights
from piv.correlation.windows import WindowGrid

SIDE, STEP, SIGMA, NOISE = 32, 8, 0.3, 0.05
SHAPE = 512, 480


def nodes():
    return WindowGrid(*(np.arange(0, length - SIDE + 1, STEP) for length in SHAPE), SIDE, STEP)


def window_noise(seed):
    """Noise of windows at the nodes, whose neighbours share light, of deviation NOISE."""
    raw = np.random.default_rng(seed).standard_normal((2, *SHAPE))
    for axis in (1, 2):
        raw = scipy.ndimage.convolve1d(raw, window_weights(SIDE, SIGMA), axis=axis)
    rows, columns = (np.rint(place).astype(int) for place in (nodes().y_px, nodes().x_px))
    return NOISE * np.moveaxis((raw / raw.std())[:, rows[:, None], columns], 0, -1)


def cut(bend, noise_px):
    """Median at nodes that the mask cuts, of a flow that bends by so many pixels over half a window."""
    valid = np.ones(SHAPE, np.float32)
    valid[:, SHAPE[1] // 2 :] = 0.0
    x, y = np.meshgrid(nodes().x_px, nodes().y_px)
    flow = 0.5 * bend * ((x - 240.0) / (SIDE / 2)) ** 2
    found = cut_px(np.stack((flow, 0.0 * y), axis=-1) + window_noise(3), valid, nodes(), SIDE, SIGMA, noise_px)
    return np.median(found[:, np.abs(nodes().x_px - 238.0) < STEP])


def test_noise_is_no_bend():
    assert cut(0.0, NOISE) < 0.4 * cut(0.0, None)


def test_bends_of_the_flow_stay():
    assert cut(1.0, NOISE) == pytest.approx(cut(1.0, None), rel=0.1)
