"""Where least squares puts an unevenly smeared edge, and where independent optics show a corner in colours."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import ndtr

from correction.fit.seen.smear import (
    SLOPE,
    UNEVEN,
    Dispersion,
    Smear,
    colour_steps,
    smear_by_colour,
    smear_of,
    uneven_blur,
)
from correction.fit.seen.smear_test import (
    ColourSmear,
    EdgeSpread,
    SmearedView,
    colour_smear,
    index_width,
    smear_in_view,
)
from correction.target.corners import refine_corners
from sim.demo.scenes import at_size, demo_scene
from sim.renderer.kernels.rays import camera_ray, to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.correction.fit.drawn_labs import drawn_lab
from tests.correction.fit.lamps import lab_scene
from tracer.light import band, gaussian
from tracer.media import MEDIA, ConstantMedium
from tracer.pupil import Pupil
from tracer.scene.scene import Scene
from tracer.strategies.blur import pupil_views
from tracer.strategies.sensitivity import TargetPose, landings

AXES = np.array([[[20.0, 6.0], [-4.0, 18.0]]])  # a square along +x, +y in the frame


def edge_found(steps: np.ndarray, share: np.ndarray, blur_px: float) -> float:
    """Place of the step that least squares finds: a Gaussian edge, mixed of displaced ones."""
    s = np.linspace(-9.0, 9.0, 1201)
    seen = (share[:, None] * ndtr((s - steps[:, None]) / blur_px)).sum(axis=0)

    def misses(x: np.ndarray) -> np.ndarray:
        return x[2] * ndtr((s - x[0]) / x[1]) + x[3] - seen

    return float(least_squares(misses, [0.0, 1.0, 1.0, 0.0]).x[0])


@pytest.mark.parametrize("seed", range(4))
def test_an_uneven_smear_moves_both_edges_as_least_squares_sees_them(seed):
    rng = np.random.default_rng(seed)
    along = rng.gamma(2.0, 0.4, 12) * rng.choice([-1.0, 1.0])
    share = rng.dirichlet(np.full(12, 3.0))
    way = np.array([np.cos(seed), np.sin(seed)])
    steps = along[:, None] * way
    normals = np.stack((-AXES[0, 1], AXES[0, 0]), axis=-1)  # of the edges along +x and +y
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    spread = np.sqrt(share @ (along - share @ along) ** 2)
    blur = float(np.hypot(0.7, spread))
    found = smear_of(steps[:, None], share[:, None], AXES, np.array([blur]))
    for normal in normals:
        own = edge_found(steps @ normal, share, 0.7)
        assert normal @ found.shift_px[0] == pytest.approx(own, abs=0.012)
        assert abs(normal @ found.shift_px[0] - own) < 0.5 * abs(share @ (steps @ normal) - own) + 0.004
    assert found.width_px[0] == pytest.approx(spread)


def test_a_smear_wider_than_the_blur_moves_a_corner_as_the_fit_of_a_frame_finds_it():
    """Plastic in white light: a narrow blue line beside a broad phosphor, 1.4 px apart at a blur of 0.53."""
    along = np.concatenate((np.linspace(2.4, 3.6, 3), np.linspace(-1.6, 0.4, 9)))
    share = np.concatenate((np.full(3, 0.08), np.full(9, 0.76 / 9)))
    along = 1.4 * (along - share @ along) / np.sqrt(share @ (along - share @ along) ** 2)
    steps = along[:, None] * [0.8, 0.6]
    axes = 22.0 * np.array([[np.cos(0.3), np.sin(0.3)], [np.sin(0.3), -np.cos(0.3)]])
    v, u = np.mgrid[:61, :61] - 30.0
    inwards = np.linalg.inv(axes)[::-1] * 22.0 / 0.53
    frame = np.zeros(u.shape)
    for step, part in zip(steps, share, strict=True):
        one, two = np.tensordot(inwards, np.stack((u - step[0], v - step[1])), axes=1)
        frame += part * (2.0 * ndtr(one) - 1.0) * (2.0 * ndtr(two) - 1.0)
    found = refine_corners(1000.0 * (2.0 + frame), [[30.2, 30.1]], axes, window=0.42)
    truly = found.position_px[0] - 30.0
    parts = steps[:, None], share[:, None], axes[None]
    told = smear_by_colour(*parts, np.array([0.42]), found.blurs_px)
    off = np.linalg.norm(told.shift_px[0] - truly)
    assert off < UNEVEN * np.linalg.norm(truly)  # what sigma counts of it
    assert np.linalg.norm(smear_of(*parts, found.blur_px).shift_px[0] - truly) > 0.1  # where a series is no cure


def test_a_blur_that_grows_along_the_frame_may_draw_corners_along():
    index = np.stack(np.meshgrid(np.arange(6), np.arange(5)), axis=-1).reshape(-1, 2)
    axes = np.tile(AXES, (len(index), 1, 1))
    pixel = index @ AXES[0].T
    slope = np.array([0.03, -0.02])
    smear = Smear(np.zeros((30, 2)), np.sqrt(4.0 + pixel @ slope), np.zeros((30, 2)))
    way = np.zeros(30, np.int64)
    np.testing.assert_allclose(uneven_blur(index, way, axes, smear), np.tile(SLOPE * slope, (30, 1)), atol=1e-12)
    alone = uneven_blur(index, np.arange(30), axes, smear)  # every corner on a way of its own
    assert not alone.any()


def with_index(scene: Scene, index: float) -> Scene:
    return scene.with_bodies([replace(sphere, medium=ConstantMedium(index)) for sphere in scene.spheres])


def shown(scene: Scene, pixel: np.ndarray) -> np.ndarray:
    """Point of the plane that a pixel shows, by the renderer's optics."""
    tables = tables_of(scene, Pose(), None)
    x, y, _ = to_plane(*camera_ray(*pixel, 0.0, 0.0, tables.world.camera), tables.world)
    return np.array([x, y])


def seen_at(scene: Scene, point_mm: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Pixel that shows a point, by Newton's method with differences."""
    pixel = start.copy()
    for _ in range(6):
        here = shown(scene, pixel)
        rate = np.stack([shown(scene, pixel + 0.01 * step) - here for step in np.eye(2)], axis=-1) / 0.01
        pixel += np.linalg.solve(rate, point_mm - here)
    return pixel


def test_colours_show_a_corner_where_independent_optics_do():
    scene, light = lab_scene(), band(450.0, 650.0)
    dispersion = Dispersion.of(scene, light)
    middle = np.array(scene.camera.principal_px)
    pixels = middle + np.array([[110.0, 0.0], [-60.0, 120.0], [20.0, -150.0]])
    mean = light.index(scene.spheres[0].medium)
    told = with_index(scene, mean)
    parts = colour_steps(told, TargetPose(), dispersion, pixels)
    found = smear_of(*parts, np.repeat(AXES, 3, axis=0), np.full(3, 0.9))
    for number, pixel in enumerate(pixels):
        point = shown(told, pixel)
        steps = []
        for change in dispersion.index_step[:, 0]:
            steps.append(seen_at(with_index(scene, mean + change), point, pixel) - pixel)
        alone = smear_of(np.array(steps)[:, None], dispersion.weight[:, None], AXES, np.array([0.9]))
        assert found.width_px[number] == pytest.approx(alone.width_px[0], rel=0.02)
        np.testing.assert_allclose(found.shift_px[number], alone.shift_px[0], atol=0.003)
    assert 0.1 < found.width_px.max() < 0.6


# Corners smeared by colours that nobody told: white light is named; one colour, a stop, a told lamp are not.


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


@pytest.mark.slow
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
