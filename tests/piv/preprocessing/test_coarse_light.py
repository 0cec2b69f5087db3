"""Coarse light that moves otherwise than the particles, and pixels of unequal gain, make no wrong vectors."""

import numpy as np
import pytest

from piv.correlation.pair import evaluate_pair
from piv.preprocessing.coarse_light import coarse_light, without_coarse_light
from piv.preprocessing.colour_mosaic import without_mosaic
from tests.piv.conftest import draw

SIDE, MARGIN = 256, 20


def rotation(u, v):
    return -0.03 * (v - 128.0), 0.03 * (u - 128.0)


def frames_of(seed, diameter_px=3.0, count=3000, more=None):
    """Frames A and B (float64) of a rotation, and what `more(x, y, sign)` adds to each."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-MARGIN, SIDE + MARGIN, (2, count))
    bright = rng.uniform(300.0, 1200.0, count)
    shift = np.stack(rotation(*place))
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    frames = []
    for sign in (-0.5, 0.5):
        frame = draw((SIDE, SIDE), *(place + sign * shift), diameter_px, bright) + rng.normal(100.0, 8.0, x.shape)
        frames.append(frame if more is None else frame + more(x, y, sign))
    return frames


def hexagons(seed, count=60, shift=(3.0, -2.5)):
    """Images of an aperture with six blades, out of focus, that all move by `shift`."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, SIDE, (count, 2))
    radii, bright = rng.uniform(5.0, 9.0, count), rng.uniform(400.0, 1600.0, count)
    turned = np.pi / 3 * np.arange(3)

    def add(x, y, sign):
        total = np.zeros(x.shape)
        for (u, v), radius, level in zip(places, radii, bright, strict=True):
            dx, dy = x - u - sign * shift[0], y - v - sign * shift[1]
            away = np.max([np.abs(np.cos(t) * dx + np.sin(t) * dy) for t in turned], axis=0)
            total += level / (1.0 + np.exp(2.0 * (away - radius)))
        return total

    return add


def scratches(x, y, sign):
    """Bright scratches on a window that moves by (2.4, 1.2) px, as the camera shakes."""
    x, y = x - 2.4 * sign, y - 1.2 * sign
    places = (0.3, 40), (1.9, -60), (2.8, 5)
    lines = [np.abs(np.cos(t) * (x - 128) + np.sin(t) * (y - 128) - p) for t, p in places]
    return 1500.0 / (1.0 + np.exp(3.0 * (np.min(lines, axis=0) - 3.0)))


@pytest.mark.parametrize(
    ("more", "wrong_share"), [(hexagons(1), 0.01), (scratches, 0.01)], ids=["out of focus", "scratches"]
)
def test_coarse_light_that_moves_otherwise_makes_no_wrong_vectors(more, wrong_share):
    a, b = frames_of(5, more=more)
    field = evaluate_pair(a, b, threads=1)
    u, v = rotation(*np.meshgrid(field.x_px, field.y_px))
    off = np.hypot(field.u_px - u, field.v_px - v)
    assert field.valid.mean() > 0.9
    assert (off[field.valid] > 1.0).mean() < wrong_share


@pytest.mark.parametrize(("diameter_px", "count"), [(1.5, 4000), (3.0, 700), (4.0, 4000), (8.0, 2500)])
def test_frames_of_particles_alone_have_no_coarse_light(diameter_px, count):
    a, b = (np.asarray(part - part.mean(), np.float32) for part in frames_of(7, diameter_px, count))
    found = coarse_light(a, b, 32)
    assert found is None or (found > 0.5).mean() < 0.01


def test_particles_beside_an_edge_keep_their_light():
    """A median follows the edge: what is left at the places of particles is as bright as without the body."""
    plain, _ = frames_of(9, 2.5, 800)
    wall, _ = frames_of(9, 2.5, 800, lambda x, y, sign: 4000.0 * (x > 128.5))
    whole = np.ones((SIDE, SIDE), np.float32)
    fine = [without_coarse_light(np.asarray(part, np.float32), whole, 32)[0] for part in (plain, wall)]
    beside = fine[0][:, 121:137], fine[1][:, 121:137]
    assert np.corrcoef(beside[0].ravel(), beside[1].ravel())[0, 1] > 0.85


def test_pixels_of_unequal_gain_leave_no_pattern():
    a, b = frames_of(11)
    for frame in (a, b):
        for number, gain in enumerate((0.35, 1.0, 1.0, 0.5)):
            part = frame[number // 2 :: 2, number % 2 :: 2]
            part[:] = gain * part
    a, b = (np.rint(frame).astype(np.uint16) for frame in (a, b))
    field = evaluate_pair(a, b, threads=1)
    u, v = rotation(*np.meshgrid(field.x_px, field.y_px))
    assert field.valid.mean() > 0.97
    assert np.sqrt(np.mean(np.hypot(field.u_px - u, field.v_px - v)[field.valid] ** 2)) < 0.06


def test_frames_of_equal_gain_stay_as_they_are():
    frames = frames_of(13, 1.2, 60)
    found = without_mosaic(frames, np.ones((SIDE, SIDE), bool))
    assert all(one is other for one, other in zip(frames, found, strict=True))
