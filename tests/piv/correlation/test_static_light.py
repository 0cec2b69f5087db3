"""Static light behind a slow flow: how much it shortens vectors is measured, and they are right without it."""

import cv2
import numpy as np
import pytest

from piv.correlation.pair import evaluate_pair
from tests.piv.lab_kinds import flow_of, light_of_particles, sensor, texture
from tests.slow_cases import slow

SIDE = 256


def slow_pair(seed, name, speed_px=1.6, strength=0.0, grain_px=2.5, lines=False, image=None):
    """Frames A and B of a flow before static light of some times its deviation, and the flow."""
    rng = np.random.default_rng([seed, *name.encode()])
    flow = flow_of(name, rng, SIDE, speed_px)
    lights = light_of_particles(rng, flow, SIDE, spread_px=0.9, density=0.04, peak=90.0, through=0.1)
    if image is not None:
        lights = np.stack([image(light) for light in lights])
    if strength:
        still = texture(rng, SIDE, grain_px)
        if lines:
            still = np.broadcast_to(cv2.GaussianBlur(rng.normal(size=(1, SIDE)), (0, 0), grain_px), still.shape)
            still = (still - still.min()) / still.std()
        lights = lights + strength * lights.std() * still
    return *sensor(rng, lights), flow


def errors(field, flow):
    """Errors (n,) of valid vectors, over their total sigma too, and the share of valid ones."""
    x, y = np.meshgrid(field.x_px, field.y_px)
    off = np.stack((field.u_px, field.v_px), -1) - np.stack(flow(x, y), -1)
    over = np.abs(off / field.total_sigma_px).max(axis=-1)
    return np.linalg.norm(off, axis=-1)[field.valid], over[field.valid], field.valid_share


@pytest.mark.parametrize(
    ("name", "strength", "lines", "before_px"),
    [
        ("uniform", 1.5, False, 0.577),
        slow("shear", 1.5, False, 0.341),
        ("uniform", 2.5, True, 0.551),
        slow("vortex", 2.0, True, 0.389),
    ],
)
def test_slow_flows_before_a_coarse_texture_or_lines_are_right(name, strength, lines, before_px):
    """`before_px`: rms of the errors of these frames before static light was measured."""
    a, b, flow = slow_pair(31, name, strength=strength, lines=lines)
    field = evaluate_pair(a, b, threads=1)
    off, over, valid = errors(field, flow)
    assert valid > 0.8
    assert np.sqrt(np.square(off).mean()) < 0.4 * before_px
    assert ((off > 0.3) & (over > 5.0)).mean() < 0.002
    assert field.static_share > 0.03


def long_images(light):
    """Particle images that are 1.6 times as long as wide."""
    return 1.7 * cv2.GaussianBlur(light, (0, 0), sigmaX=1.1, sigmaY=0.01)


@pytest.mark.parametrize(
    ("name", "image"),
    [
        slow("uniform", None),
        ("shear", None),
        slow("vortex", None),
        slow("turbulence", None),
        ("uniform", long_images),
    ],
)
def test_flows_before_nothing_are_not_stretched(name, image):
    for seed in (1, 2, 3):
        a, b, _ = slow_pair(seed, name, image=image)
        assert evaluate_pair(a, b, threads=1).stretch == 1.0


def narrow_jet(rng, side):
    """A jet of half a window beside a fluid at rest, which its fluctuations move to and fro."""
    k, phase = rng.normal(size=(16, 2)) * 2.0 * np.pi / 60.0, rng.uniform(0.0, 6.3, 16)
    height = 0.15 * rng.normal(size=16)

    def flow(x, y):
        core = np.exp(-(((x - side / 2) / 22.0) ** 2))
        along = (height * np.cos(x[..., None] * k[:, 0] + y[..., None] * k[:, 1] + phase)).sum(-1)
        across = (height * np.sin(x[..., None] * k[:, 1] - y[..., None] * k[:, 0] + phase)).sum(-1)
        return 2.0 * core * across, core * (4.0 + 5.0 * along)

    return flow


@pytest.mark.parametrize("seed", [0, slow(4), slow(9)])
def test_a_narrow_jet_beside_a_fluid_at_rest_hides_nothing(seed):
    """Its blocks hold two motions, and longer displacements than their middle: the pair was refused."""
    rng, side = np.random.default_rng([seed, 7]), 512
    flow = narrow_jet(rng, side)
    lights = light_of_particles(rng, flow, side, spread_px=0.9, density=0.03, peak=90.0, through=0.1)
    field = evaluate_pair(*sensor(rng, lights), threads=1)
    assert field.stretch == 1.0
    assert field.valid_share > 0.95
