"""Particle images that are not round: astigmatic ones, streaks and rings, inclined to the pixels and along flows.

Drawn here as any profile over four points a pixel, of uneven brightness, 12 bit.
"""

import numpy as np
import pytest

from piv.correlation.inclined_images import inclination_of
from piv.correlation.pair import evaluate_pair
from piv.correlation.windows import window_grid
from tests.piv.correlation.flows import uniform
from tests.slow_cases import one_in_three, slow

SIDE, MARGIN = 256, 40


def pair_of(flow, profile, reach, seed=3, count=5000, noise=6.0, loss=0.0):
    """Frames A and B of particles whose images are profile(x, y) of the distance from their middle."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-MARGIN, SIDE + MARGIN, (2, count))
    bright = 500.0 * np.exp(rng.normal(0.0, 0.3, count))
    u, v = np.broadcast_arrays(*flow(x, y))
    around, width = np.arange(-reach, reach + 1), SIDE + 4 * reach + 4 * MARGIN
    frames = []
    for sign in (-0.5, 0.5):
        gone = (rng.uniform(size=count) < loss) & (sign > 0.0)
        here = [np.where(gone, rng.permutation(place), place) for place in (x + sign * u, y + sign * v)]
        whole = [np.rint(place).astype(int) for place in here]
        images = 0.0
        for i, j in np.ndindex(2, 2):
            along, down = (
                around + 0.5 * part - 0.25 + (pixel - place)[:, None]
                for part, pixel, place in zip((i, j), whole, here, strict=True)
            )
            images = images + 0.25 * profile(along[:, None, :], down[:, :, None])
        columns, rows = (pixel[:, None] + around + 2 * MARGIN + reach for pixel in whole)
        at = (rows[:, :, None] * width + columns[:, None, :]).ravel()
        light = np.bincount(at, (bright[:, None, None] * images).ravel(), width**2).reshape(width, width)
        inner = slice(2 * MARGIN + reach, 2 * MARGIN + reach + SIDE)
        counts = 60.0 + light[inner, inner] + rng.normal(0.0, noise, (SIDE, SIDE))
        frames.append(np.clip(np.rint(counts), 0, 4095).astype(np.uint16))
    return frames


def ellipse(across_px, along_px, angle):
    """Gaussian image whose longer axis has this angle to the rows."""
    c, s = np.cos(angle), np.sin(angle)
    return lambda x, y: np.exp(-(((y * c - x * s) / across_px) ** 2 + ((x * c + y * s) / along_px) ** 2) / 2.0)


def ring(radius_px, width_px):
    """Image of a particle out of focus."""
    return lambda x, y: np.exp(-(((np.hypot(x, y) - radius_px) / width_px) ** 2) / 2.0)


def inner_errors(frames, flow):
    """Field and errors, the outer nodes left out."""
    field = evaluate_pair(*frames, threads=1)
    x, y = np.meshgrid(field.x_px, field.y_px)
    off = np.stack([field.u_px, field.v_px], -1) - np.stack(np.broadcast_arrays(*flow(x, y)), -1)
    off[~field.valid] = np.nan
    return field, off[3:-3, 3:-3]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("across_px", "along_px", "degrees"), [(0.7, 1.8, 45), slow(0.9, 1.8, -45), slow(0.7, 1.8, 67), (0.8, 2.6, 30)]
)
def test_vectors_of_inclined_images_reach_their_end(across_px, along_px, degrees):
    """Passes took off a third of the error along the images: 0.01 to 0.1 px were left, with a sigma of 0.002."""
    flow = uniform(2.37, -1.61)
    field, off = inner_errors(pair_of(flow, ellipse(across_px, along_px, np.radians(degrees)), 13), flow)
    assert field.valid.mean() > 0.99
    assert np.abs(np.nanmean(off, axis=(0, 1))).max() < 0.008
    assert np.sqrt(np.nanmean(off**2)) < 0.010
    assert 0.5 < np.sqrt(np.nanmean(off**2) / np.nanmean(field.total_sigma_px[3:-3, 3:-3] ** 2)) < 2.5


@pytest.mark.parametrize(("u", "v"), [(11.0, 6.0), (-7.0, 9.0)])
def test_vectors_of_streaks_reach_their_end(u, v):
    """Particles that move by a third of their way while the light lasts: errors were 0.03 to 0.12 px."""
    flow, length_px = uniform(u, v), np.hypot(u, v)
    streaks = ellipse(0.8, np.hypot(0.8, 0.35 * length_px / np.sqrt(12.0)), np.arctan2(v, u))
    _, off = inner_errors(pair_of(flow, streaks, 8), flow)
    assert np.sqrt(np.nanmean(off**2)) < 0.015


@pytest.mark.parametrize("degrees", [20, 45, 110, 150])
def test_the_inclination_is_that_of_the_images(degrees):
    """Of Gaussian images M is the inverse of twice their covariance, whatever lies between them."""
    across_px, along_px = 0.9, 1.7
    frame = pair_of(uniform(0.0, 0.0), ellipse(across_px, along_px, np.radians(degrees)), 9, noise=0.0)[0]
    found = inclination_of((frame - frame.mean()).astype(np.float32))
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    axes = np.array([[c, s], [-s, c]])
    inverse = axes.T @ np.diag([along_px**-2.0, across_px**-2.0]) @ axes
    assert np.median(found.k) == pytest.approx(inverse[0, 1] / np.sqrt(inverse[0, 0] * inverse[1, 1]), abs=0.06)
    grid = window_grid(frame.shape, 32, 0.5)
    left = np.broadcast_to([0.2, -0.1], (*grid.shape, 2))
    read = [left[..., k] + inverse[0, 1] / inverse[k, k] * left[..., 1 - k] for k in (0, 1)]
    solved = np.median(found.solve(np.stack(read, -1), grid), axis=(0, 1))
    assert solved == pytest.approx([0.2, -0.1], abs=0.03)


def test_round_images_have_no_inclination():
    for seed in range(4):
        frames = pair_of(uniform(1.0, 2.0), ellipse(0.9, 0.9, 0.0), 6, seed=seed, count=1500, noise=20.0)
        assert inclination_of((frames[0] - frames[0].mean()).astype(np.float32)) is None


LARGE = [
    (ellipse(0.7, 1.8, 0.0), uniform(2.37, -1.61)),
    (ellipse(0.8, 2.2, np.pi / 2), uniform(0.9, -3.4)),
    (ellipse(0.8, 2.2, np.pi / 4), uniform(-3.1, -2.7)),
    (ring(3.2, 0.8), uniform(3.1, 2.4)),
    (ring(2.6, 0.7), lambda x, y: (6.0 * (1.0 - np.exp(-np.maximum(SIDE - y, 0.0) / 25.0)), 0.0 * x)),
]


@pytest.mark.parametrize(("loss", "image"), one_in_three((0.0, 0.25), LARGE))
def test_large_images_are_not_light_that_stands_still(loss, image):
    """They lie over themselves when they have moved by their smaller width: that was taken off both frames."""
    profile, flow = image
    field, off = inner_errors(pair_of(flow, profile, 11, count=2500, loss=loss), flow)
    assert field.common_light_px == 0.0
    assert field.warning == ""
    assert field.valid.mean() > (0.97 if loss == 0.0 else 0.88)
    assert np.sqrt(np.nanmean(off**2)) < (0.05 if loss == 0.0 else 0.3)
