"""Prescribed fields: no divergence, momentum kept, stresses and memory as promised."""

import numpy as np
import pytest

from sim.flow.fields import Flow, LaminarChannel, Shear, TurbulentChannel, Uniform, Vortex, cholesky_of
from sim.flow.jet import Jet
from sim.flow.modes import RandomModes
from sim.flow.particles import LightSheet
from tests.sim.flow.windows_of_flow import mean_covariance, window_mean, window_places, window_stresses
from tracer.errors import SceneError

STRESSES = (900.0, 400.0, 225.0, -300.0, 60.0, 20.0)
BASES = [
    Uniform((10.0, 20.0, 3.0), STRESSES),
    Shear((0.0, 100.0, 0.0)),
    Vortex(),
    Jet(),
    LaminarChannel(),
    TurbulentChannel(),
]


def points(count=3000, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack(
        (rng.uniform(-60.0, 60.0, count), rng.uniform(-80.0, 80.0, count), rng.uniform(-3.0, 3.0, count))
    )


def gradient(function, at, step=0.01):
    """du_i/dx_j (N, 3, 3) by central differences."""
    columns = []
    for axis in range(3):
        off = np.zeros(3)
        off[axis] = step
        columns.append((function(at + off) - function(at - off)) / (2.0 * step))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("base", BASES, ids=lambda base: type(base).__name__)
def test_mean_flows_have_no_divergence(base):
    slopes = gradient(base.mean, points())
    divergence = np.trace(slopes, axis1=1, axis2=2)
    assert np.abs(divergence).max() <= 2e-4 * np.abs(slopes).max() + 1e-9


def test_a_jet_keeps_its_momentum_spreads_and_decays_as_jets_do():
    jet = Jet(exit_mm=(0.0, 0.0, 0.0), reach_mm=400.0)
    r = np.linspace(0.0, 120.0, 6001)
    widths, speeds = [], []
    for s in (2.0, 50.0, 150.0, 300.0):
        at = np.column_stack((r, np.full_like(r, s), np.zeros_like(r)))
        u = jet.mean(at)[:, 1]
        momentum = 2.0 * np.trapezoid(u * u * r, r)
        assert momentum == pytest.approx(jet.exit_mm_s**2 * 2.5**2, rel=3e-3)
        widths.append(np.interp(-0.5 * u[0], -u, r))
        speeds.append(u[0])
    assert speeds[0] == pytest.approx(jet.exit_mm_s, rel=1e-3)  # potential core
    assert widths[3] / 300.0 == pytest.approx(0.094, rel=0.02)
    assert speeds[2] / speeds[3] == pytest.approx(2.0, rel=0.01)
    assert speeds[3] / jet.exit_mm_s == pytest.approx(6.2 * 5.0 / 300.0, rel=0.05)
    side = np.array([[30.0, 150.0, 0.0], [0.0, 150.0, -30.0]])
    assert jet.mean(side)[0, 0] < 0.0 < jet.mean(side)[1, 2]  # gas is drawn in


def test_a_jet_turned_about_its_axis_is_the_same():
    flow = Flow(Jet(), RandomModes(8.0))
    at = points(200)
    turned = at[:, [2, 1, 0]] * (1.0, 1.0, -1.0)
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(flow.mean(turned), flow.mean(at) @ turn.T, atol=1e-9)
    np.testing.assert_allclose(flow.stresses(turned), turn @ flow.stresses(at) @ turn.T, atol=1e-6)


def test_stresses_of_a_jet_carry_momentum_outwards_and_vanish_on_the_axis():
    flow = Flow(Jet(), RandomModes(8.0))
    at = np.array([[0.0, 0.0, 0.0], [7.0, 0.0, 0.0], [-7.0, 0.0, 0.0]])
    on, right, left = flow.stresses(at)
    assert on[0, 1] == pytest.approx(0.0, abs=1e-9)
    assert right[0, 1] > 0.2 * np.sqrt(right[0, 0] * right[1, 1])
    assert left[0, 1] == pytest.approx(-right[0, 1])
    assert on[0, 0] == pytest.approx(on[2, 2])


@pytest.mark.slow
def test_a_fluctuation_of_a_jet_crosses_its_axis_without_a_step():
    flow = Flow(Jet(), RandomModes(8.0))
    around = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    for s in (-80.0, 0.0, 60.0):
        near = np.column_stack((1e-3 * np.cos(around), np.full(12, s), 1e-3 * np.sin(around)))
        velocity = flow.velocity(near, 0.3)
        deviation = np.sqrt(np.diagonal(flow.stresses(near), axis1=1, axis2=2)).mean()
        assert np.ptp(velocity, axis=0).max() < 0.02 * deviation


def test_modes_are_free_of_divergence_and_repeat_their_promises():
    modes = RandomModes(6.0, memory_s=0.02, seed=4)
    at = points(300)
    slopes = gradient(lambda where: modes.at(where, 0.3), at, 1e-3)
    assert np.abs(np.trace(slopes, axis1=1, axis2=2)).max() < 1e-6 * np.abs(slopes).max()
    np.testing.assert_allclose(modes.covariance(np.zeros(3)), np.eye(3), atol=1e-12)
    assert modes.autocorrelation(0.01) == pytest.approx(np.exp(-0.125), abs=0.05)
    assert modes.autocorrelation(0.1) == pytest.approx(0.0, abs=0.25)
    _, energy = modes.spectrum()
    assert energy.sum() == pytest.approx(1.5)


def test_covariances_are_those_of_samples():
    apart, lag_s = np.array([1.5, -0.5, 0.3]), 0.004
    sums, wanted = np.zeros((3, 3)), np.zeros((3, 3))
    at = points(2000, 1)
    for seed in range(40):  # places sample the phases, seeds the modes
        modes = RandomModes(6.0, seed=seed, longest_mm=20.0)
        sums += modes.at(at, 0.0).T @ modes.at(at + apart, lag_s) / len(at)
        wanted += modes.covariance(apart, lag_s)
    assert sums / 40 == pytest.approx(wanted / 40, abs=0.02)


def test_stresses_are_those_of_samples_in_time():
    flow = Flow(Uniform((5.0, 0.0, 0.0), STRESSES), RandomModes(5.0, seed=2))
    at = np.array([[1.0, 2.0, 0.0], [20.0, -3.0, 0.5]])
    found = np.array([flow.velocity(at, 0.1 * k) for k in range(4000)])
    mean, wanted = found.mean(axis=0), flow.stresses(at)
    off = found - mean
    stresses = np.einsum("tni,tnj->nij", off, off) / len(found)
    np.testing.assert_allclose(mean, flow.mean(at), atol=2.0)
    np.testing.assert_allclose(stresses, wanted, atol=60.0)
    np.testing.assert_allclose(wanted[0], [[900.0, -300.0, 60.0], [-300.0, 400.0, 20.0], [60.0, 20.0, 225.0]])


def test_a_window_sees_the_covariance_of_its_own_average():
    modes = RandomModes(4.0, seed=3)
    rng = np.random.default_rng(0)
    offsets = rng.uniform(-2.0, 2.0, (40, 3))
    weights = np.full(40, 1.0 / 40)
    seen = mean_covariance(modes, offsets, weights, np.broadcast_to(np.eye(3), (1, 40, 3, 3)))[0]
    double = np.einsum("s,t,stij->ij", weights, weights, modes.covariance(offsets[None] - offsets[:, None]))
    np.testing.assert_allclose(seen, double, atol=1e-12)
    assert np.trace(seen) < 2.5


def test_walls_hold_the_turbulent_channel_and_its_shear_stress_is_that_of_its_mean():
    channel = TurbulentChannel()
    x = np.linspace(-19.99, 19.99, 2001)
    at = np.column_stack((x, np.zeros_like(x), np.zeros_like(x)))
    stress = Flow(channel, RandomModes(5.0)).stresses(at)[:, 0, 1]
    slope = gradient(channel.mean, at, 1e-4)[:, 1, 0]
    total = channel.friction_mm_s**2 * x / channel.half_width_mm
    wanted = total + channel.viscosity_mm2_s * slope
    inside = (np.abs(x) > 2.0) & (np.abs(x) < 19.5)
    np.testing.assert_allclose(stress[inside], wanted[inside], atol=0.005 * channel.friction_mm_s**2)
    beyond = np.array([[20.5, 0.0, 0.0]])
    assert not channel.holds(beyond)[0]
    assert channel.mean(beyond)[0, 1] == 0.0
    assert not channel.amplitude(beyond).any()


def test_a_vortex_is_fastest_at_its_core_s_edge():
    vortex = Vortex(core_mm=8.0, fastest_mm_s=300.0)
    r = np.linspace(0.0, 30.0, 3001)
    speed = vortex.mean(np.column_stack((r, np.zeros_like(r), np.zeros_like(r))))[:, 1]
    assert r[np.argmax(speed)] == pytest.approx(8.0, abs=0.02)
    assert speed.max() == pytest.approx(300.0, rel=1e-6)
    assert speed[0] == 0.0


def test_what_cannot_be_is_refused():
    with pytest.raises(SceneError, match="beyond 1"):
        cholesky_of((1.0, 1.0, 1.0, 1.5, 0.0, 0.0))
    with pytest.raises(SceneError, match="correlated with another"):
        cholesky_of((0.0, 1.0, 1.0, 0.5, 0.0, 0.0))
    with pytest.raises(SceneError, match="not made on the way"):
        Shear(gradient_per_s=((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    with pytest.raises(SceneError, match="shortest wave"):
        RandomModes(1.0, shortest_mm=20.0)


# Averages over windows against sums and samples.


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
