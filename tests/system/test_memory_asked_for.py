"""What takes memory by the pixel asks for it first, and asks for what it takes."""

import numpy as np
import pytest

from ground import memory
from ground.errors import MemoryShort
from piv.correlation.pair import evaluate_pair
from sim.demo.scenes import at_size, demo_scene
from sim.flow.view import ParticleView
from sim.renderer.patterns import ParticleSheet
from sim.renderer.render import render
from sim.renderer.sensor import Sensor

SCENE = at_size(demo_scene("two_spheres_500"), 64)
WORK = [
    ("evaluating a pair of 96 x 64 px", lambda: evaluate_pair(np.ones((64, 96)), np.ones((64, 96)))),
    ("a rendered frame of 64 x 64 px", lambda: render(SCENE, ParticleSheet(np.zeros((1, 2)), 0.1), Sensor())),
    ("a view of 45 x 45 nodes from 1 points of the pupil", lambda: ParticleView(SCENE, (-1.0, 1.0))),
]


@pytest.mark.parametrize(("what", "work"), WORK, ids=("piv", "renderer", "flow"))
def test_what_does_not_fit_is_refused_before_it_is_begun(what, work, monkeypatch):
    monkeypatch.setattr(memory, "free_bytes", lambda: 10_000)
    monkeypatch.setattr(memory, "ASKED_FROM_BYTES", 1000)
    with pytest.raises(MemoryShort, match=rf"^{what} needs about 0\.0 GB"):
        work()
