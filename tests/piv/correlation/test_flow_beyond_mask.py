"""Where the flow goes on behind a mask, vectors beside it are surer than at a wall, and not too sure."""

from dataclasses import replace

import numpy as np

from piv.correlation.pair import evaluate_pair
from piv.correlation.settings import PivSettings
from tests.piv.conftest import draw

SIDE, EDGE, PX = 192, 120, 2.4
AS_VIEW = PivSettings(windows_px=(32, 32, 32), denoise=0.0, flow_beyond_mask=True)


def wave(x):
    """Displacement along y [px] at x: it bends as much beside the mask as elsewhere."""
    return 1.5 * np.sin(2.0 * np.pi * x / 160.0)


def errors(settings, seeds):
    """Errors and uncertainty of v in the two columns of windows that the mask cuts."""
    off, sigma = [], []
    valid = np.ones((SIDE, SIDE), np.bool_)
    valid[:, EDGE:] = False
    for seed in seeds:
        rng = np.random.default_rng(seed)
        x, y = rng.uniform(-4.0, SIDE + 4.0, (2, 1800))
        light = rng.uniform(100.0, 400.0, len(x))
        pair = [draw((SIDE, SIDE), x, y + half * wave(x), PX, light) for half in (-0.5, 0.5)]
        a, b = (image + rng.normal(20.0, 4.0, image.shape) for image in pair)
        field = evaluate_pair(a, b, valid, settings)
        at = np.abs(field.x_px - EDGE + 8.0) < 9.0
        here = field.valid[:, at]
        off.append((field.v_px - wave(field.x_px))[:, at][here])
        sigma.append(np.hypot(field.sigma_v_px, field.resolution_px)[:, at][here])
    return np.concatenate(off), np.concatenate(sigma)


def test_vectors_beside_the_rim_of_a_view_are_surer_than_at_a_wall_and_not_too_sure():
    off, sigma = errors(AS_VIEW, range(2))
    _, at_wall = errors(replace(AS_VIEW, flow_beyond_mask=False), range(2))
    error, stated, wall = (np.sqrt(np.mean(np.square(part))) for part in (off, sigma, at_wall))
    assert 0.8 * error < stated < 0.75 * wall
