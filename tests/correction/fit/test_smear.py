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
from correction.target.corners import refine_corners
from sim.renderer.kernels.rays import camera_ray, to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.correction.fit.lamps import lab_scene
from tracer.light import band
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose

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
