"""Dead pixels: what stands in them, how sure that is, and that nobody takes it for a measurement."""

import numpy as np
import pytest
from scipy import ndimage

from piv.correlation.deform import deform_pair
from piv.correlation.fill import NEAR, Texture, without_gaps
from piv.correlation.kernels import deform as deform_kernels
from piv.correlation.kernels import kriging
from piv.correlation.prepare import prepare_pair
from piv.correlation.windows import window_grid
from tests.piv.correlation.flows import MARGIN, errors, mix, rms, uniform, vortex
from tests.piv.fixed_windows import evaluate_pair
from tests.slow_cases import slow


def scattered(share, seed=3, shape=(512, 512)):
    return np.random.default_rng(seed).uniform(size=shape) >= share


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth",
    [slow(mix, name="mix"), slow(uniform(9.9, 9.9), name="9.9"), pytest.param(uniform(5.0, -3.0), id="whole")],
)
def test_a_fifth_of_all_pixels_dead_costs_less_than_twice_the_error(particle_pair, truth):
    """They stand still while the flow moves: at whole pixels they meet themselves nowhere, at none everywhere."""
    without, off, sigma = [], [], []
    for seed in (7, 8):
        pair = particle_pair(truth, seed=seed)
        gaps = evaluate_pair(*pair, scattered(0.2, seed))
        assert gaps.valid.mean() > 0.99
        without.append(errors(evaluate_pair(*pair), truth))
        off.append(errors(gaps, truth))
        sigma.append(np.stack([gaps.sigma_u_px, gaps.sigma_v_px], -1)[MARGIN:-MARGIN, MARGIN:-MARGIN])
    assert rms(off) < 2.0 * rms(without)
    assert 0.85 < rms(off) / rms(sigma) < 1.2


def test_pixels_that_do_not_move_pull_nothing_to_zero(particle_pair):
    truth = uniform(0.4, -0.3)
    pair = particle_pair(truth, seed=2)
    bias = [errors(evaluate_pair(*pair, seen), truth).mean(axis=(0, 1)) for seen in (None, scattered(0.2))]
    assert np.abs(bias[1] - bias[0]).max() < 0.001


def test_other_pixels_dead_in_each_frame(particle_pair):
    """36 % of the places are lost in one of them."""
    pair = [
        np.ma.array(frame, mask=~scattered(0.2, seed))
        for seed, frame in enumerate(particle_pair(mix, seed=7, noise=0.01))
    ]
    field = evaluate_pair(*pair)
    assert field.valid.mean() > 0.99
    assert rms(errors(field, mix)) < 0.02


def test_a_vortex_through_dead_pixels(particle_pair):
    field = evaluate_pair(*particle_pair(vortex(), seed=7), scattered(0.2))
    assert field.valid.mean() > 0.99
    assert rms(errors(field, vortex())) < 0.02  # 0.026 before filled pixels weighed what they are worth


@pytest.mark.slow
@pytest.mark.parametrize("share", [slow(0.05), 0.2, slow(0.3)])
def test_strangers_do_not_become_a_pair_by_completing_each_other(particle_pair, share):
    field = evaluate_pair(particle_pair(mix, seed=1)[0], particle_pair(mix, seed=2)[1], scattered(share))
    assert field.valid.mean() <= 0.2
    assert "one pair" in field.warning


def smooth_noise(shape, seed=0, sigma_px=1.2):
    frame = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), sigma_px)
    return (frame / frame.std()).astype(np.float32)


def test_filling_is_the_best_linear_guess_and_knows_its_error():
    truth, other, seen = smooth_noise((96, 96)), smooth_noise((96, 96), 1), scattered(0.2, shape=(96, 96))
    a, b = truth * seen, other * seen
    # A field smoothed by a Gaussian correlates over r as exp(-r^2/(4 sigma^2)).
    filled = without_gaps(a, b, seen, Texture(1.2**2, 1e-4))
    holes = filled.variance > 0.0
    assert np.array_equal(a[seen], truth[seen])
    inner = holes[6:-6, 6:-6]
    assert rms((a - truth)[6:-6, 6:-6][inner]) < 0.1
    expected = np.sqrt(filled.variance[6:-6, 6:-6][inner].mean())
    assert rms((a - truth)[6:-6, 6:-6][inner]) == pytest.approx(expected, rel=0.35)
    y, x = np.argwhere(holes)[200]
    near = [(y + j, x + i) for j, i in NEAR if 0 <= y + j < 96 and 0 <= x + i < 96 and seen[y + j, x + i]]
    places = np.array([*near, (y, x)], float)
    alike = np.exp(-((places[:, None] - places[None]) ** 2).sum(-1) / (4 * 1.2**2))
    share = np.linalg.solve(alike[:-1, :-1] + 1e-4 * np.eye(len(near)), alike[:-1, -1])
    assert a[y, x] == pytest.approx(sum(s * truth[at] for s, at in zip(share, near, strict=True)), abs=1e-4)
    assert filled.variance[y, x] == pytest.approx(1.0 - share @ alike[:-1, -1], abs=1e-5)


def test_the_edge_of_a_region_is_no_dead_pixel():
    a, b = smooth_noise((64, 64)), smooth_noise((64, 64), 1)
    seen = np.ones((64, 64), bool)
    seen[:, 40:] = False
    assert without_gaps(a * seen, b * seen, seen, Texture(0.6, 0.01)) is None
    v, u = np.mgrid[:64, :64]
    seen = np.hypot(u - 32, v - 32) < 25
    assert without_gaps(a * ~seen, b * ~seen, ~seen, Texture(0.6, 0.01)) is None
    assert without_gaps(a * seen, b * seen, seen, Texture(0.6, 0.01)) is None


def test_what_shines_in_dead_pixels_counts_nothing():
    frame, other, seen = (
        smooth_noise((64, 64), 9) + 5,
        smooth_noise((64, 64), 10) + 5,
        scattered(0.2, shape=(64, 64)),
    )
    pairs = [prepare_pair(np.where(seen, frame, light), other, seen, 16) for light in (0.0, 1e6)]
    assert np.array_equal(pairs[0].a, pairs[1].a)
    inner = np.s_[4:-4, 4:-4]
    assert np.array_equal((pairs[0].filled.variance > 0.0)[inner], ~seen[inner])
    assert pairs[0].valid[inner].min() == 1.0


def test_kriging_as_plain_python():
    a, b, seen = smooth_noise((20, 20)), smooth_noise((20, 20), 1), scattered(0.3, shape=(20, 20))
    holes, alike = np.argwhere(~seen), np.exp(-np.square(np.arange(8.0)) / 3.0)
    n = len(NEAR)
    results = []
    for kernel in (kriging.krige, kriging.krige.py_func):
        out = np.empty((len(holes), 3))
        scratch = np.empty((n, 2), np.int64), np.empty((n, n)), np.empty(n)
        kernel(a, b, seen, holes, NEAR, alike, 0.01, *scratch, 0, len(holes), out)
        results.append(out)
    assert np.abs(results[0] - results[1]).max() < 1e-6
    matrix = np.array([[4.0, 0, 0], [2, 5, 0], [1, 1, 3]])
    full = np.tril(matrix) + np.tril(matrix, -1).T
    for factorise, solve in (
        (kriging.factorise, kriging.solve),
        (kriging.factorise.py_func, kriging.solve.py_func),
    ):
        factor, right = matrix.copy(), np.array([1.0, 2.0, 3.0])
        factorise(factor, 3)
        explained = solve(factor, 3, right)
        assert right == pytest.approx(np.linalg.solve(full, [1.0, 2.0, 3.0]))
        assert explained == pytest.approx(right @ [1.0, 2.0, 3.0])


def test_frames_agree_where_they_are_unsure_and_their_difference_weighs_by_its_variance():
    a, b = smooth_noise((32, 32), 4), smooth_noise((32, 32), 5)
    seen = scattered(0.2, shape=(32, 32))
    filled = prepare_pair(a, b, seen, 16).filled
    grid, nothing = window_grid((32, 32), 16, 0.5), np.zeros((3, 3, 2))
    whole = np.ones((32, 32), np.float32)
    apart = deform_pair((a, b), whole, nothing, grid, 0.0)
    near = deform_pair((a, b), whole, nothing, grid, 0.0, filled=filled)
    inner = np.s_[4:-4, 4:-4]  # beyond, spline and bilinear weights see the edge
    worth = filled.noise / (2.0 * filled.variance + filled.noise)
    assert apart.worth is None
    assert np.abs(near.worth - worth)[inner].max() < 1e-5
    assert np.abs((near.a - near.b) - worth * (apart.a - apart.b))[inner].max() < 1e-4
    assert np.abs((near.a + near.b) - (apart.a + apart.b))[inner].max() < 1e-4


def test_agreeing_rows_as_plain_python():
    rng = np.random.default_rng(5)
    refined = np.broadcast_to(np.linspace(-1.7, 2.6, 16, dtype=np.float32), (2, 5, 16)).copy()
    cell, weight = np.zeros(12, np.int64), np.full((12, 4), 0.25, np.float32)
    frames, variance = rng.normal(size=(2, 12, 16)).astype(np.float32), scattered(0.3, shape=(12, 16))
    results = []
    for kernel in (deform_kernels.agree_rows, deform_kernels.agree_rows.py_func):
        a, b, worth = *frames.copy(), np.empty((12, 16), np.float32)
        scratch = np.empty((2, 16), np.int32), *np.empty((2, 2, 16), np.float32)
        filled = variance.astype(np.float32), np.float32(0.1)
        kernel(a, b, *filled, refined, cell, weight, 0, 12, *scratch, worth)
        results.append((a, b, worth))
    assert np.abs(np.array(results[0]) - results[1]).max() < 1e-5
