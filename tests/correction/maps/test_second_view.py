"""Second views of nodes: what three balls show twice, each by its own path."""

import numpy as np
import pytest

from correction.fitted.prepared import content_key, prepare
from correction.node_status import NodeStatus
from sim.demo.scenes import at_size, demo_scene
from tracer.strategies.trace import trace


@pytest.fixture(scope="module")
def scene():
    return at_size(demo_scene("three_spheres_500"), 252)


def test_the_second_view_shows_the_same_places_on_another_path(scene):
    first, second = (prepare(scene, view=view).corrector for view in (0, 1))
    twice = second.recovered
    assert 200 < np.count_nonzero(twice) < 0.5 * np.count_nonzero(first.recovered)
    assert first.recovered[twice].all()
    assert set(np.unique(second.status[first.recovered & ~twice])) == {NodeStatus.LEFT_OUT}
    places = [found.map.pixel[0][twice] for found in (first, second)]
    nodes = first.map.grid.to_mm(np.argwhere(twice)[:, ::-1].astype(float))
    for pixels in places:
        np.testing.assert_allclose(trace(scene, pixels).plane_mm, nodes, atol=1e-3)
    apart = np.linalg.norm(places[0] - places[1], axis=1)
    assert np.median(apart) > 10.0


def test_frames_of_the_best_view_keep_their_key(scene):
    assert content_key(scene) == content_key(scene, view=0)
    assert content_key(scene) != content_key(scene, view=1)
