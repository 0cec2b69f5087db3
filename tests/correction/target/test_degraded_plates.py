"""Plates on two levels in frames as cameras give them: with specks, and partly covered."""

from collections import Counter
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
import scipy

from correction.errors import TargetNotFound
from correction.target.board_search import find_board
from correction.target.corners import CornerSearch
from correction.target.dot_centres import refine_dots
from tests.correction.target.drawn_plates import drawn
from tests.correction.target.photographed_plates import photograph
from tests.slow_cases import slow
from tracer.board import Dots

SEED = 13  # staggered rows on two levels, a square and a triangle


@lru_cache
def frame():
    return drawn(SEED)


def with_specks(light, rng):
    """Add glints of three pixels, three for each dot."""
    for v, u in rng.integers(4, np.array(light.shape) - 6, (600, 2)):
        light[v : v + 3, u : u + 3] += 0.35
    return light


def with_a_rod(light, rng):
    """Cover a strip and a corner, brightly."""
    height, width = light.shape
    cv2.line(light, (int(0.78 * width), 0), (int(0.7 * width), height), 0.9, width // 30)
    cv2.fillPoly(light, [np.array(((0, 0), (width // 3, 0), (0, height // 2)))], 0.7)
    return light


@pytest.mark.parametrize("degrade", [with_specks, with_a_rod])
def test_a_plate_is_found_in_a_frame_as_cameras_give_them(degrade):
    one, rng = frame(), np.random.default_rng(SEED)
    light = np.array(one.image, np.float32) / np.percentile(one.image, 99.0)
    image = np.clip(200.0 * degrade(light, rng) + 0.5, 0, 255).astype(np.uint8)
    found, off = replace(one, image=image).find()
    assert len(found) > 200
    assert np.median(off) < 0.1
    assert off.max() < 1.0


def test_a_triangle_that_light_hides_is_told_by_the_camera_and_else_refused():
    one = frame()
    image = np.array(one.image)
    for mark in one.board.discs:  # both become discs
        u, v = np.rint(one.true.project(one.board.place_mm(np.array([mark]) + 0.5))[0]).astype(int)
        cv2.circle(image, (int(u), int(v)), 5, float(image[v, u]), -1)
    with pytest.raises(TargetNotFound, match=r"hide which mark of the board is the triangle.*give a prediction"):
        find_board(image, one.board)
    found, off = replace(one, image=image).find()
    assert np.median(off) < 0.1
    assert len(found) > 200


@pytest.mark.slow
@pytest.mark.parametrize("seed", [slow(400), 406])  # walls that join dots; shadows beside the square
def test_walls_of_a_bright_plate_hide_neither_dots_nor_the_triangle(seed):
    image, made, view, _ = photograph(seed, bright_dots=False)
    found = find_board(image, made.board)
    off = np.linalg.norm(found.position_px - view.project(found.board.place_mm(found.index)), axis=-1)
    assert len(found) > 180
    assert np.median(off) < 0.2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seeds", "bright_dots", "least"), [(range(300, 318), True, 15), (range(400, 412), False, 10)]
)
def test_of_photographed_plates_none_is_wrong_and_most_are_found(seeds, bright_dots, least):
    verdicts = Counter()
    for seed in seeds:
        image, made, view, _ = photograph(seed, bright_dots)
        try:
            found = find_board(image, made.board)
        except TargetNotFound:
            verdicts["refused"] += 1
            continue
        off = np.linalg.norm(found.position_px - view.project(found.board.place_mm(found.index)), axis=-1)
        side_px = np.median(np.linalg.norm(found.axes_px, axis=1))
        aside = "cut by shadows" if np.median(off) < 0.1 * side_px else "wrong"  # a wrong place is a side off
        verdicts["right" if np.median(off) < 1.0 else aside] += 1
    assert not verdicts["wrong"], verdicts
    assert verdicts["right"] >= least, verdicts


@pytest.mark.parametrize("cut", [None, 0.35])
def test_a_dot_half_in_shadow_has_an_uncertainty_of_the_missing_width(cut):
    pitch, radius, at = 30.0, 6.0, np.array((40.3, 39.6))
    v, u = np.indices((80, 80))
    light = scipy.special.ndtr((radius - np.hypot(u - at[0], v - at[1])) / 0.8)
    if cut is not None:
        light *= scipy.special.ndtr((at[0] + cut * radius - u) / 0.8)
    frame = 20.0 + 180.0 * light + np.random.default_rng(1).normal(0.0, 2.0, light.shape)
    axes, share = np.diag((pitch, -pitch))[None], np.array([2.0 * radius / pitch])
    dots = Dots(2.0, bright=True, levels="rows", step_mm=1.0)
    usable, search = np.ones((1, 1), np.uint8), CornerSearch()
    fit = refine_dots(frame.astype(np.float32), np.rint(at)[None], axes, share, dots, usable, search)
    off, sigma = np.abs(fit.position_px[0] - at), fit.sigma_px[0]
    assert fit.valid[0]
    assert (off < 4.0 * sigma).all()
    if cut is None:
        assert sigma.max() < 0.03
    else:
        assert off[0] > 1.0
        assert sigma[0] < 2.0 * off[0]
        assert sigma[1] < 0.1


@pytest.mark.parametrize("radius", [8.0, 16.0])
def test_a_reflection_beside_a_dot_does_not_pull_its_centre(radius):
    """It lies on ink and paper alike, and is weaker along a line that no axis of the plate has."""
    pitch, at = 6.0 * radius, np.array((3.03, 3.01)) * radius
    v, u = np.mgrid[: int(6 * radius), : int(6 * radius)].astype(float)
    ink = scipy.special.ndtr((radius - np.hypot(u - at[0], v - at[1])) / 0.8)
    frame = 180.0 - 150.0 * ink + 40.0 / radius * ((u - at[0]) - 0.5 * (v - at[1]))
    frame += np.random.default_rng(2).normal(0.0, 1.0, frame.shape)
    axes, share = np.diag((pitch, -pitch))[None], np.array([2.0 * radius / pitch])
    dots = Dots(2.0, bright=False, levels="rows", step_mm=1.0)
    words = axes, share, dots, np.ones((1, 1), np.uint8), CornerSearch()
    fit = refine_dots(frame.astype(np.float32), np.rint(at)[None], *words)
    assert (np.abs(fit.position_px[0] - at) < 4.0 * fit.sigma_px[0]).all()
    assert fit.sigma_px.max() < 0.03
