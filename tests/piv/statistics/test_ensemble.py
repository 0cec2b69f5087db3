"""Ensemble correlation against flows whose mean and stresses are known, where single pairs see too little."""

from dataclasses import replace

import numpy as np
import pytest

from piv.correlation.pair import evaluate_pair
from piv.correlation.prepare import prepare_pair
from piv.correlation.settings import PivSettings
from piv.correlation.windows import window_grid
from piv.errors import SeriesError
from piv.preprocessing.sliding_minimum import without_sliding_minimum
from piv.statistics.cells import cells_of, lags_of
from piv.statistics.ensemble import EnsembleSums
from piv.statistics.ensemble_field import ensemble_field, next_sweep
from piv.statistics.kernels.cell_planes import cell_products
from piv.statistics.moments import Moments
from piv.statistics.sweep import sweep_with
from tests.piv.conftest import draw
from tests.slow_cases import slow

PAIRS = 60


def frames(
    displacement, seed, shape, ppp=0.02, loss=0.0, noise=12.0, static=0.0, inside=lambda u, v: u == u, diameter=3.0
):
    """A pair; `displacement` (u, v) -> (du, dv) holds at the middle time, `loss` (u, v) is a share."""
    rng = np.random.default_rng(seed)
    margin = 16
    n = rng.poisson(ppp * (shape[0] + 2 * margin) * (shape[1] + 2 * margin))
    u, v = (rng.uniform(-margin, side + margin, n) for side in shape[::-1])
    u, v = u[inside(u, v)], v[inside(u, v)]
    du, dv = displacement(u, v)
    gone = rng.uniform(size=u.size) < (loss(u, v) if callable(loss) else loss)
    ub, vb = u + du / 2, v + dv / 2
    ub[gone], vb[gone] = (rng.uniform(-margin, side + margin, gone.sum()) for side in shape[::-1])
    light = 300.0 * rng.uniform(0.2, 1.0, u.size)
    made = []
    for x, y in ((u - du / 2, v - dv / 2), (ub, vb)):
        image = draw(shape, x, y, diameter, light) + 40.0 + static + rng.normal(0.0, noise, shape)
        made.append(np.clip(np.rint(image), 0, 4095).astype(np.uint16))
    return made


def swept(pairs, mean_px, energy_px2, valid=None, sweeps=2, window_px=16):
    """Sums of the last sweep, that begins with a uniform guess of the mean."""
    shape = pairs[0][0].shape
    grid = window_grid(shape, 32, 0.5)
    mean = np.broadcast_to(np.asarray(mean_px, float), (*grid.shape, 2))
    stress = np.broadcast_to([energy_px2, energy_px2, 0.0], (*grid.shape, 3))
    sweep = sweep_with(shape, mean, stress, grid, prepare_pair(*pairs[0], valid, 32).spread_px2)
    for number in range(sweeps):
        sums = EnsembleSums(sweep)
        for a, b in pairs:
            sums.add(a, b, valid)
        if number + 1 < sweeps:
            sweep = next_sweep(ensemble_field(sums, window_px), sweep)
    return sums


def test_products_are_those_of_plain_sums():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 43, 51)).astype(np.float32)
    cells, lags = cells_of(a.shape), lags_of(3)
    assert len(lags) == 49
    assert len(lags_of(3, half=True)) == 25
    line, out = np.empty(51, np.float32), np.empty((len(lags), cells.shape[1]), np.float32)
    for j, row in enumerate(cells.row):
        cell_products(a, b, lags, row, cells.column[0], 8, line, out)
        for n in range(0, len(lags), 5):
            dv, du = lags[n]
            for i, column in enumerate(cells.column):
                total = 0.0
                for y in range(row, row + 8):
                    for x in range(column, column + 8):
                        ya, xa = y - dv // 2, x - du // 2
                        if min(ya, xa, ya + dv, xa + du) >= 0 and max(ya, ya + dv) < 43 and max(xa, xa + du) < 51:
                            total += float(a[ya, xa]) * float(b[ya + dv, xa + du])
                assert out[n, i] == pytest.approx(total, abs=1e-4), (j, i, dv, du)


def test_mean_and_stresses_are_those_of_the_flow():
    rng = np.random.default_rng(3)
    turn = np.array([[0.9, 0.0], [0.4, 0.5]])
    off = (turn @ rng.normal(size=(2, PAIRS))).T
    pairs = [
        frames(lambda u, v, d=d: (2.3 + d[0] + 0 * u, -1.6 + d[1] + 0 * u), k, (128, 128))
        for k, d in enumerate(off)
    ]
    sums = swept(pairs, (2.0, -1.0), 0.5)
    true, cov = np.array([2.3, -1.6]) + off.mean(axis=0), np.cov(off.T)
    for side, least in ((32, 0.12), (16, 0.25)):
        field = ensemble_field(sums, side)
        assert field.valid.mean() > 0.95
        assert np.abs(np.nanmean(field.mean_px, axis=(0, 1)) - true).max() < 0.03
        stress, sure = (np.nanmedian(x, axis=(0, 1)) for x in (field.stress_px2, field.stress_sigma_px2))
        assert (np.abs(stress - [0.81, 0.41, 0.36]) < 2 * sure).all()
        assert (np.abs(stress - [cov[0, 0], cov[1, 1], cov[0, 1]]) < sure).all()
        assert 0.7 < sure[0] / (np.sqrt(2 / PAIRS) * 0.81) < 2.0  # sampling of the flow, and noise
        # what its own sigma says of the flow: sampling of 60 pairs
        error = np.abs(np.nanmean(field.mean_px, axis=(0, 1)) - [2.3, -1.6])
        assert (error < 3 * np.nanmedian(field.sigma_px, axis=(0, 1))).all()
        assert np.nanmedian(field.sigma_px) == pytest.approx(np.sqrt(np.trace(cov) / 2 / PAIRS), rel=0.5)
        assert np.nanstd(field.mean_px, axis=(0, 1)).max() < least
        assert np.nanmedian(field.correlation) == pytest.approx(1.0, abs=0.1)


def test_without_fluctuations_there_are_no_stresses_and_sigma_covers():
    pairs = [frames(lambda u, v: (1.4 + 0 * u, 0.7 + 0 * u), k, (128, 128), ppp=0.008) for k in range(30)]
    field = ensemble_field(swept(pairs, (1.0, 1.0), 0.0), 8)
    error = np.abs(field.mean_px - [1.4, 0.7])[field.valid]
    assert np.sqrt(np.mean(error**2)) < 0.04  # 15 particles a window in all
    assert 0.55 < np.mean(error < field.sigma_px[field.valid]) < 0.8
    assert np.abs(np.nanmean(field.stress_px2, axis=(0, 1))).max() < 0.04  # the limit named in `ensemble`


@pytest.mark.parametrize("noise", [slow(0.5), 30.0])
def test_noise_of_the_camera_is_no_stress(noise):
    """Half way between pixels, where sampling spreads it most; 30 counts are a sixth of an average particle."""
    noisy = [frames(lambda u, v: (1.0 + 0 * u, 1.0 + 0 * u), k, (128, 128), noise=noise) for k in range(20)]
    sums = swept(noisy, (1.0, 1.0), 0.0)
    for side in (16, 32):
        stress = ensemble_field(sums, side).stress_px2
        assert np.abs(np.nanmean(stress, axis=(0, 1))).max() < 0.03


@pytest.mark.parametrize("diameter", [2.0, slow(2.4), slow(4.4), 6.4])
def test_particle_images_of_any_size_add_no_stress(diameter):
    """Small ones were taken for noise (-0.14, -0.05 px^2), large ones fitted elsewhere than pairs (-0.08)."""
    pairs = [
        frames(lambda u, v: (2.3 + 0 * u, -1.2 + 0 * u), k, (96, 96), ppp=0.03, static=100.0, diameter=diameter)
        for k in range(20)
    ]
    field = ensemble_field(swept(pairs, (2.3, -1.2), 0.0, sweeps=1), 32)
    assert np.abs(np.nanmean(field.stress_px2, axis=(0, 1))).max() < 0.01


@pytest.mark.slow
def test_a_fifth_of_all_pixels_dead_moves_neither_mean_nor_stresses():
    rng = np.random.default_rng(8)
    off = rng.normal(0.0, 0.6, (24, 2))
    pairs = [
        frames(lambda u, v, d=d: (2.3 + d[0] + 0 * u, -1.2 + d[1] + 0 * u), k, (128, 128))
        for k, d in enumerate(off)
    ]
    alive = rng.uniform(size=(128, 128)) > 0.2
    whole, dead = (ensemble_field(swept(pairs, (2.0, -1.0), 0.5, seen), 32) for seen in (None, alive))
    assert dead.valid.mean() > 0.95
    moved = np.nanmean(dead.mean_px - whole.mean_px, axis=(0, 1))
    assert np.abs(moved).max() < 0.015
    more = np.nanmean(dead.stress_px2 - whole.stress_px2, axis=(0, 1))
    assert np.abs(more).max() < 0.08  # frames drawn to each other by their doubt: 0.24


@pytest.mark.slow
def test_what_stands_still_is_taken_off():
    rng = np.random.default_rng(9)
    dust = draw((128, 128), *rng.uniform(0, 128, (2, 200)), 3.0, np.full(200, 900.0))
    pairs = [frames(lambda u, v: (2.5 + 0 * u, 0 * u), k, (128, 128), static=dust, ppp=0.01) for k in range(40)]
    field = ensemble_field(swept(pairs, (2.5, 0.0), 0.0), 32)
    assert np.abs(np.nanmedian(field.mean_px, axis=(0, 1)) - [2.5, 0.0]).max() < 0.05
    assert field.valid.mean() > 0.9


def walled(pairs, wall, seed=12):
    """Over a wall whose grain flickers from flash to flash; without the smallest of its neighbours in time."""
    rng = np.random.default_rng(seed)
    shape = (112, 112)
    grain = draw(shape, rng.uniform(0, 112, 300), rng.uniform(wall, 112, 300), 3.0, rng.uniform(200, 1500, 300))
    bright = np.where(np.arange(shape[0])[:, None] >= wall, 300.0 + grain, 0.0)
    series = [], []
    for k in range(pairs):
        made = frames(
            lambda u, v: (1.5 + 0 * u, 0 * v), k, shape, ppp=0.03, inside=lambda u, v: v < wall, static=100.0
        )
        for one, frame in zip(series, made, strict=True):
            one.append((frame + bright * rng.uniform(0.75, 1.25)).astype(np.uint16))
    return list(zip(*(without_sliding_minimum(one) for one in series), strict=True))


def test_a_bright_wall_that_nobody_told_is_found():
    """Stresses beside it came out as low as -0.7 px^2, and its own light pulled the mean."""
    field = ensemble_field(swept(walled(20, 64), (1.5, 0.0), 0.0), 16)
    rows = cells_of((112, 112)).row
    assert field.solid[rows >= 64].all()
    assert not field.solid[rows < 64].any()
    assert not field.valid[field.grid.y_px > 64].any()
    beside = (field.grid.y_px > 40) & (field.grid.y_px < 57)
    assert field.valid[beside].all()
    assert np.nanmean(field.mean_px[beside], axis=(0, 1)) == pytest.approx([1.5, 0.0], abs=0.02)
    assert np.abs(np.nanmean(field.stress_px2[beside], axis=1)).max() < 0.04


def test_neither_dust_before_a_flow_nor_a_thin_series_is_solid():
    rng = np.random.default_rng(9)
    dust = draw((96, 96), *rng.uniform(0, 96, (2, 200)), 3.0, np.full(200, 900.0))
    lost = [
        frames(
            lambda u, v: (2.5 + 0 * u, 0 * u), k, (96, 96), static=dust, loss=lambda u, v: np.where(u > 64, 0.7, 0)
        )
        for k in range(24)
    ]
    assert not ensemble_field(swept(lost, (2.5, 0.0), 0.0, sweeps=1), 16).solid.any()
    assert not ensemble_field(swept(walled(4, 64), (1.5, 0.0), 0.0, sweeps=1), 16).solid.any()


RADIUS, MIDDLE = 122.0, 127.5


def thin_jet(u, v):
    """Displacement of a narrow jet whose shear layers are 14 px wide."""
    return 0.3 + 0 * u, -1.0 - 8.0 * np.exp(-((u - MIDDLE) ** 2) / (4 * 14.0**2))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("per_px", "count", "share"), [(0.008, 40, 0.95), (0.008, 160, 0.65), (0.004, 60, 0.5)])
def test_a_rim_with_few_particles_is_seen_better_than_by_vectors(per_px, count, share):
    """r > 0.75 R, 16 px against vectors of 32 px: half the error where 0.004 particles are on a pixel.

    With twice as many vectors are worse by little at 40 pairs, of which noise is most of the ensemble's error, and
    by 1.7 times at 160: theirs does not fall with the number of pairs.  The shear layer is within 0.1 px.
    """

    def loss(u, v):
        return 0.1 + 0.5 * np.clip((np.hypot(u - MIDDLE, v - MIDDLE) / RADIUS - 0.6) / 0.4, 0.0, 1.0)

    shape = (256, 256)
    rows, columns = np.mgrid[:256, :256]
    valid = np.hypot(columns - MIDDLE, rows - MIDDLE) < RADIUS
    pairs = [frames(thin_jet, k, shape, ppp=per_px, loss=loss) for k in range(count)]
    grid = window_grid(shape, 32, 0.5)
    moments = Moments.nothing(grid.shape)
    for a, b in pairs:
        found = evaluate_pair(a, b, valid, PivSettings(), threads=1)
        sigma = np.stack((found.sigma_u_px, found.sigma_v_px), axis=-1)
        moments = moments.add(np.stack((found.u_px, found.v_px), axis=-1), found.valid, sigma)
    mean = np.where(moments.count[..., None] > count / 4, moments.mean_uv, np.nan)
    sweep = sweep_with(shape, mean, moments.reynolds_stresses, grid, prepare_pair(*pairs[0], valid, 32).spread_px2)
    sums = EnsembleSums(sweep)
    for a, b in pairs:
        sums.add(a, b, valid)

    def error(where, mean_px, grid):
        x, y = np.meshgrid(grid.x_px, grid.y_px)
        off = mean_px - np.stack(thin_jet(x, y), axis=-1)
        kept = where(np.hypot(x - MIDDLE, y - MIDDLE) / RADIUS, np.abs(x - MIDDLE) / 14.0)
        off = off[kept & np.isfinite(off).all(axis=-1)]
        return float(np.sqrt(np.mean(off**2))), len(off) / max(np.count_nonzero(kept), 1)

    field = ensemble_field(sums, 16)
    rim = error(lambda r, layer: (r > 0.75) & (r < 1.0), field.mean_px, field.grid)
    by_vectors = error(lambda r, layer: (r > 0.75) & (r < 1.0), moments.mean_uv, grid)
    assert rim[0] < share * by_vectors[0], (rim, by_vectors)
    assert rim[1] > 0.9
    layer = error(lambda r, layer: (r < 0.75) & (layer > 0.7) & (layer < 2.5), field.mean_px, field.grid)
    assert layer[0] < 0.1
    assert layer[1] > 0.95


@pytest.mark.slow
def test_a_wall_is_resolved_to_8_px():
    """u = 9 px (1 - exp(-y/18 px)) of a wall: the first window of 8 px touches it."""
    shape, wall = (128, 192), 24.0

    def profile(v):
        return 9.0 * (1.0 - np.exp((wall - v) / 18.0))

    pairs = [
        frames(lambda u, v: (profile(v), 0 * v), k, shape, ppp=0.015, inside=lambda u, v: v > wall)
        for k in range(PAIRS)
    ]
    rows, _ = np.mgrid[: shape[0], : shape[1]]
    valid = rows > wall
    grid = window_grid(shape, 32, 0.5)
    x, y = np.meshgrid(grid.x_px, grid.y_px)
    coarse = np.stack((profile(np.maximum(y, wall + 8)), 0 * x), axis=-1) * 0.97
    sweep = sweep_with(
        shape, coarse, np.zeros((*grid.shape, 3)), grid, prepare_pair(*pairs[0], valid, 32).spread_px2
    )
    for number in range(2):
        sums = EnsembleSums(sweep)
        for a, b in pairs:
            sums.add(a, b, valid)
        if number == 0:
            sweep = next_sweep(ensemble_field(sums, 16), sweep)
    field = ensemble_field(sums, 8)
    near = field.grid.y_px > wall + 3.0
    found, sigma = (np.nanmean(values[near, 1:-1, 0], axis=1) for values in (field.mean_px, field.sigma_px))
    true = profile(field.grid.y_px[near])
    assert true[0] < 3.0  # within the steepest part
    assert np.abs(found - true)[1:].max() < 0.1, (found, true, sigma)
    assert abs(found[0] - true[0]) < 0.3  # half of the wall's first window is empty
    for window_px in (8, 16, 32):  # what lies beside the middle of windows stands in sigma
        field = ensemble_field(sums, window_px)
        near = (field.grid.y_px > wall) & (field.grid.y_px < wall + window_px)
        off = np.abs(field.mean_px[near, 1:-1, 0] - profile(field.grid.y_px[near])[:, None])
        total = np.hypot(field.sigma_px[near, 1:-1, 0], field.resolution_px[near, 1:-1])
        assert off.size, window_px
        assert np.nanmean(off < 2.0 * total) > 0.9, window_px


@pytest.mark.slow
def test_fields_of_pairs_lead_to_the_same_stresses_with_less_noise():
    rng = np.random.default_rng(4)
    off = rng.normal(size=(PAIRS, 2)) * 1.2

    def flow(k):
        return lambda u, v: (3.0 + off[k, 0] + 0 * u, off[k, 1] + 0.3 * np.sin(u / 9.0))

    pairs = [frames(flow(k), k, (128, 128)) for k in range(PAIRS)]
    grid = window_grid((128, 128), 32, 0.5)
    stress = np.broadcast_to([1.4, 1.4, 0.0], (*grid.shape, 3))
    mean = np.broadcast_to([3.0, 0.0], (*grid.shape, 2))
    sweep = sweep_with((128, 128), mean, stress, grid, prepare_pair(*pairs[0], None, 32).spread_px2)
    steady, driven = EnsembleSums(sweep), EnsembleSums(sweep)
    sigma, good = np.full((*grid.shape, 2), 0.1), np.ones(grid.shape, bool)
    good[:2, :2] = False
    for k, (a, b) in enumerate(pairs):
        steady.add(a, b)
        vectors = np.broadcast_to([3.0 + off[k, 0], off[k, 1]], (*grid.shape, 2)) + rng.normal(
            0, 0.1, (*grid.shape, 2)
        )
        driven.add(a, b, field_px=sweep.of_pair(vectors, sigma, good, grid))
    cov = np.cov(off.T)
    one, two = (ensemble_field(sums, 16) for sums in (steady, driven))
    x, _ = np.meshgrid(two.grid.x_px, two.grid.y_px)
    true = np.stack((3.0 + off[:, 0].mean() + 0 * x, off[:, 1].mean() + 0.3 * np.sin(x / 9.0)), axis=-1)
    errors = [np.sqrt(np.nanmean((field.mean_px - true) ** 2)) for field in (one, two)]
    assert errors[1] < 0.4 * errors[0]
    assert np.nanmean(two.stress_px2, axis=(0, 1)) == pytest.approx(
        [cov[0, 0], cov[1, 1], cov[0, 1]], rel=0.05, abs=0.03
    )
    assert np.nanstd(two.stress_px2[..., 0]) < 0.6 * np.nanstd(one.stress_px2[..., 0])


@pytest.mark.slow
def test_fields_that_follow_the_noise_of_their_pairs_add_nothing_to_stresses():
    """Fields that take all of their pairs' noise: twice the variance of vectors was left in a steady flow."""
    shape, rng = (128, 128), np.random.default_rng(8)
    off = rng.normal(size=(PAIRS, 2)) * 0.05
    pairs = [
        frames(
            lambda u, v, k=k: (1.5 + off[k, 0] + 0 * u, off[k, 1] + 0 * v),
            k,
            shape,
            ppp=0.03,
            loss=0.3,
            noise=25.0,
        )
        for k in range(PAIRS)
    ]
    grid = window_grid(shape, 32, 0.5)
    mean, stress = (
        np.broadcast_to([1.5, 0.0], (*grid.shape, 2)),
        np.broadcast_to([1.0, 1.0, 0.0], (*grid.shape, 3)),
    )
    sweep = sweep_with(shape, mean, stress, grid, prepare_pair(*pairs[0], None, 32).spread_px2)
    steady, driven, noise = EnsembleSums(sweep), EnsembleSums(sweep), []
    for k, (a, b) in enumerate(pairs):
        found = evaluate_pair(a, b, None, PivSettings(denoise=0.0), threads=1)
        vectors = np.stack((found.u_px, found.v_px), axis=-1)
        noise.append((vectors - [1.5 + off[k, 0], off[k, 1]])[found.valid])
        steady.add(a, b)
        sigma = np.full((*grid.shape, 2), 1e-3)  # nothing is taken off the noise
        driven.add(
            a, b, field_px=sweep.of_pair(np.where(found.valid[..., None], vectors, 0.0), sigma, found.valid, grid)
        )
    left = np.mean(np.square(np.concatenate(noise)))
    assert left > 0.02  # there is something to follow
    for side in (16, 32):
        one, two = (np.nanmean(ensemble_field(sums, side).stress_px2, axis=(0, 1)) for sums in (steady, driven))
        assert np.abs(two - one).max() < 0.6 * left, (side, one, two, left)


@pytest.mark.slow
def test_what_a_field_takes_from_its_pair_within_a_window_is_put_back():
    """Fields of pairs that show half of a wave of 40 px: 0.4 of its stress was lost in windows of 32 px."""
    rng = np.random.default_rng(6)
    shape, high, phases = (128, 128), 0.6, rng.uniform(0, 2 * np.pi, 40)

    def wave(u, phase):
        return high * np.sin(2 * np.pi * u / 40.0 + phase)

    grid = window_grid(shape, 32, 0.5)
    stress = np.broadcast_to([high**2 / 2, 0.05, 0.0], (*grid.shape, 3))
    made = [frames(lambda u, v, p=p: (wave(u, p), 0 * u), k, shape, ppp=0.03) for k, p in enumerate(phases)]
    sweep = sweep_with(
        shape, np.zeros((*grid.shape, 2)), stress, grid, prepare_pair(*made[0], None, 32).spread_px2
    )
    sums, x = EnsembleSums(sweep), np.meshgrid(sweep.cells.x_px, sweep.cells.y_px)[0]
    for pair, phase in zip(made, phases, strict=True):
        sums.add(*pair, field_px=np.stack((0.5 * wave(x, phase), 0 * x), axis=-1))
    for side in (16, 32):
        found = np.nanmean(ensemble_field(sums, side).stress_px2, axis=(0, 1))
        assert found[0] == pytest.approx(high**2 / 2, rel=0.08)
        assert found[1:] == pytest.approx([0.0, 0.0], abs=0.02)


def test_parts_add_up_and_come_back_from_arrays():
    pairs = [frames(lambda u, v: (1.0 + 0 * u, 0 * u), k, (96, 104)) for k in range(6)]
    whole, parts = swept(pairs, (1.0, 0.0), 0.0, sweeps=1), []
    for some in (pairs[:4], pairs[4:]):
        part = EnsembleSums(whole.sweep)
        for a, b in some:
            part.add(a, b)
        parts.append(EnsembleSums.from_arrays(part.to_arrays()))
    both = parts[0].merge_with(parts[1])
    assert both.pairs == 6
    arrays = both.to_arrays()
    for name, values in whole.to_arrays().items():
        assert arrays[name].shape == values.shape
        off = np.abs(np.subtract(arrays[name], values, dtype=np.float64))
        assert off.max() <= 1e-4 * float(np.abs(values).max()) + 1e-12
    again = EnsembleSums.from_arrays(arrays).to_arrays()
    assert all(values.tobytes() == arrays[name].tobytes() for name, values in again.items())
    for name in arrays:
        with pytest.raises(SeriesError, match="damaged"):
            EnsembleSums.from_arrays({key: value for key, value in arrays.items() if key != name})
        if np.ndim(arrays[name]):
            with pytest.raises(SeriesError, match="damaged"):
                EnsembleSums.from_arrays(arrays | {name: arrays[name] * np.nan})


def test_what_cannot_be_is_refused():
    a, b = frames(lambda u, v: (1.0 + 0 * u, 0 * u), 1, (96, 96))
    sums = swept([(a, b)], (1.0, 0.0), 0.0, sweeps=1)
    with pytest.raises(SeriesError, match="two pairs"):
        ensemble_field(sums, 16)
    with pytest.raises(SeriesError, match="not kept"):
        ensemble_field(sums, 24)
    with pytest.raises(SeriesError, match="rows, columns"):
        sums.add(a[:90], b[:90])
    other = EnsembleSums(replace(sums.sweep, reach_px=7))
    with pytest.raises(SeriesError, match="different sweeps"):
        sums.merge_with(other)
    grid = window_grid((96, 96), 32, 0.5)
    nothing = np.full((*grid.shape, 2), np.nan)
    with pytest.raises(SeriesError, match="begins with the mean of vectors"):
        sweep_with((96, 96), nothing, np.zeros((*grid.shape, 3)), grid, 0.6)


@pytest.mark.slow
@pytest.mark.parametrize(("length_px", "window_px"), [(40, 8), slow(40, 16), (80, 16), slow(64, 8)])
def test_what_windows_of_an_ensemble_average_out_stands_in_its_sigma(length_px, window_px):
    """Random sigma alone was 1.3 to 9 times less than the error, in every pair the same."""
    truth = lambda u, v: (2.0 + np.sin(2 * np.pi * v / length_px), 0 * u)  # noqa: E731
    sums = swept([frames(truth, k, (96, 128), ppp=0.03) for k in range(16)], (2.0, 0.0), 2.0, sweeps=3)
    field = ensemble_field(sums, window_px)
    x, y = np.meshgrid(field.grid.x_px, field.grid.y_px)
    off = (field.mean_px[..., 0] - truth(x, y)[0])[field.valid]
    total = np.hypot(field.sigma_px[..., 0], field.resolution_px)[field.valid]
    assert 0.6 < np.sqrt(np.mean(np.square(off / total))) < 1.45
    still = ensemble_field(
        swept([frames(lambda u, v: (2.0 + 0 * u, 0 * v), k, (96, 96)) for k in range(8)], (2, 0), 1), 16
    )
    assert np.nanmedian(still.resolution_px) < np.nanmedian(still.sigma_px)
