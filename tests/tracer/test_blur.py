"""Blur and centroids of points through a pupil, against pictures by the independent renderer."""

import numpy as np
import pytest

from ground.jit import kernel
from sim.demo.scenes import at_size, demo_scene
from sim.renderer.kernels.rays import camera_ray, to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import Aperture, tables_of
from tracer.errors import SceneError
from tracer.pupil import Pupil
from tracer.scene.scene import Scene
from tracer.strategies.blur import pupil_views
from tracer.strategies.trace import trace

F_MM = 60.0
STEP_PX = 0.5
SIDE = 49  # samples of a picture along each side
ALONE_PX = 1.5  # standard deviation of one picture without an aperture
PARTS = 150  # of the pupil, and as many opposite to them


@kernel
def spot_light(world, first, parts, x, y, spot_mm, light):
    for row in range(light.shape[0]):
        for column in range(light.shape[1]):
            u, v = first[0] + STEP_PX * column, first[1] + STEP_PX * row
            for part in range(parts.shape[0]):
                ray = camera_ray(u, v, parts[part, 0], parts[part, 1], world.camera)
                px, py, passed = to_plane(*ray, world)
                light[row, column] += passed * np.exp(-0.5 * ((px - x) ** 2 + (py - y) ** 2) / spot_mm**2)


def picture(scene: Scene, aperture: Aperture, pixel: np.ndarray) -> tuple[np.ndarray, float]:
    """Centroid minus `pixel`, and widest standard deviation, of the picture of the point that `pixel` shows."""
    tables = tables_of(scene, Pose(), aperture)
    world = tables.world
    x, y, _ = to_plane(*camera_ray(*pixel, 0.0, 0.0, world.camera), world)
    turn, share = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(PARTS), (np.arange(PARTS) + 0.5) / PARTS
    parts = world.camera[20] * np.sqrt(share)[:, None] * np.stack((np.cos(turn), np.sin(turn)), axis=-1)
    parts = np.concatenate((parts, -parts))
    along = STEP_PX * (np.arange(SIDE) - SIDE // 2)
    light = np.zeros((SIDE, SIDE))
    spot_light(world, pixel + along[0], parts, x, y, 0.6 * tables.px_mm, light)
    seen = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    weight = light.ravel() / light.sum()
    mean = weight @ seen
    spread = (weight[:, None] * (seen - mean)).T @ (seen - mean)
    return mean, float(np.sqrt(np.linalg.eigvalsh(spread)[1]))


def near_the_rim(scene: Scene, count: int, farthest: float) -> np.ndarray:
    """Pixels that show the plane behind glass, from 0.6 of the largest radius that does to `farthest` of it."""
    middle = np.array(scene.camera.principal_px)
    turn = 2.4 * np.arange(count)
    way = np.stack((np.cos(turn), np.sin(turn)), axis=-1)
    radius = np.linspace(1.0, 0.5 * min(scene.camera.sensor_px), 400)
    rays = trace(scene, middle + radius[:, None, None] * way)
    glass = rays.recovered & (rays.rays["events"] > 0)
    last = np.array([radius[column].max() for column in glass.T])
    return middle + (last * np.linspace(0.6, farthest, count))[:, None] * way


@pytest.mark.parametrize(
    ("f_number", "count", "farthest"), [pytest.param(22.0, 8, 0.94, marks=pytest.mark.slow), (8.0, 3, 0.87)]
)
def test_centroids_lie_where_a_rendered_particle_has_them(f_number, count, farthest):
    scene = at_size(demo_scene("two_spheres_500"), 1008)
    aperture = Aperture(F_MM, f_number, 500.0)
    pixels = near_the_rim(scene, count, farthest)
    blur = pupil_views(scene, Pupil(0.5 * F_MM / f_number, 500.0), pixels).of_particles()
    whole = blur.lost == 0.0
    assert whole.mean() > 0.5
    seen = [picture(scene, aperture, pixel) for pixel in pixels[whole]]
    pinhole = [picture(scene, Aperture(F_MM, 4000.0, 500.0), pixel) for pixel in pixels[whole]]
    alone = np.array(
        [width < ALONE_PX for _, width in pinhole]
    )  # else another view of the point is in the picture
    assert alone.sum() >= whole.sum() - 1
    moved = np.array([a[0] - b[0] for a, b in zip(seen, pinhole, strict=True)])  # a spot is not even behind glass
    left = (moved - blur.shift_px[whole])[alone]
    assert f_number == 22.0 or np.abs(moved).max() > 0.03
    assert np.abs(left).max() <= 0.002
    width = np.array([w for _, w in seen]), np.array([w for _, w in pinhole])
    np.testing.assert_allclose(
        np.sqrt(np.maximum(width[0] ** 2 - width[1] ** 2, 0.0))[alone],
        blur.width_px[whole][alone],
        rtol=0.15,
        atol=0.1,
    )


def test_without_glass_the_plane_in_focus_is_sharp_and_another_is_not():
    scene = at_size(demo_scene("two_spheres_500"), 400).with_bodies(())
    pixels = np.array([[200.0, 200.0], [350.0, 60.0]])
    sharp = pupil_views(scene, Pupil(1.4, 500.0), pixels).of_particles()
    np.testing.assert_allclose(sharp.width_px, 0.0, atol=1e-9)
    blurred = pupil_views(scene, Pupil(1.4, 400.0), pixels).of_particles()
    # a disc of radius r has the standard deviation r / 2 along each axis
    disc = 1.4 * scene.camera.focal_px * (1.0 / 400.0 - 1.0 / 500.0)
    np.testing.assert_allclose(blurred.width_px, 0.5 * disc, rtol=1e-6)
    np.testing.assert_allclose(blurred.shift_px, 0.0, atol=1e-9)


def test_a_pupil_that_cannot_be_is_refused():
    for radius, focus in ((0.0, 500.0), (1.0, 0.0), (float("nan"), 500.0)):
        with pytest.raises(SceneError, match="must be positive"):
            Pupil(radius, focus)
