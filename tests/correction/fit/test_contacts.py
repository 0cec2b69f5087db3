"""Balls that are known to touch: their gaps are data of the fit, and hold what no corner shows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from correction.errors import FitFailed
from correction.fit.judge.result import _check_contacts
from correction.fit.seen.silhouettes import outlines_of
from correction.fit.solve.solver import minimise, normal_equations, packing_residuals
from correction.fit.solve.unknowns import unknowns_of
from sim.demo.scenes import at_size, demo_scene
from tests.correction.fit.test_silhouettes import SQUARE_MM, corners_and_hidden
from tests.tracer.scenes import ball
from tracer.scene.fit_section import FitTable

TOUCHING = at_size(demo_scene("pair_off_axis"), 252).with_bodies(
    [ball("a", -16.0, 0.0, 30.0, 15.0), ball("b", 8.0, 0.0, 48.0, 15.0), ball("apart", 40.0, 0.0, 30.0, 15.0)]
)


def test_only_balls_that_touch_in_the_file_are_held_together_and_only_if_that_is_said():
    assert unknowns_of(TOUCHING, [0.0], FitTable()).packing == {}
    assert list(unknowns_of(TOUCHING, [0.0], FitTable(contact_mm=0.02)).packing.values()) == [(0, 1)]


def test_a_contact_takes_a_ball_along_and_makes_its_place_known():
    """Of two balls that touch, one is moved; the other follows, as well as the contact is known."""
    unknowns = unknowns_of(TOUCHING, [0.0], FitTable(contact_mm=0.01)).only(["a.x", "b."])
    bound = unknowns.around(unknowns.full(np.array([3.0, 0.0, 0.0, 0.0, 0.0])))  # a goes 3 mm into b
    value = packing_residuals(bound, np.zeros(5))[0].value
    assert value[0, 0] == pytest.approx((30.0 - np.hypot(21.0, 18.0)) / 0.01)
    free = bound.only(["b."])
    found = minimise(free, lambda x: [], np.zeros(len(free.names)), knee=1e6)
    table = bound.spheres(free.full(found.x))
    gap = np.linalg.norm(table[1, :3] - table[0, :3]) - table[:2, 3].sum()
    assert abs(gap) < 0.01
    _, _, normal = normal_equations(free, found.x, [], 1e6)
    along = (table[1, :3] - table[0, :3]) / np.linalg.norm(table[1, :3] - table[0, :3])
    place = slice(0, 3)
    sigma = np.linalg.inv(normal + np.eye(len(normal)))[place, place] * np.outer(free.sigma[:3], free.sigma[:3])
    assert along @ sigma @ along == pytest.approx(0.02**2, rel=0.3)  # by its radius, which is as unsure
    assert np.trace(sigma) == pytest.approx(2.0, rel=0.01)  # across the contact, as before


def test_the_rim_of_a_neighbour_does_not_take_a_ball_out_of_its_contact():
    """What hides the board stands 4 mm off: balls that touch go together, or not at all."""
    away = np.array([24.0, 0.0, 18.0]) / 30.0
    moved = replace(TOUCHING.spheres[1], centre_mm=tuple(np.array([8.0, 0.0, 48.0]) + 4.0 * away))
    corners, hidden = corners_and_hidden(TOUCHING.with_bodies([TOUCHING.spheres[0], moved]), 1)
    corners, hidden = corners[::2], hidden[::2]  # half of them tell enough
    believed = TOUCHING.with_bodies(TOUCHING.spheres[:2])

    def opened_mm(packed: list[tuple[int, int]]) -> float:
        free = np.ones(2, bool)
        found = outlines_of(believed, believed.camera, free, corners, hidden, SQUARE_MM, packed)
        assert found is not None
        return float(away @ (found.move_mm[1] - found.move_mm[0]))

    assert opened_mm([]) > 1.5
    assert abs(opened_mm([(0, 1)])) < 0.6


def test_a_fit_whose_balls_touch_in_the_file_alone_is_refused():
    unknowns = unknowns_of(TOUCHING, [0.0], FitTable(contact_mm=0.02)).only(["a.", "b."])
    _check_contacts(SimpleNamespace(unknowns=unknowns, x=np.zeros(8)))
    apart = np.zeros(8)
    apart[4] = 0.2  # b is moved by 0.2 mm
    with pytest.raises(FitFailed, match="a and b touch in the scene file and not in the frames"):
        _check_contacts(SimpleNamespace(unknowns=unknowns, x=apart))
