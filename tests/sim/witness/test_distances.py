"""Distances against what one can see, against points strewn over the shapes, against bounded least squares."""

import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from sim.witness import distances as d

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
