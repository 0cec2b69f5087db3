"""Corners smeared by colours that nobody told: white light is named; one colour, a stop, a told lamp are not."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.seen.smear_test import (
    ColourSmear,
    EdgeSpread,
    SmearedView,
    colour_smear,
    index_width,
    smear_in_view,
)
from sim.demo.scenes import at_size, demo_scene
from tests.correction.fit.drawn_labs import drawn_lab
from tracer.light import band, gaussian
from tracer.media import MEDIA, ConstantMedium
from tracer.pupil import Pupil
from tracer.strategies.blur import pupil_views
from tracer.strategies.sensitivity import TargetPose, landings

COUNT = 200


def view(
    rng: np.random.Generator, colours: float, stop: float, told_stop: float = 0.0, told_colours: float = 0.0
) -> SmearedView:
    """Corners whose edges are as wide as colours (in white lamps) and stops (in mm^2) make them."""
    lamp, pupil = rng.uniform(0.0, 0.04, (COUNT, 2)), rng.uniform(0.1, 0.5, (COUNT, 2))
    seen = 0.28 + colours * lamp + stop * pupil + rng.normal(0.0, 0.02, (COUNT, 2))
    seen[::40] += 1.0  # dirt
    return SmearedView(
        np.full(COUNT, "ball"), EdgeSpread(seen, told_stop * pupil, told_colours * lamp), lamp, pupil
    )


@pytest.mark.parametrize(("colours", "stop", "told"), [(0.6, 0.0, 0.0), (0.6, 1.8, 0.0), (0.6, 0.2, 1.5)])
def test_colours_are_told_from_a_stop_and_from_the_print(colours, stop, told):
    found = colour_smear([view(np.random.default_rng(number), colours, stop, told) for number in range(3)])
    assert found.share == pytest.approx(colours, abs=3.0 * found.sigma)
    assert found.alarm
    assert "more colours than fit.light gives" in str(found)
    without = colour_smear([view(np.random.default_rng(number), 0.0, stop, told) for number in range(3)])
    assert abs(without.share) < 3.0 * without.sigma
    assert not without.alarm


def test_a_told_light_that_smears_less_than_was_told_is_named_and_a_line_cannot():
    frames = [np.random.default_rng(number) for number in range(3)]
    found = colour_smear([view(rng, -0.9, 0.0, told_colours=1.0) for rng in frames])
    assert found.expected == pytest.approx(1.0)
    assert found.alarm
    assert "fewer colours than fit.light gives" in str(found)
    assert not replace(found, expected=0.0).alarm
    assert not replace(found, share=-0.2).alarm  # so little is not known of what edges take up


def test_the_smear_leaves_open_which_of_two_lights_it_is_where_they_smear_alike():
    glass, told = MEDIA["N-BK7"], gaussian(550.0, 85.0)
    seen = ColourSmear(0.0, 0.02, 0.0, 1.0)
    assert seen.open_share(glass, told, gaussian(550.0, 80.0)) == 1.0
    far = seen.open_share(glass, told, band(450.0, 650.0))
    assert 0.0 < far < 0.5
    assert replace(seen, share=-0.5).open_share(glass, told, band(450.0, 650.0)) > 2.0 * far
    assert replace(seen, share=-0.5, expected=0.5).open_share(glass, told, band(450.0, 650.0)) == 1.0


def test_too_few_corners_tell_nothing():
    assert colour_smear([]) is None
    few = view(np.random.default_rng(0), 0.6, 0.0)
    assert colour_smear([replace(few, way=np.arange(COUNT).astype(str))]) is None


def test_a_drawn_lab_in_white_light_is_named_and_one_in_one_colour_is_not():
    white, laser = drawn_lab(34001, "light").fit.verdict, drawn_lab(34001).fit.verdict
    assert not white.is_right
    assert not white.alarms  # every corner stands where the mean index shows it
    assert "smeared by" in white.sentences[0]
    assert white.to_dict()["smear"]["share"] > 0.3
    assert laser.is_right


def test_the_blur_of_a_stop_is_what_traced_parts_of_it_show():
    scene = at_size(demo_scene("two_spheres_500"), 504)
    pixel = np.random.default_rng(3).uniform(180.0, 320.0, (80, 2))
    rays = landings(scene, pixel)
    axes = np.tile(np.array([[20.0, 0.0], [0.0, -20.0]]), (80, 1, 1))
    spread = EdgeSpread(*np.ones((3, 80, 2)))
    way = np.full(80, "way")
    found = smear_in_view(scene, scene.camera, way, axes, spread, rays).by_pupil_px2
    focus = scene.camera.position_mm[2]
    parts = pupil_views(scene, Pupil(1.0, focus), pixel[rays.recovered], TargetPose()).offset_px
    off = parts - np.nanmean(parts, axis=0)
    expected = np.nanmean(off**2, axis=0)[:, ::-1]  # the edge along x is blurred along v
    whole = np.isfinite(parts).all(axis=(0, 2)) & (expected.max(axis=1) < 4.0)
    assert np.count_nonzero(whole) > 30
    np.testing.assert_allclose(found[whole], expected[whole], rtol=0.1, atol=0.01)


def test_a_frame_without_a_corner_behind_glass_has_nothing_to_smear():
    scene = at_size(demo_scene("two_spheres_500"), 504)
    pixel = np.random.default_rng(3).uniform(0.0, 40.0, (20, 2))
    axes = np.tile(np.array([[20.0, 0.0], [0.0, -20.0]]), (20, 1, 1))
    spread = EdgeSpread(*np.ones((3, 20, 2)))
    found = smear_in_view(scene, scene.camera, np.full(20, ""), axes, spread, landings(scene, pixel))
    assert not found.way.size


def test_glass_that_is_a_number_is_taken_to_spread_colours_as_ordinary_glass_does():
    assert index_width(ConstantMedium(1.5)) == index_width(MEDIA["N-BK7"])
    assert 1e-3 < index_width(MEDIA["N-BK7"]) < 4e-3
    assert index_width(ConstantMedium(1.0003)) == index_width(None) == 0.0
