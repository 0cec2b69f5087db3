"""Still light that outshines a slow flow: its vectors are not valid; those of slow flows alone are."""

import numpy as np
import pytest
import scipy

from piv.correlation.pair import evaluate_pair
from piv.preprocessing.hot_pixels import hot_pixels
from tests.piv.lab_kinds import FLOWS, Counts, judge, light_of_particles, scene, sensor, squeezed
from tests.slow_cases import slow, slow_but

STILL = "still, points", "still, coarse"


@pytest.mark.parametrize(
    ("kind", "name", "seed"),
    [
        ("still, fine", "shear", 4100),
        ("still, points", "vortex", 4101),
        ("still, fine", "jet", 58002),
        slow("still, coarse", "uniform", 4100),
        slow("still, points", "turbulence", 4101),
    ],
)
def test_a_flow_that_still_light_outshines_has_no_silent_vector(kind, name, seed):
    """54 to 100 % of its vectors were beyond 5 sigma and 0.3 px, nearly all without a warning."""
    found = judge(kind, name, seed)
    assert (found.wrong, found.silent) == (0, 0)
    assert found.warned


@pytest.mark.parametrize(("name", "seed"), [("shear", 4200), ("jet", 57101), slow("vortex", 57101)])
def test_hot_pixels_are_left_out(name, seed):
    """Up to 92 % of the vectors were silent, between rest and the flow."""
    found = judge("still, hot", name, seed)
    assert (found.wrong, found.silent, found.warned) == (0, 0, 0)
    assert found.valid > 0.98 * found.asked


@pytest.mark.parametrize("spread_px", [0.3, 0.5])
@pytest.mark.parametrize("speed_px", [0.0, 0.3])
def test_particle_images_as_small_as_a_pixel_are_no_hot_pixels(spread_px, speed_px):
    rng = np.random.default_rng(57)
    lights = light_of_particles(rng, lambda x, y: (speed_px + 0 * x, 0 * y), 96, spread_px, 0.04)
    assert hot_pixels(*sensor(rng, lights), np.ones((96, 96), bool)) is None


def test_a_flow_that_seems_to_rest_is_said_to_look_like_still_light():
    """Vectors were zero and sure before a texture that outshines turbulence, without a word."""
    field = evaluate_pair(*scene("still, fine", "turbulence", 57101)[:2], threads=1)
    assert np.median(np.hypot(field.u_px, field.v_px)[field.valid]) < 0.1
    assert "--prepare sliding-minimum" in field.warning


def test_fluids_at_rest_stay_valid_behind_noise_of_compression():
    for seed, through, quality in ((40, 0.0, 40), (41, 0.2, 60), (44, 0.0, 70)):
        rng = np.random.default_rng(seed)
        frames = sensor(rng, light_of_particles(rng, lambda x, y: (0.0 * x, 0.0 * y), 224, through=through))
        assert evaluate_pair(*squeezed(frames, quality), threads=1).valid_share > 0.95


@pytest.mark.parametrize("kind", slow_but(STILL))
def test_of_all_still_light_hardly_a_pair_is_silent(kind):
    """46 to 70 % of the valid vectors were; flows that change within a window are still missed."""
    pairs = [judge(kind, name, seed) for name in FLOWS for seed in range(4400, 4404)]
    assert sum(one.silent > 0.01 * one.asked for one in pairs) <= 4
    assert sum(one.wrong > 0.03 * one.asked for one in pairs) <= 4


def test_a_fluid_at_rest_that_loses_particles_is_not_still_light():
    rng = np.random.default_rng(573)
    frames = sensor(rng, light_of_particles(rng, lambda x, y: (0 * x, 0 * y), 224, through=0.3))
    field = evaluate_pair(*frames, threads=1)
    assert field.valid_share > 0.9
    assert field.stretch < 1.05


def test_slow_flows_alone_stay_valid():
    total = Counts(*np.sum([judge("clean", name, 4300) for name in FLOWS], axis=0))
    assert total.warned == 0
    assert total.valid > 0.95 * total.asked


def errors_by_mask(kind, name, seed, lacking_px=0):
    """Squared errors of vectors up to 24 px off a body that are valid without its mask and with it: of both.

    The mask is smaller than the body by `lacking_px`. And how many are valid near it, without and with the mask.
    """
    a, b, flow, solid = scene(kind, name, seed)
    mask = (
        scipy.ndimage.binary_erosion(solid, np.ones((3, 3)), lacking_px, border_value=1) if lacking_px else solid
    )
    fields = [evaluate_pair(a, b, valid, threads=1) for valid in (None, ~mask)]
    x, y = np.meshgrid(fields[0].x_px, fields[0].y_px)
    away = scipy.ndimage.distance_transform_edt(~solid)[np.rint(y).astype(int), np.rint(x).astype(int)]
    near = (away > 0.0) & (away < 24.0)
    both = near & fields[0].valid & fields[1].valid
    off = [np.stack((field.u_px, field.v_px)) - np.stack(flow(x, y)) for field in fields]
    return [np.square(part).sum(axis=0)[both] for part in off], [(field.valid & near).sum() for field in fields]


@pytest.mark.parametrize(("name", "seed"), [("vortex", 5400), ("jet", 5301), slow("shear", 5401)])
def test_a_mask_that_is_too_small_for_a_dark_area_makes_nothing_worse(name, seed):
    """The step from dark to the flow was left in windows: errors were 1.2 to 2.7 times as large."""
    (without, given), valid = errors_by_mask("dark area", name, seed, lacking_px=2)
    assert given.sum() < 1.1 * without.sum()
    assert valid[1] >= valid[0]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["body", "dark area"])
def test_a_mask_makes_nothing_worse(kind):
    for name in FLOWS:
        found = [errors_by_mask(kind, name, seed) for seed in range(5200, 5204)]
        ratios = [given.mean() / without.mean() for (without, given), _ in found]
        assert np.log(ratios).mean() < 0.0
        assert np.sum([valid[1] - valid[0] for _, valid in found]) > 0
