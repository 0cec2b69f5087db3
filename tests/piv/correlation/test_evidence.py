"""What a peak says counts: right vectors of short waves stay, chance does not."""

import numpy as np
import pytest

from piv.correlation.evidence import PROVEN, WEAK, is_chance_match, is_low_confidence, is_supported_by_peak
from piv.correlation.settings import PivSettings
from tests.piv.fixed_windows import evaluate_pair
from tests.slow_cases import slow


def wave(length_px):
    turn = 2 * np.pi / length_px
    return lambda u, v: (np.sin(turn * v), np.sin(turn * u))


def mix(u, v):
    return 3 + 0.004 * (v - 255.5), -2 + 0.004 * (u - 255.5)


def gain_and_valid(pair, truth):
    field = evaluate_pair(*pair, settings=PivSettings(uncertainty=False))
    inner = np.s_[2:-2, 2:-2]
    du, dv = (part[inner] for part in truth(*np.moveaxis(field.grid_px, -1, 0)))
    found = field.u_px[inner] * du + field.v_px[inner] * dv
    return found.sum() / (du**2 + dv**2).sum(), field.valid[inner].mean()


@pytest.mark.parametrize(("length_px", "least"), [(48, 0.45), slow(64, 0.70), slow(96, 0.92), slow(128, 0.97)])
def test_crests_of_short_waves_are_kept(particle_pair, length_px, least):
    truth = wave(length_px)
    gain, valid = gain_and_valid(particle_pair(truth, seed=3, ppp=0.05), truth)
    assert gain >= least
    assert valid >= 0.99


@pytest.mark.slow
def test_strangers_have_few_vectors_and_are_called_strangers(particle_pair):
    field = evaluate_pair(particle_pair(mix, seed=1)[0], particle_pair(mix, seed=2)[1])
    assert field.valid.mean() <= 0.2
    assert "one pair" in field.warning


@pytest.mark.parametrize("changes", [{"noise": 0.2}, {"loss": 0.4}, {"ppp": 0.005}])
def test_nothing_right_is_lost_in_hard_conditions(particle_pair, changes):
    field = evaluate_pair(*particle_pair(mix, seed=3, **changes))
    du, dv = mix(*np.moveaxis(field.grid_px, -1, 0))
    off_px = np.hypot(field.u_px - du, field.v_px - dv)
    assert field.valid.mean() >= 0.98
    assert np.mean(off_px[field.valid] > 1.0) <= 0.001


def test_what_is_acquitted_has_a_clear_peak_and_a_neighbourhood():
    vectors = np.zeros((5, 5, 2))
    vectors[2, 2] = 3.0, 0.0
    everywhere, suspects = np.ones((5, 5), bool), np.zeros((5, 5), bool)
    suspects[2, 2] = True
    ratio = np.full((5, 5), PROVEN + 0.1)
    assert is_supported_by_peak(vectors, everywhere, suspects, ratio, 32)[2, 2]
    assert not is_supported_by_peak(vectors, everywhere, suspects, ratio, 28)[2, 2]
    assert not is_supported_by_peak(vectors, everywhere, suspects, ratio - 0.2, 32).any()
    assert not is_supported_by_peak(vectors, everywhere, ~everywhere, ratio, 32).any()


@pytest.mark.parametrize(("row", "column"), [(0, 1), (1, 0), (1, 1), (1, -1)])
def test_three_in_a_row_acquit_each_other_and_two_do_not(row, column):
    """Against a fluid at rest on both sides, which every median is made of."""
    vectors = np.zeros((7, 7, 2))
    places = [(3 + k * row, 3 + k * column) for k in (-1, 0, 1)]
    suspects, everywhere = np.zeros((7, 7), bool), np.ones((7, 7), bool)
    for place, speed in zip(places, (12.0, 11.0, 9.0), strict=True):
        vectors[place], suspects[place] = (speed, 0.0), True
    ratio = np.where(suspects, WEAK + 0.1, np.nan)
    assert (is_supported_by_peak(vectors, everywhere, suspects, ratio, 32) == suspects).all()
    weak = ratio.copy()
    weak[places[0]] = WEAK - 0.1
    assert not is_supported_by_peak(vectors, everywhere, suspects, weak, 32).any()
    apart = vectors.copy()
    apart[places[2]] = 4.0, 0.0
    assert not is_supported_by_peak(apart, everywhere, suspects, ratio, 32).any()


def test_nothing_is_measured_without_a_peak_and_without_a_sigma():
    ratio = np.array([WEAK - 0.1, WEAK - 0.1, WEAK + 0.1])
    sigma = np.array([[np.nan, 0.1], [0.1, 0.1], [np.nan, np.nan]])
    assert is_low_confidence(ratio, sigma).tolist() == [True, False, False]


def test_a_match_is_chance_until_it_exceeds_what_so_many_pieces_reach():
    match = np.array([[0.2, 0.4, 0.4, -0.9]])
    assert is_chance_match(match, np.array([[50.0, 50.0, 16.0, 400.0]])).tolist() == [[True, False, True, True]]
