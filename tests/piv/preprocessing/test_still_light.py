"""Walls and reflections that nobody told, against what else stands still: a fluid at rest, dust, one picture."""

import numpy as np
import pytest
import scipy

from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorFlag
from piv.preprocessing import still_light as module
from piv.preprocessing.still_light import across_pairs, still_light
from tests.loops import loop_over
from tests.piv.conftest import draw, make_pair
from tests.piv.fixed_windows import evaluate_pair

SHAPE, WALL = (192, 224), 130
EVERYWHERE = np.ones(SHAPE, bool)


def boundary_layer(u, v):
    return 4.0 * (1.0 - np.exp(-np.maximum(WALL - v, 0.0) / 12.0)), 0 * u


def grain(first_row, shape=SHAPE, seed=3):
    """Bright spots of 3 px on a bright body, from a row downwards."""
    rng = np.random.default_rng(seed)
    count = int(0.08 * (shape[0] - first_row) * shape[1])
    u, v = rng.uniform(0, shape[1], count), rng.uniform(first_row, shape[0], count)
    body = np.where(np.arange(shape[0])[:, None] >= first_row, 700.0, 0.0)
    return body + draw(shape, u, v, 3.0, rng.uniform(500, 3000, count))


def over_a_wall(seed, flicker=(1.0, 1.0), wall=WALL, **image):
    """A pair over a wall whose light flickers from pulse to pulse; no particle is in solid."""
    bright, inside = grain(wall), np.arange(SHAPE[0])[:, None] < wall
    found = []
    for frame, light in zip(make_pair(boundary_layer, SHAPE, seed=seed, **image), flicker, strict=True):
        fluid = np.where(inside, 0.25 * frame, 25.0)
        found.append(np.clip(np.rint(fluid + light * bright), 0, 4095).astype(np.uint16))
    return found


@pytest.mark.parametrize("settings", [PivSettings(), PivSettings(finest_px=16)])
@pytest.mark.parametrize("flicker", [(1.0, 1.0), (0.8, 1.2)])
def test_a_pair_has_no_vector_in_a_wall_that_nobody_told(settings, flicker):
    """All of them were valid, of no displacement, and unsure by a hundredth of a pixel."""
    field = evaluate_pair(*over_a_wall(1, flicker), settings=settings)
    solid = field.y_px >= WALL
    assert solid.sum() * len(field.x_px) > 30
    assert (field.flags[solid] == VectorFlag.STILL).all()
    for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "resolution_px"):
        assert np.isnan(getattr(field, name)[solid]).all(), name
    assert field.counts["still"] >= solid.sum() * len(field.x_px)
    assert not field.warning  # a wall is no reason to distrust what is beside it
    away = (field.y_px < WALL - 32) & (field.y_px > 24)
    assert field.valid[away].mean() > 0.98
    true, _ = boundary_layer(*np.meshgrid(field.x_px, field.y_px))
    assert np.nanmedian(np.abs(field.u_px - true)[away]) < 0.05


def test_what_is_told_is_found_nearly_where_it_is():
    for first in (96, 130, 133):
        still = still_light([over_a_wall(first, wall=first)], EVERYWHERE)
        assert still[first + 2 :].all()
        assert not still[: first - 16].any()


def test_a_series_finds_the_wall_that_flickers_as_it_likes():
    """Both pulses of a pair alike, too: without its background that is light which moves with nothing."""
    rng = np.random.default_rng(2)
    pairs = [over_a_wall(k, (light, light)) for k, light in enumerate(rng.uniform(0.7, 1.3, 6))]
    still = still_light(across_pairs(pairs), EVERYWHERE)
    assert still[WALL + 2 :].mean() > 0.99
    assert not still[: WALL - 16].any()


def test_frames_are_compared_across_pairs_and_a_single_pair_with_itself():
    pairs = [tuple(np.full(1, 10 * k + pulse) for pulse in range(2)) for k in range(3)]
    assert [(int(a[0]), int(b[0])) for a, b in across_pairs(iter(pairs))] == [(0, 11), (10, 21)]
    assert [(int(a[0]), int(b[0])) for a, b in across_pairs(pairs[:1])] == [(0, 1)]
    assert list(across_pairs([])) == []


@pytest.mark.parametrize("ppp", [0.004, 0.03])
@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_a_fluid_at_rest_beside_one_that_moves_is_no_wall(ppp, noise):
    pair = make_pair(lambda u, v: (np.where(v < 96, 5.0, 0.0), 0 * u), SHAPE, seed=4, ppp=ppp, noise=noise)
    assert still_light([pair], EVERYWHERE) is None


def test_a_thin_jet_in_a_fluid_at_rest_makes_no_wall_of_it():
    pair = make_pair(lambda u, v: (np.where(abs(v - 96) < 14, 5.0, 0.0), 0 * u), SHAPE, seed=5, ppp=0.03)
    assert still_light([pair], EVERYWHERE) is None


def test_dust_before_a_flow_that_loses_most_of_its_particles_is_no_wall():
    rng = np.random.default_rng(9)
    dust = draw(SHAPE, rng.uniform(0, SHAPE[1], 900), rng.uniform(0, SHAPE[0], 900), 3.0, np.full(900, 3000.0))
    pairs = [
        [0.4 * frame + dust for frame in make_pair(lambda u, v: (3.0 + 0 * u, 0 * v), SHAPE, seed=k, loss=0.7)]
        for k in range(8)
    ]
    assert still_light(across_pairs(pairs), EVERYWHERE) is None
    assert still_light(pairs[:1], EVERYWHERE) is None


def test_a_wall_behind_a_flow_is_no_wall():
    behind = grain(0)
    pair = [0.5 * frame + 0.4 * behind for frame in make_pair(lambda u, v: (4.0 + 0 * u, 0 * v), SHAPE, ppp=0.04)]
    assert still_light([pair], EVERYWHERE) is None


def test_two_pictures_of_nothing_that_moves_have_no_wall():
    one, _ = make_pair(lambda u, v: (0 * u, 0 * v), SHAPE, seed=6)
    assert still_light([(one, one)], EVERYWHERE) is None
    assert still_light([(one * 0, one * 0)], EVERYWHERE) is None


@pytest.mark.parametrize(("scale", "kind"), [(1e30, np.float64), (1e-12, np.float64), (1.0, np.uint16)])
def test_counts_of_any_size_show_the_same_wall(scale, kind):
    pair = [(frame * scale).astype(kind) for frame in over_a_wall(7)]
    np.testing.assert_array_equal(still_light([pair], EVERYWHERE), still_light([over_a_wall(7)], EVERYWHERE))


@loop_over("rows", [189, 190, 191, 192])
@loop_over("columns", [221, 222, 223])
def test_frames_have_any_size(rows, columns):
    pair = [frame[:rows, :columns] for frame in over_a_wall(1)]
    still, whole = still_light([pair], np.ones((rows, columns), bool)), still_light([over_a_wall(1)], EVERYWHERE)
    assert still.shape == (rows, columns)
    assert (still[:176, :208] == whole[:176, :208]).mean() > 0.999
    tiny = [np.arange(n * 30, dtype=np.uint16).reshape(n, 30) for n in (30, 30)]
    assert still_light([tiny], np.ones((30, 30), bool)) is None


def test_what_is_masked_is_neither_looked_at_nor_called_still():
    valid = EVERYWHERE.copy()
    valid[:, :96] = False
    pair = [np.where(valid, frame, np.nan) for frame in over_a_wall(8)]
    field = evaluate_pair(*pair, valid)
    told = field.x_px < 80
    assert (field.flags[:, told] != VectorFlag.VALID).all()
    assert (field.flags[field.y_px < WALL - 32][:, told] == VectorFlag.MASKED).all()
    assert (field.flags[field.y_px > WALL][:, field.x_px > 128] == VectorFlag.STILL).all()


def test_a_wall_that_others_found_is_taken_as_they_say():
    pair = make_pair(lambda u, v: (3.0 + 0 * u, 0 * v), SHAPE, seed=9)
    still = np.zeros(SHAPE, bool)
    still[:, 128:] = True
    field = evaluate_pair(*pair, still=still)
    assert (field.flags[:, field.x_px >= 128] == VectorFlag.STILL).all()
    assert field.valid[:, field.x_px < 112].all()
    wall = over_a_wall(1)
    assert evaluate_pair(*wall, still=np.zeros(SHAPE, bool)).valid[-1].all()


@pytest.mark.parametrize("size", [(4, 4), (2, 2), (2, 8), (8, 2), (7, 7), (1, 6)])
def test_cells_are_worn_and_grown_as_scipy_does_it(size):
    """At the border of frames too, which are smaller than a rectangle or not, whose sides may be even."""
    rng, ones = np.random.default_rng(1), np.ones(size, bool)
    for _ in range(40):
        cells = rng.random(rng.integers(1, 30, 2)) < rng.choice([0.05, 0.5, 0.95])
        found = module._dilate(cells, size)
        np.testing.assert_array_equal(found, scipy.ndimage.binary_dilation(cells, ones))
        for beyond in (0, 1):
            found = module._erode(cells, size, beyond)
            np.testing.assert_array_equal(found, scipy.ndimage.binary_erosion(cells, ones, border_value=beyond))
