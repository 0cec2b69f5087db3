"""Derivatives of fields that are seen aslant, against turbulence in space whose third component is known.

A ball stands before the middle of the plane: rays are bent towards its axis behind it, and jump at its rim.
"""

import numpy as np
import pytest

from piv.statistics.derived import Axis, PlaneField, divergence, rates, rim_steps
from piv.statistics.out_of_plane import OutOfPlane, SlantedField

SIDE, WINDOWS, NOISE = 60, 2.0, 0.02  # vectors; in the side of a window; px
STEP = 0.5  # mm between vectors
PLACE = STEP * (np.arange(SIDE) - 0.5 * (SIDE - 1))
X, Y = np.meshgrid(PLACE, PLACE)
R = np.hypot(X, Y)
RIM = 9.0
INSIDE, OUTSIDE = R < RIM - 0.4, R > RIM + 0.4
NAMES = ("vorticity", "divergence", "shear", "swirling_strength")
PARTS = {"behind": R < RIM - 2 * STEP, "rim": np.abs(R - RIM) < STEP, "beside": R > RIM + 2 * STEP}


def turbulence(seed):
    """Components (SIDE, SIDE, 3) on z = 0 of waves in space of 2 to 6 windows, none of which diverges."""
    rng = np.random.default_rng(seed)
    out = np.zeros((SIDE, SIDE, 3))
    for _ in range(80):
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        across = np.cross(way, rng.normal(size=3))
        across /= np.linalg.norm(across)
        turn = 2.0 * np.pi / (rng.uniform(2.0, 6.0) * WINDOWS * STEP) * (way[0] * X + way[1] * Y)
        out += np.cos(turn + rng.uniform(0.0, 2.0 * np.pi))[..., None] * across
    return out * 0.5 / out.std()


def slopes():
    """Of rays: those of the lens beside the ball, bent towards its axis behind it."""
    return np.stack((X, Y), axis=-1) * np.where(R < RIM, -0.06, 0.003)[..., None]


def seen_aslant(flow, rng, known):
    """The field that is measured, and the true one, on the same places."""
    slope = slopes()
    noise = np.full((SIDE, SIDE, 2), NOISE)
    uv = flow[..., :2] - slope * flow[..., 2:] + rng.normal(0.0, NOISE, noise.shape)
    seen = SlantedField(uv, noise, slope, WINDOWS)
    measured = PlaneField(PLACE, PLACE, uv, noise, 0.0, seen.through_sheet(known.of_pair(seen, 1.0)))
    return measured, PlaneField(PLACE, PLACE, flow[..., :2], noise, 0.0)


@pytest.mark.parametrize("known", [OutOfPlane(), OutOfPlane(0.5)], ids=["assumed", "told"])
def test_sigma_of_rates_covers_the_flow_behind_glass_and_across_its_rim(known):
    rng, inside = np.random.default_rng(1), {}
    for seed in range(12):
        found, true = (rates(each) for each in seen_aslant(turbulence(seed), rng, known))
        for name in NAMES:
            covered = np.abs(found[name][0] - true[name][0]) < found[name][1]
            for part, where in PARTS.items():
                inside.setdefault((name, part), []).append(covered[where & np.isfinite(found[name][1])].mean())
    shares = {each: float(np.mean(values)) for each, values in inside.items()}
    assert all(0.6 < share < 0.78 for (name, _), share in shares.items() if name != "swirling_strength"), shares
    assert all(share > 0.6 for share in shares.values()), shares


def test_without_the_slopes_hardly_a_rate_behind_glass_is_covered():
    """What these sigmas would be worth by noise alone: the case above can fail."""
    rng, inside = np.random.default_rng(1), []
    for seed in range(4):
        measured, true = seen_aslant(turbulence(seed), rng, OutOfPlane())
        blind = PlaneField(PLACE, PLACE, measured.uv, measured.sigma, 0.0)
        (found, sigma), (value, _) = rates(blind)["divergence"], rates(true)["divergence"]
        inside.append((np.abs(found - value) < sigma)[PARTS["rim"]].mean())
    assert np.mean(inside) < 0.25


@pytest.mark.slow
def test_what_flows_through_the_sheet_is_no_step_that_speaks_against_the_map():
    """A steady w of one size in each of many flows is seen as a jump at the rim, within its sigma."""
    rng, steps = np.random.default_rng(3), []
    slope, sigma = slopes(), np.full((SIDE, SIDE, 2), 0.01)
    for _ in range(30):
        uv = rng.normal(0.0, 0.01, sigma.shape) - slope * rng.normal(0.0, 0.3)
        uv[~INSIDE & ~OUTSIDE] = np.nan
        through = SlantedField(uv, sigma, slope, WINDOWS).through_sheet(np.full((SIDE, SIDE), 0.3))
        steps.append(rim_steps(PlaneField(PLACE, PLACE, uv, sigma, 0.0, through), OUTSIDE, INSIDE, (0, 0), 4.0))
    ratio = np.array([each.step / each.sigma for each in steps])
    assert 0.8 < np.sqrt(np.mean(ratio**2)) < 1.25


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_round_flow_about_its_axis_is_covered_too(angle):
    rng, inside = np.random.default_rng(2), []
    for seed in range(8):
        measured, true = seen_aslant(turbulence(seed), rng, OutOfPlane(0.5))
        (found, sigma), (value, _) = (divergence(each, Axis((0.3, -0.2), angle)) for each in (measured, true))
        inside.append((np.abs(found - value) < sigma)[PARTS["behind"] & np.isfinite(sigma)].mean())
    assert 0.6 < np.mean(inside) < 0.8
