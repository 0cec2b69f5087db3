"""Balls that are said to touch do so in the true scene, which is moved and turned as one."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from sim.demo.scenes import misalign
from tests.tracer.scenes import ball, camera_at
from tracer.scene.scene import Scene

SCENE = Scene(
    camera_at(),
    (
        ball("a", 0.0, 0.0, 30.0, 10.0),
        ball("b", 20.0, 0.0, 30.0, 10.0),
        ball("c", 32.0, 16.0, 30.0, 10.0),
        ball("apart", -40.0, 0.0, 30.0, 10.0),
    ),
)


def gaps(scene: Scene) -> np.ndarray:
    centres = [body.centre_mm for body in scene.spheres]
    return np.array([np.linalg.norm(np.subtract(a, b)) - 20.0 for a, b in combinations(centres, 2)])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_packing_is_off_as_a_whole(seed):
    true = misalign(SCENE, seed, is_packed=True)
    np.testing.assert_allclose(gaps(true)[[0, 1, 3]], gaps(SCENE)[[0, 1, 3]], atol=1e-9)
    moved = np.subtract([body.centre_mm for body in true.spheres], [body.centre_mm for body in SCENE.spheres])
    assert (np.linalg.norm(moved, axis=1) > 0.05).all()
    assert np.ptp(moved[:3], axis=0).max() > 1e-3  # turned as well
    assert np.linalg.norm(moved[3] - moved[:3].mean(axis=0)) > 0.02  # the ball apart by itself
    alone = misalign(SCENE, seed)
    assert gaps(alone)[[0, 3]].min() > 1e-3  # balls that are not said to touch come apart
    rest = replace(true, bodies=()), replace(alone, bodies=())
    assert rest[0] == rest[1]
