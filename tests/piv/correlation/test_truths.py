"""What judges the evaluator is what it says it is: flows that a light sheet could hold, of the spectrum told."""

import numpy as np
import pytest

from benchmarks.piv_sigma import FIRST_SEED, SIDE, Errors, flows_of
from tests.piv.correlation import flows

PLACE = np.mgrid[40.0 : SIDE - 40.0 : 9.0, 40.0 : SIDE - 40.0 : 9.0]


@pytest.mark.parametrize("which", FIRST_SEED)
def test_flows_are_free_of_divergence_and_of_a_pixel_and_more(which):
    v, u = PLACE
    for name, of_seed in flows_of(which).items():
        flow, apart = of_seed(3), 1e-4
        sides = [flow(u + apart, v)[0] - flow(u - apart, v)[0], flow(u, v + apart)[1] - flow(u, v - apart)[1]]
        if not name.startswith("step"):
            assert np.abs(sum(sides)).max() < 1e-6 * apart, name
        assert 0.5 < np.sqrt(np.mean(np.square(flow(u, v)))) < 6.0, name


def test_what_judges_was_not_chosen_by():
    chosen, judging = flows_of("choose"), flows_of("judge")
    v, u = PLACE
    fields = [
        np.stack(np.broadcast_arrays(*of_seed(3)(u, v))) for of_seed in (*chosen.values(), *judging.values())
    ]
    for number, one in enumerate(fields):
        assert not any(np.allclose(one, other, atol=0.05) for other in fields[:number])


@pytest.mark.parametrize("slope", [-5 / 3, -2.5])
def test_energy_falls_with_the_wave_number_as_told(slope):
    """Mean square of gradients over that of the field is the integral of k^2 E over that of E."""
    u, v = np.random.default_rng(1).uniform(0.0, 4000.0, (2, 200))
    least, most, apart = 2 * np.pi / 300.0, 2 * np.pi / 60.0, 1e-3
    square, bent = 0.0, 0.0
    for seed in range(12):
        field = flows.turbulence(seed, 1.0, 300.0, 60.0, 300, slope=slope)
        here, right, down = (np.stack(field(u + x, v + y)) for x, y in ((0, 0), (apart, 0), (0, apart)))
        square += np.square(here).mean()
        bent += (np.square(right - here) + np.square(down - here)).mean() / apart**2

    def integral(power):
        return (most ** (power + 1) - least ** (power + 1)) / (power + 1)

    assert bent / square == pytest.approx(integral(slope + 2) / integral(slope), rel=0.15)


def test_figures_of_errors_as_large_as_their_sigma_and_of_some_that_are_not():
    rng = np.random.default_rng(2)
    sigma = rng.uniform(0.01, 0.05, (20000, 2))
    errors = Errors(sigma * rng.normal(size=sigma.shape), sigma, np.ones(len(sigma), bool), 0.0)
    figures = errors.figures()
    assert figures["over_sigma"] == pytest.approx(1.0, abs=0.02)
    assert figures["within"] == pytest.approx(0.683, abs=0.01)
    assert figures["wrong"] == figures["far"] == 0.0
    errors.off[:100] = 0.5
    errors.off[100:300] = np.nan
    figures = errors.figures()
    assert figures["far"] == pytest.approx(0.005)
    assert figures["wrong"] == pytest.approx(0.01)
