"""What blocks beside each other agree on is what vectors miss; noise agrees on nothing."""

import numpy as np
import pytest

from piv.correlation.agreement import Agreed, measure_agreement, resolution_of
from piv.correlation.settings import PivSettings
from piv.correlation.uncertainty import Blocks
from piv.correlation.windows import window_grid
from tests.piv.correlation import flows
from tests.piv.fixed_windows import evaluate_pair

SHAPE, SIDE_PX, MARGIN = (384, 384), 3, 48


def blocks_that_move_by(missed_px, noise, seed=1):
    """Blocks whose light is random, which lean by what a field (v, u) -> du, dv and noise make of them."""
    rng = np.random.default_rng(seed)
    count = SHAPE[0] // SIDE_PX
    centre = (np.arange(count) + 0.5) * SIDE_PX - 0.5
    light = rng.gamma(0.5, 2.0, (2, count, count)).astype(np.float32)
    moved = np.stack(np.broadcast_arrays(*missed_px(*np.meshgrid(centre, centre))))
    lean = light * moved + noise * rng.normal(size=light.shape)
    return Blocks(lean.astype(np.float32), light, (centre, centre), SIDE_PX)


@pytest.mark.parametrize("told_px", [0.0, 0.3])
def test_blocks_say_what_is_missed_through_as_much_noise(told_px):
    grid = window_grid(SHAPE, 32, 0.5)
    moved = blocks_that_move_by(lambda u, v: (told_px + 0.1 * np.sin(2 * np.pi * v / 120), 0 * u), 0.1)
    beyond = np.zeros((*grid.shape, 2))
    beyond[..., 0] = told_px
    found = measure_agreement(moved, grid, beyond, np.ones(grid.shape), 32)
    assert np.mean(found.square_px2) == pytest.approx(0.25 * 0.1**2, rel=0.2)  # of both components one is missed


def test_noise_agrees_on_nothing_and_says_by_how_much_chance_may():
    grid = window_grid(SHAPE, 32, 0.5)
    nothing = np.zeros((*grid.shape, 2))
    chance = [
        measure_agreement(
            blocks_that_move_by(lambda u, v: (0 * u, 0 * v), 0.3, seed), grid, nothing, np.ones(grid.shape), 32
        )
        for seed in range(12)
    ]
    square = np.stack([one.square_px2 for one in chance])[:, 4:-4, 4:-4]
    stated = np.stack([one.chance_px2 for one in chance])[:, 4:-4, 4:-4]
    assert abs(square.mean()) < 0.1 * square.std()
    assert np.sqrt(np.mean(stated**2)) == pytest.approx(square.std(), rel=0.3)


def test_vectors_that_do_not_count_and_frames_that_show_half():
    grid = window_grid(SHAPE, 32, 0.5)
    moved = blocks_that_move_by(lambda u, v: (np.where(u < 192, 0.1, 5.0), 0.1 + 0 * v), 0.0)
    good = np.broadcast_to(grid.x_px < 170, grid.shape)
    found = measure_agreement(moved, grid, np.zeros((*grid.shape, 2)), good.astype(float), 32)
    assert found.square_px2[good] == pytest.approx(0.1**2, rel=0.02)
    halved = moved._replace(lean=0.5 * moved.lean)
    found = measure_agreement(halved, grid, np.zeros((*grid.shape, 2)), 0.5 * good, 32)
    assert found.square_px2[good] == pytest.approx(0.1**2, rel=0.02)


@pytest.mark.parametrize(("is_halved", "beside"), [(False, 0.0), (True, 0.3)])
def test_what_is_measured_well_replaces_the_model_and_what_is_not_leaves_it(is_halved, beside):
    model, halved = np.array([[0.3]]), np.array([[is_halved]])
    sigma, one = (
        np.full((1, 1, 2), 0.03),
        np.full((1, 1, 2), 0.002),
    )  # of noise that vectors follow there is little
    sure = resolution_of(Agreed(np.array([[0.05**2]]), np.array([[1e-6]])), model, halved, sigma, one, 1.0)
    assert sure == pytest.approx(np.hypot(beside, 0.04), rel=0.02)  # 0.05 is all of the error, 0.03 of it random
    for vague in (
        Agreed(np.array([[0.05**2]]), np.array([[1.0]])),
        Agreed(np.array([[-0.1]]), np.array([[1e-6]])),
    ):
        assert resolution_of(vague, model, halved, sigma, one, 1.0) == pytest.approx(model, rel=1e-3)


@pytest.mark.parametrize("amplitude_px", [0.2, 0.25])
def test_noise_that_vectors_follow_is_given_back(amplitude_px):
    """Vectors made of the very blocks hide their noise, and the flow beside it, from products of these blocks."""
    grid, noise = window_grid(SHAPE, 32, 0.75), 0.3

    def wave(u, v):
        return amplitude_px * np.sin(2 * np.pi * u / 90) + 0 * v, amplitude_px * np.sin(2 * np.pi * v / 90) + 0 * u

    errors, products, variances = [], [], []
    for seed in range(6):
        blocks = blocks_that_move_by(wave, noise, seed)
        down, along = (
            np.exp(-0.5 * ((node[:, None] - place[None]) / 8.0) ** 2)
            for node, place in zip((grid.y_px, grid.x_px), blocks.centres, strict=True)
        )
        leans, light = blocks.lean * blocks.by_shift, np.square(blocks.by_shift)
        total = np.stack([down @ part @ along.T for part in light], -1)
        vectors = np.stack([down @ part @ along.T for part in leans], -1) / total
        variance = noise**2 * np.stack([down**2 @ part @ along.T**2 for part in light], -1) / np.square(total)
        off = vectors - np.stack(wave(*np.meshgrid(grid.x_px, grid.y_px)), -1)
        found = measure_agreement(blocks, grid, vectors, np.ones(grid.shape), 32)
        for parts, part in zip(
            (errors, products, variances), (np.square(off), found.square_px2, variance), strict=True
        ):
            parts.append(part[4:-4, 4:-4].mean())
    error, variance = np.mean(errors), np.mean(variances)
    measured = Agreed(np.full((1, 1), np.mean(products)), np.full((1, 1), 0.01 * variance))
    sigma, nothing = np.full((1, 1, 2), np.sqrt(variance)), np.zeros((1, 1))
    assert measured.square_px2 < 0.6 * error
    stated = np.square(resolution_of(measured, nothing, nothing > 0.0, sigma, sigma, 1.0)) + variance
    assert np.sqrt(error / stated) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("overlap", [0.5, 0.75])
def test_in_turbulence_beyond_the_windows_sigma_is_the_error_at_every_overlap(particle_pair, overlap):
    """What vectors show of bends said half of the error at 75 % overlap, for the rest was not in them."""
    truth = flows.turbulence(5, 3.0, 250, 30, slope=-3.0)
    field = evaluate_pair(
        *particle_pair(truth, SHAPE, seed=5, ppp=0.05), settings=PivSettings(overlap=overlap), threads=1
    )
    u, v = np.meshgrid(field.x_px, field.y_px)
    off = np.stack([field.u_px, field.v_px], -1) - np.stack(truth(u, v), -1)
    inner = (np.minimum(u, v) > MARGIN) & (np.maximum(u, v) < SHAPE[0] - MARGIN)
    inner &= field.valid & (np.linalg.norm(off, axis=-1) < 1.0)
    over = (off / field.total_sigma_px)[inner]
    assert 0.85 < np.sqrt(np.mean(over**2)) < 1.15
    assert 0.62 < np.mean(np.abs(over) < 1.0) < 0.76
