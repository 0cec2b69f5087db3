"""What judges the evaluator is what it says it is: flows that a light sheet could hold, of the spectrum told."""

import numpy as np
import pytest

from tests.piv.correlation import flows


def test_flows_are_free_of_divergence_and_of_a_pixel_and_more():
    (v, u), apart = np.mgrid[40.0:344.0:9.0, 40.0:344.0:9.0], 1e-4
    for flow in (flows.turbulence(3), flows.endless(3, 1.3), flows.vortices(3)):
        sides = [flow(u + apart, v)[0] - flow(u - apart, v)[0], flow(u, v + apart)[1] - flow(u, v - apart)[1]]
        assert np.abs(sum(sides)).max() < 1e-6 * apart
        assert 0.5 < np.sqrt(np.mean(np.square(flow(u, v)))) < 6.0


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
