"""Averages over windows against sums and samples."""

import numpy as np
import pytest

from sim.flow.fields import Flow, Shear, Vortex
from sim.flow.jet import Jet
from sim.flow.modes import RandomModes
from sim.flow.particles import LightSheet
from tests.sim.flow.windows_of_flow import window_mean, window_places, window_stresses

SHEET = LightSheet()


def test_places_have_the_window_s_moments():
    places, weights = window_places(3.0, SHEET)
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ places == pytest.approx(np.zeros(3), abs=1e-12)
    second = np.einsum("s,si,sj->ij", weights, places, places)
    # A box of 3 mm, and the product of two Gaussian sheets: sigma^2 = w^2 / 32.
    assert np.diag(second) == pytest.approx([9.0 / 12, 9.0 / 12, 1.0 / 32], rel=0.02)


def test_a_linear_flow_is_its_own_average_and_a_vortex_is_not():
    places, weights = window_places(4.0, SHEET)
    at = np.array([[1.0, 2.0, 0.0], [0.0, 6.0, 0.0]])
    shear = Flow(Shear((3.0, 0.0, 0.0)))
    np.testing.assert_allclose(window_mean(shear, at, places, weights), shear.mean(at), atol=1e-9)
    vortex = Flow(Vortex(core_mm=5.0, about_mm=(0.0, 0.0, 0.0)))
    assert window_mean(vortex, at, places, weights)[1, 0] > vortex.mean(at)[1, 0]  # less than its fastest, -x


def test_stresses_of_windows_are_those_of_sampled_averages():
    flow = Flow(Jet(), RandomModes(3.0, seed=1))
    places, weights = window_places(4.0, SHEET)
    at = np.array([[6.0, 20.0, 0.0]])
    samples = np.array(
        [weights @ (flow.velocity(at + places, 0.1 * k) - flow.mean(at + places)) for k in range(1500)]
    )
    wanted = window_stresses(flow, at, places, weights)[0]
    found = samples.T @ samples / len(samples)
    point = flow.stresses(at)[0]
    assert found == pytest.approx(wanted, abs=0.1 * np.trace(wanted) / 3.0)
    assert 0.3 < np.trace(wanted) / np.trace(point) < 0.8
    assert not window_stresses(Flow(Jet()), at, places, weights).any()
