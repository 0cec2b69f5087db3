"""The chapter on spheres that have moved: a warning where one has; what is not determined is no number."""

from dataclasses import replace

import numpy as np

from correction.self_check.moved_sphere import judge_pairs
from rtpiv.analysis.report.mean import show_self_check
from rtpiv.analysis.report.page import Page
from tests.correction.self_check.test_moved_sphere import NAMES, PAIRS, particles
from tracer.light_sheet import LightSheet


def written(tmp_path, seen):
    page = Page("a run", "of a flow")
    show_self_check(page, judge_pairs(NAMES, seen, PAIRS, LightSheet()))
    page.write(tmp_path / "page.html")
    return (tmp_path / "page.html").read_text(encoding="utf-8")


def test_a_sphere_that_moved_is_a_warning(tmp_path):
    move = np.zeros(9)
    move[3] = 0.02
    text = written(tmp_path, particles(np.random.default_rng(1), move))
    assert "middle has moved" in text
    assert "calibrate again" in text


def test_spheres_that_stand_still_are_said_to(tmp_path):
    seen = particles(np.random.default_rng(2))
    by_sphere = seen.by_sphere.copy()
    by_sphere[:, :, :3] = 0.0
    text = written(tmp_path, replace(seen, by_sphere=by_sphere))
    assert "no sphere has moved" in text
    assert "not determined" in text
