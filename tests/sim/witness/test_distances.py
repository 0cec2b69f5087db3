"""Distances against what one can see, against points strewn over the shapes, against bounded least squares."""

import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from daq.bench.keep_out import Carrier, KeepOut, KeepOutTable
from sim.witness import distances as d
from sim.witness.clearances import CAPSULES, Carried, Clearances
from sim.witness.distances import point_to_segment
from stages.way import Piece
from tracer.bodies import Box, Prism, Rod, Sphere
from tracer.bodies.block import UNTURNED, rectangle, rotate_axes
from tracer.camera import Camera, look_at
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

point = st.tuples(*[st.floats(-50.0, 50.0)] * 3)


def test_least_finds_the_bottom_of_a_valley_wherever_it_is():
    for bottom in (-1.0, 0.0, 1e-6, 0.3, 0.999999, 1.0, 2.0):
        low = min(max(bottom, 0.0), 1.0)
        assert d.least(lambda x, b=bottom: (x - b) ** 2) == pytest.approx((low - bottom) ** 2, abs=1e-12)
        assert d.least(lambda x, b=bottom: abs(x - b)) == pytest.approx(abs(low - bottom), abs=1e-7)
    assert d.least(lambda x: max(abs(x - 0.5), 0.2)) == 0.2  # a flat bottom


def test_distances_one_can_see():
    low, high = (-1.0, -2.0, -3.0), (1.0, 2.0, 3.0)
    assert d.point_to_box((0.5, 0.5, 0.5), low, high) == 0.0
    assert d.point_to_box((4.0, 6.0, 3.0), low, high) == 5.0
    assert d.point_to_segment((0.0, 3.0, 0.0), (-1.0, 0.0, 0.0), (5.0, 0.0, 0.0)) == 3.0
    assert d.point_to_segment((8.0, 4.0, 0.0), (-1.0, 0.0, 0.0), (5.0, 0.0, 0.0)) == 5.0
    assert d.point_to_segment((3.0, 4.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) == 5.0
    crossed = d.segment_to_segment((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, -1.0, 2.0), (0.0, 1.0, 2.0))
    assert crossed == pytest.approx(2.0, abs=1e-9)
    assert d.segment_to_box((-9.0, 0.0, 0.0), (9.0, 0.1, 0.2), low, high) == 0.0
    assert d.segment_to_box((-9.0, 5.0, 0.0), (9.0, 5.0, 0.0), low, high) == pytest.approx(3.0, abs=1e-9)


def bounded(start, plus, minus):
    """Smallest length of start + sum u plus - sum v minus with coefficients from 0 to 1, by another route."""
    columns = np.array([*plus, *[-np.array(v) for v in minus]], float)
    columns = columns[np.any(columns != 0.0, axis=1)]
    if not len(columns):
        return float(np.linalg.norm(start))
    solution = lsq_linear(columns.T, -np.array(start), bounds=(0.0, 1.0), method="bvls", tol=1e-14)
    return float(np.linalg.norm(columns.T @ solution.x + start))


@given(point, point, point, point)
def test_segments_agree_with_least_squares(a, b, c, e):
    expected = bounded(np.subtract(a, c), [np.subtract(b, a)], [np.subtract(e, c)])
    assert d.segment_to_segment(a, b, c, e) == pytest.approx(expected, abs=1e-5)


@given(point, point, point, st.tuples(*[st.floats(0.1, 60.0)] * 3))
def test_segment_and_box_agree_with_least_squares(a, b, low, size):
    high = tuple(x + s for x, s in zip(low, size, strict=True))
    expected = bounded(np.subtract(a, low), [np.subtract(b, a)], list(np.diag(size)))
    assert d.segment_to_box(a, b, low, high) == pytest.approx(expected, abs=1e-5)


def test_no_point_of_the_shapes_is_closer():
    rng = random.Random(3)
    for _ in range(50):
        a, b = (tuple(rng.uniform(-9, 9) for _ in range(3)) for _ in range(2))
        low = tuple(rng.uniform(-9, 9) for _ in range(3))
        high = tuple(x + rng.uniform(0.1, 6) for x in low)
        found = d.segment_to_box(a, b, low, high)
        strewn = min(
            math.dist(d.along(a, b, rng.random()), [rng.uniform(x, y) for x, y in zip(low, high, strict=True)])
            for _ in range(2000)
        )
        assert found <= strewn + 1e-9
        assert strewn - found < 3.0


# True clearances against the guard of the stages, which finds them another way, and against small time steps.


GLASS = ConstantMedium(1.53, "glass")
SIZES = {
    "clearance_mm": 5.0, "target_size_mm": [200.0, 160.0, 20.0], "camera_radius_mm": 60.0, "camera_ahead_mm": 80.0,
    "camera_behind_mm": 150.0,
}  # fmt: skip
AXES = {
    "rail_z": ("camera", "z", 500.0), "camera_x": ("camera", "x", 0.0), "glass_x": ("glass", "x", 3.0),
    "glass_y": ("glass", "y", 0.0), "glass_z": ("glass", "z", 0.0), "target_z": ("target", "z", -7.0),
    "target_x": ("target", "x", 0.0),
}  # fmt: skip
AT_SCENE = {name: at_mm for name, (_, _, at_mm) in AXES.items()}


def scene(tilt=0.2):
    place = (500.0 * tilt, 0.0, 500.0)
    camera = Camera(6000.0, (1007.5, 1007.5), (2016, 2016), place, look_at(place, (0.0, 0.0, 0.0)))
    return Scene(
        camera,
        (
            Sphere("front", (0.0, 0.0, 50.0), 20.0, GLASS),
            Rod("support", (0.0, -30.0, 50.0), (40.0, -70.0, 55.0), 6.0),
        ),
    )


def clearances(slack_mm=0.0, **changes):
    carried = {name: Carried(element, "xyz".index(along), at) for name, (element, along, at) in AXES.items()}
    return Clearances(scene(), carried, KeepOutTable(**{**SIZES, **changes}), dict.fromkeys(AXES, slack_mm))


def guard():
    return KeepOut(scene(), {name: Carrier(*what) for name, what in AXES.items()}, KeepOutTable(**SIZES))


def put(judge, places_mm):
    judge.note_rest()
    for name, at_mm in places_mm.items():
        judge.put(name, at_mm)


@pytest.mark.slow
def test_one_axis_at_a_time_it_agrees_with_the_guard():
    judge, other, rng = clearances(), guard(), random.Random(7)
    refused = 0
    for _ in range(300):
        places_mm = {name: at + rng.uniform(-60.0, 60.0) for name, at in AT_SCENE.items()}
        axis = rng.choice(list(AXES))
        end_mm = places_mm[axis] + rng.uniform(-300.0, 300.0)
        put(judge, places_mm)
        found = judge.judge_motion({axis: end_mm}, {axis}, {})
        piece = Piece(axis, places_mm[axis], end_mm, places_mm)
        expected = [
            (one.name, two.name, closest)
            for one, two, closest, begin in other._approaches(piece)
            if closest < min(other._limit_mm(one, two), begin) - 1e-6
        ]
        names = {frozenset((one, two)): closest for one, two, closest in expected}
        deep = {pair: mm for pair, mm in names.items() if mm > -20.0}  # in a box the depth is not measured
        assert {frozenset((a.one, a.other)) for a in found if a.clearance_mm < a.allowed_mm - 1e-6} >= deep.keys()
        assert {frozenset((a.one, a.other)) for a in found} <= names.keys()
        for approach in found:
            expected_mm = names[frozenset((approach.one, approach.other))]
            assert approach.clearance_mm == pytest.approx(expected_mm, abs=1e-4)
        refused += bool(found)
    assert refused > 25


@pytest.mark.slow
def test_a_way_in_small_stretches_is_judged_like_the_way_as_a_whole():
    """What lies in the neighbourhood known to be free is not looked at: nothing may be missed there."""
    rng = random.Random(5)
    seen = 0
    for _ in range(200):
        whole, cut = clearances(), clearances()
        places_mm = {name: at + rng.uniform(-60.0, 60.0) for name, at in AT_SCENE.items()}
        put(whole, places_mm)
        put(cut, places_mm)
        for _ in range(4):
            axis = rng.choice(list(AXES))
            begin_mm, way_mm = places_mm[axis], rng.uniform(-100.0, 100.0)
            at_once = {(a.one, a.other): a for a in whole.judge_motion({axis: begin_mm + way_mm}, {axis}, {})}
            in_parts = {}
            for part in range(1, 41):
                for approach in cut.judge_motion({axis: begin_mm + way_mm * part / 40}, {axis}, {}):
                    key = approach.one, approach.other
                    in_parts[key] = min(in_parts.get(key, approach), approach, key=lambda a: a.clearance_mm)
            assert in_parts.keys() == at_once.keys()
            for key, approach in at_once.items():
                assert in_parts[key].clearance_mm == pytest.approx(approach.clearance_mm, abs=1e-6)
            seen += len(at_once)
            places_mm[axis] += way_mm
            whole.note_rest()
            cut.note_rest()
    assert seen > 30


def test_two_axes_that_are_harmless_one_by_one():
    judge = clearances()
    put(judge, AT_SCENE)
    assert not judge.judge_motion({"glass_z": -20.0}, {"glass_z"}, {})  # 10 mm are left
    judge.note_rest()
    assert not judge.judge_motion({"glass_z": 0.0}, {"glass_z"}, {})
    judge.note_rest()
    found = judge.judge_motion({"glass_z": -20.0, "target_z": 3.0}, {"glass_z", "target_z"}, {})
    assert [(a.one, a.other) for a in found] == [("front", "the target")]
    assert found[0].clearance_mm == pytest.approx(0.0, abs=1e-9)


def test_away_from_what_is_too_close_is_allowed_and_deeper_is_not():
    judge = clearances()
    put(judge, AT_SCENE | {"glass_z": -27.0})
    assert not judge.judge_motion({"glass_z": -20.0}, {"glass_z"}, {})
    put(judge, AT_SCENE | {"glass_z": -27.0})
    assert not judge.judge_motion({"glass_x": 13.0}, {"glass_x"}, {})  # along the target
    put(judge, AT_SCENE | {"glass_z": -27.0})
    assert judge.judge_motion({"glass_z": -27.2}, {"glass_z"}, {})
    put(judge, AT_SCENE | {"glass_z": -27.0})
    assert not judge.judge_motion(
        {"glass_z": -27.2}, {"glass_z"}, {"target_x": 0.3}
    )  # within what nobody can know


def test_what_looks_for_its_reference_is_not_judged_but_what_moves_then_is():
    judge = clearances()
    put(judge, AT_SCENE)
    assert not judge.judge_motion({"glass_z": -28.0}, set(), {})
    assert judge.judge_motion({"glass_z": -29.0}, {"glass_z"}, {})
    put(judge, AT_SCENE)
    assert not judge.judge_motion({"rail_z": 400.0}, {"rail_z"}, {})
    assert judge.judge_motion({"glass_z": -28.0, "target_x": 1.0}, {"target_x"}, {})


def test_contact_is_allowed_to_the_body_that_is_named():
    judge = clearances(contact=["front"])
    put(judge, AT_SCENE)
    assert not judge.judge_motion({"glass_z": -30.02}, {"glass_z"}, {})
    judge.note_rest()
    assert judge.judge_motion({"glass_z": -30.1}, {"glass_z"}, {})
    assert not clearances(0.05, contact=["front"]).judge_motion({"glass_z": -30.1}, {"glass_z"}, {})


def test_lines_across_a_block_are_as_far_away_as_its_faces():
    axes = rotate_axes(UNTURNED, (0.4, 0.3, 0.2))
    sides = ((-10.0, -8.0), (12.0, -9.0), (-3.0, 14.0))
    blocks = (
        Box("box", rectangle(30.0, 20.0), 24.0, GLASS, (3.0, 4.0, 5.0), axes),
        Prism("prism", sides, 30.0, GLASS),
    )
    rng = np.random.default_rng(5)
    for block in blocks:
        points = rng.normal(size=(60, 3))
        points *= rng.uniform(25.0, 60.0, (60, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
        lines = CAPSULES[type(block)](block)
        for point, distance_mm in zip(points.tolist(), block.distance_mm(points).tolist(), strict=True):
            nearest_mm = min(point_to_segment(tuple(point), line.begin, line.end) for line in lines)
            assert -1e-9 < nearest_mm - distance_mm < 0.1 + 0.5 / max(distance_mm, 1.0)


def test_pieces_cover_a_block_and_a_hollow_one():
    rng = np.random.default_rng(6)
    for wall_mm in (0.0, 2.0):
        axes = rotate_axes(UNTURNED, (0.4, 0.3, 0.2))
        box = Box("box", rectangle(30.0, 20.0), 24.0, GLASS, (3.0, 4.0, 5.0), axes, wall_mm)
        points = np.array(box.centre_mm) + rng.uniform(-22.0, 22.0, (4000, 3))
        inside = np.zeros(len(points), bool)
        for piece in box.pieces:
            shares = np.linalg.solve(piece.edges_mm.T, (points - piece.start_mm).T)
            inside |= ((shares > 0.0) & (shares < 1.0)).all(axis=0)
        assert (inside == (box.distance_mm(points) < 0.0)).all()
