"""Single particles: their places and sigma, and where they know more than windows."""

import numpy as np
import pytest

from piv.correlation.settings import PivSettings
from piv.errors import PairError
from piv.tracking.particles import find_particles
from piv.tracking.tracks import Tracks, local_plane, match, track_particles
from tests.piv.conftest import draw
from tests.piv.correlation.flows import rms, vortex
from tests.piv.fixed_windows import evaluate_pair


def tracks_of(a, b):
    """Tracks of a pair, guided by windows twice as large as usual."""
    guide = evaluate_pair(a, b, None, PivSettings(windows_px=(128, 64, 64, 64)))
    return track_particles(find_particles(a), find_particles(b), guide)


def off_of(tracks, truth):
    return tracks.shift_px - np.stack(truth(*tracks.place_px.T), axis=-1)


def test_places_of_lone_particles_and_their_sigma():
    rng = np.random.default_rng(1)
    u, v = (np.arange(20, 500, 20)[:, None] + rng.uniform(-3, 3, (24, 24)) for _ in range(2))
    v = v.T
    image = draw((520, 520), u.ravel(), v.ravel(), 3.0, np.full(u.size, 3000.0))
    frame = np.clip(image + 100 + rng.normal(0, 41, image.shape), 0, 4095)
    found = find_particles(frame)
    true = np.stack([u.ravel(), v.ravel()], -1)
    apart = found.place_px[:, None] - true[None]
    nearest = np.argmin(np.linalg.norm(apart, axis=-1), axis=1)
    off = found.place_px - true[nearest]
    assert len(found.height) == u.size
    assert rms(off) < 0.02
    assert 0.8 < rms(off) / rms(found.sigma_px) < 1.2


def test_images_that_overlap_and_those_at_a_mask_are_given_up():
    image = draw((64, 64), np.array([20.0, 21.8, 40.0]), np.array([20.0, 20.9, 40.0]), 3.0, np.full(3, 3000.0))
    image += np.random.default_rng(0).normal(0, 10, image.shape)
    found = find_particles(image)
    assert np.abs(found.place_px - (40.0, 40.0)).max() < 0.05
    assert len(found.place_px) == 1
    valid = np.ones(image.shape, bool)
    valid[:, 42:] = False
    assert len(find_particles(image, valid).place_px) == 0
    assert len(find_particles(image, np.zeros_like(valid)).place_px) == 0


def test_lost_particles_make_hardly_a_wrong_track(particle_pair):
    off = off_of(tracks_of(*particle_pair(vortex(), seed=8, ppp=0.001, loss=0.2)), vortex())
    assert np.mean(np.linalg.norm(off, axis=-1) > 0.2) < 0.02


def test_strangers_and_empty_frames_are_refused(particle_pair):
    empty = np.random.default_rng(0).normal(100, 5, (256, 256))
    with pytest.raises(PairError):
        tracks_of(empty, empty + np.random.default_rng(1).normal(0, 5, empty.shape))


def test_two_candidates_at_about_the_same_distance_are_no_track():
    places = np.array([[10.0, 10.0], [30.0, 30.0], [50.0, 10.0]])
    a = find_particles(draw((64, 64), *places.T, 3.0, np.full(3, 3000.0)))
    beside = np.array([[9.0, 10.0], [11.3, 10.0], [30.4, 30.0], [50.2, 10.0]])
    tracks = match(a, a._replace(place_px=beside, sigma_px=np.full((4, 2), 0.01)), np.zeros((3, 2)), 3.0)
    assert sorted(tracks.shift_px[:, 0].round(1).tolist()) == [0.2, 0.4]


def test_a_local_plane_is_exact_in_a_shear():
    rng = np.random.default_rng(2)
    places = rng.uniform(0, 200, (80, 2))
    shift = np.stack([0.1 * places[:, 1], 0.02 * places[:, 0]], -1)
    at = rng.uniform(40, 160, (20, 2))
    found = local_plane(Tracks(places, shift, np.full((80, 2), 0.02), np.arange(80), np.arange(80)), at)
    assert np.abs(found - np.stack([0.1 * at[:, 1], 0.02 * at[:, 0]], -1)).max() < 0.05
