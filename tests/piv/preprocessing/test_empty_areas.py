"""Areas without particles: windows at their edge, sparse and dim particles, and what is empty."""

import numpy as np
import pytest

from piv.correlation.pair import evaluate_pair
from piv.correlation.vector_field import VectorFlag
from piv.preprocessing.empty_areas import empty_areas
from tests.slow_cases import slow_but

SIDE = 224
FLOWS = {
    "uniform": lambda x, y: (4.1 + 0.0 * x, -1.6 + 0.0 * x),
    "shear": lambda x, y: (0.03 * (y - SIDE / 2), 0.4 + 0.0 * x),
    "rotation": lambda x, y: (-0.025 * (y - SIDE / 2), 0.025 * (x - SIDE / 2)),
}


def drawn(flow, seed, per_px=0.03, light=None, noise=2.0, level=12.0):
    """A pair (2, H, W) of Gaussian images, whose light (H, W) may differ from place to place."""
    rng = np.random.default_rng(seed)
    count = int(per_px * (SIDE + 40) ** 2)
    x, y = rng.uniform(-20, SIDE + 20, (2, count))
    height = 90.0 * rng.lognormal(0.0, 0.4, count)
    u, v = flow(x, y)
    row, column = np.mgrid[:SIDE, :SIDE]
    frames = []
    for part in (-0.5, 0.5):
        frame = np.zeros((SIDE, SIDE))
        for px, py, h in zip(x + part * u, y + part * v, height, strict=True):
            i, j = int(py) - 4, int(px) - 4
            cut = np.s_[max(i, 0) : max(i + 9, 0), max(j, 0) : max(j + 9, 0)]
            frame[cut] += h * np.exp(-((column[cut] - px) ** 2 + (row[cut] - py) ** 2) / (2.0 * 0.7**2))
        frame *= 1.0 if light is None else light
        frames.append(np.clip(np.rint(frame + level + rng.normal(0.0, noise, frame.shape)), 0, 255))
    return np.array(frames).astype(np.uint8)


def beyond(radius_px):
    """Distance (H, W) beyond a round window in the middle of the frame."""
    row, column = np.mgrid[:SIDE, :SIDE]
    return np.hypot(column - 0.47 * SIDE, row - 0.52 * SIDE) - radius_px


def judged(field, flow):
    """Errors (ny, nx) and sigma with the resolution of a field."""
    x, y = np.meshgrid(field.x_px, field.y_px)
    u, v = flow(x, y)
    sigma = np.sqrt((field.sigma_u_px**2 + field.sigma_v_px**2) / 2.0 + np.nan_to_num(field.resolution_px) ** 2)
    return np.hypot(field.u_px - u, field.v_px - v), sigma


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_but(FLOWS, "shear"))
def test_vectors_at_the_edge_of_a_round_window_are_right(name):
    """Each of these frames had wrong and silent vectors at the edge, and a ring of vectors beyond it."""
    flow, away = FLOWS[name], beyond(80.0)
    wrong = silent = outside = count = 0
    for seed in range(3):
        field = evaluate_pair(*drawn(flow, seed, light=away < 0.0))
        error, sigma = judged(field, flow)
        at = away[np.ix_(field.y_px.astype(int), field.x_px.astype(int))]
        wrong += int((field.valid & (error > 0.5)).sum())
        silent += int((field.valid & (error > 0.3) & (error > 5.0 * sigma)).sum())
        outside += int((field.valid & (at > 4.0)).sum())
        count += int((field.valid & (at < -8.0)).sum())
        assert (field.flags[at > 12.0] == VectorFlag.STILL).mean() > 0.9
    assert count > 3 * 0.9 * np.pi * 72.0**2 / 8.0**2
    assert (silent, outside) == (0, 0)
    assert wrong <= 2


@pytest.mark.parametrize("shape", ["shadow", "corner", "strip", "body"])
def test_empty_areas_end_at_their_particles(shape):
    row, column = np.mgrid[:SIDE, :SIDE]
    empty = {
        "shadow": (column > 60) & (column < 120), "corner": column + row < 130, "strip": row < 40,
        "body": -beyond(45.0) > 0.0,
    }[shape]  # fmt: skip
    a, b = drawn(FLOWS["shear"], 5, light=~empty)
    found = empty_areas(a, b, np.ones(a.shape, bool))
    near = np.abs(beyond(45.0)) < 8.0 if shape == "body" else np.zeros(a.shape, bool)
    assert found is not None
    assert found[empty & ~near].mean() > 0.85
    assert found[~empty].mean() < 0.06


def test_sparse_particles_leave_no_empty_areas():
    for per_px in (0.006, 0.012, 0.05):
        for seed in range(5):
            a, b = drawn(FLOWS["rotation"], seed, per_px=per_px)
            assert empty_areas(a, b, np.ones(a.shape, bool)) is None


def test_dim_particles_keep_their_vectors():
    """Of 8 % of the usual light they are hardly more than noise; what stands there is measured all the same."""
    light = np.where(beyond(70.0) > 0.0, 0.08, 1.0)
    field = evaluate_pair(*drawn(FLOWS["uniform"], 3, per_px=0.04, light=light))
    error, _ = judged(field, FLOWS["uniform"])
    at = beyond(70.0)[np.ix_(field.y_px.astype(int), field.x_px.astype(int))] > 16.0
    assert field.valid[at].mean() > 0.6
    assert np.median(error[at & field.valid]) < 0.25


def test_a_mask_that_is_given_ends_where_it_ends():
    a, b = drawn(FLOWS["shear"], 5)
    valid = np.ones(a.shape, bool)
    valid[:, :70] = False
    assert empty_areas(a, b, valid) is None


@pytest.mark.parametrize("frame", [np.zeros((64, 64), np.uint8), np.full((12, 300), 7, np.uint8)])
def test_frames_without_anything_are_no_empty_areas(frame):
    assert empty_areas(frame, frame, np.ones(frame.shape, bool)) is None
