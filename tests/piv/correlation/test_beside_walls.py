"""Vectors of a boundary layer beside a bright wall, of which a mask hides a few pixels more than is solid."""

import numpy as np
import pytest

from piv.correlation.pair import evaluate_pair
from tests.piv import hard_scenes
from tests.piv.hard_scenes import SIDE, body_scene, box, disc

WALL = 184  # first solid row, 8 px below a row of vectors
LAYER_PX = 12.0


def errors_beside(seed, hidden_px, swing):
    """Errors of u, and u itself, in rows 4 to 14 px off the wall; the outer flow is 4.5 (1 + swing) px."""
    mean = hard_scenes.over_wall(WALL - 0.5, LAYER_PX)
    flow = lambda x, y: tuple((1.0 + swing) * part for part in mean(x, y))  # noqa: E731
    scene = body_scene(seed, box((WALL, SIDE), (0, SIDE)), flow, 0.5, 0.0, density=0.04)
    valid = np.broadcast_to(np.arange(SIDE)[:, None] < WALL - hidden_px, (SIDE, SIDE))
    field = evaluate_pair(scene.a, scene.b, valid, threads=1)
    x, y = np.meshgrid(field.x_px, field.y_px)
    away = WALL - 0.5 - y
    near = (away > 4.0) & (away < 14.0) & (x > 24.0) & (x < SIDE - 24.0)
    assert field.valid[near].mean() > 0.85
    near &= field.valid
    return (field.u_px - flow(x, y)[0])[near], np.hypot(field.sigma_u_px, field.resolution_px)[near]


@pytest.mark.parametrize("hidden_px", [0, 2])
def test_a_layer_goes_on_to_the_last_light_before_a_wall(hidden_px):
    """Passes ended where windows have too little light for a vector: 0.14 and 0.24 px, 1.7 sigma."""
    found = [errors_beside((901, hidden_px, k), hidden_px, swing) for k, swing in enumerate((-0.1, 0.0, 0.1))]
    errors, sigmas = (np.concatenate(part) for part in zip(*found, strict=True))
    assert abs(errors.mean()) < 0.1
    assert errors.std() < (0.1, 0.17)[hidden_px // 2]
    assert np.sqrt(np.mean(np.square(errors / sigmas))) < 1.35


def test_a_mask_on_a_body_that_the_camera_shakes_makes_nothing_worse():
    """The body leaves its mask by half of the shaking: errors beside it were 1.2 to 1.4 times as large."""
    squares = np.zeros(2)
    for seed, shake in ((911, (1.6, 0.5)), (912, (-0.8, 1.5)), (913, (1.2, -1.2))):
        solid = disc(124, 132, 36)
        scene = body_scene(seed, solid, hard_scenes.swirl, 1.3, 0.15, shake=shake, density=0.04)
        fields = [evaluate_pair(scene.a, scene.b, valid, threads=1) for valid in (None, ~solid)]
        x, y = np.meshgrid(fields[0].x_px, fields[0].y_px)
        near = np.hypot(x - 124, y - 132) < 66
        near &= fields[0].valid & fields[1].valid
        assert near.sum() > 120
        assert (fields[1].valid & ~fields[0].valid).sum() > 5  # and it leaves more
        u, v = scene.truth(x, y)
        squares += [np.sum(((one.u_px - u) ** 2 + (one.v_px - v) ** 2)[near]) for one in fields]
    assert np.sqrt(squares[1] / squares[0]) < 1.05
