"""Synthetic particle image pairs with known displacement; shares nothing with the evaluator."""

import numpy as np
import pytest
from scipy.special import erf


def draw(shape, u, v, diameter_px, peak):
    """Sum of Gaussians I0 exp(-8 r^2/d^2), integrated over square pixels by differences of erf."""
    sigma = diameter_px / 4
    reach = int(np.ceil(5 * sigma + 1))
    around = np.arange(-reach, reach + 1)
    column, row = np.rint(u).astype(int), np.rint(v).astype(int)

    def integrated(position, centre):
        edge = (np.arange(-reach - 0.5, reach + 1)[None] + (centre - position)[:, None]) / (np.sqrt(2) * sigma)
        return np.diff(erf(edge), axis=1) * np.sqrt(np.pi / 2) * sigma

    spots = peak[:, None, None] * integrated(v, row)[:, :, None] * integrated(u, column)[:, None, :]
    height, width = shape
    near = (row >= -reach) & (row < height + reach) & (column >= -reach) & (column < width + reach)
    rim = 2 * reach  # for spots that lie half beside the picture
    rows, columns = (place[near, None] + around + rim for place in (row, column))
    stride = width + 2 * rim
    places = rows[:, :, None] * stride + columns[:, None, :]
    sums = np.bincount(places.ravel(), spots[near].ravel(), (height + 2 * rim) * stride)
    return sums.reshape(-1, stride)[rim:-rim, rim:-rim]


def make_pair(displacement, shape=(512, 512), seed=0, ppp=0.02, diameter_px=3.0, noise=0.01, loss=0.0):
    """Frames A, B (uint16, 12 bit); displacement(u, v) -> du, dv holds at the middle time.

    `loss` is the share of particles that are replaced by others in frame B; noise is in parts of 4095.
    """
    rng = np.random.default_rng(seed)
    margin = 40
    area = (shape[0] + 2 * margin) * (shape[1] + 2 * margin)
    n = rng.poisson(ppp * area)
    u = rng.uniform(-margin, shape[1] + margin, n)
    v = rng.uniform(-margin, shape[0] + margin, n)
    du, dv = (np.broadcast_to(d, u.shape) for d in displacement(u, v))
    lost = rng.uniform(size=n) < loss
    u_b = np.where(lost, rng.uniform(-margin, shape[1] + margin, n), u + du / 2)
    v_b = np.where(lost, rng.uniform(-margin, shape[0] + margin, n), v + dv / 2)
    intensity = np.full(n, 3000.0)
    frames = []
    for x, y in ((u - du / 2, v - dv / 2), (u_b, v_b)):
        image = draw(shape, x, y, diameter_px, intensity) + 100.0 + rng.normal(0, noise * 4095, shape)
        frames.append(np.clip(np.rint(image), 0, 4095).astype(np.uint16))
    return frames


@pytest.fixture(scope="session")
def particle_pair():
    return make_pair
