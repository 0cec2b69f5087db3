"""Slopes of rays at the plane: against points that the simulator draws above it, and against planes moved."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fitted.prepared import prepare
from correction.maps.slant import node_slopes, ray_slopes, vector_slopes
from piv.correlation.windows import window_grid
from sim.demo.scenes import at_size, demo_scene
from sim.flow.view import ParticleView
from sim.renderer.render import Aperture
from tests.correction.small_scenes import small_scene
from tracer.bodies import translate_by
from tracer.errors import StaleMap
from tracer.pupil import Pupil
from tracer.strategies.trace import trace

SIDE_PX, GAP_MM = 252, 4.0
LENS = Aperture(60.0, 22.0, 440.0)


def two_balls(pupil=None):
    """Two balls of 50 mm, one behind the other, a little before the plane."""
    scene = at_size(demo_scene("two_spheres_500"), SIDE_PX)
    moved = scene.with_bodies([body.moved(translate_by((0.0, 0.0, GAP_MM))) for body in scene.bodies])
    return moved if pupil is None else moved.with_camera(replace(moved.camera, pupil=pupil))


def drawn_px(view, points, near_px):
    """Where the simulator draws that picture of each point (N, 2) which is nearest to a pixel (N, 2)."""
    images = (view.images(point[None], np.ones(1))[:, :2].astype(float) for point in points)
    return np.array(
        [all_of[np.argmin(np.hypot(*(all_of - at).T))] for all_of, at in zip(images, near_px, strict=True)]
    )


@pytest.mark.parametrize("aperture", [None, LENS])
def test_a_point_that_rises_along_the_slope_stays_where_it_is_seen(aperture):
    """The simulator's own optics, behind glass and beside it; with a lens its pictures are centroids."""
    pupil = None if aperture is None else Pupil(aperture.pupil_radius_mm, aperture.focus_mm)
    scene = two_balls(pupil)
    found = prepare(scene).corrector.map
    view = ParticleView(replace(scene, camera=replace(scene.camera, pupil=None)), (-1.0, 1.0), aperture=aperture)
    slopes = node_slopes(found, scene)[0]
    rng = np.random.default_rng(2)
    rows, columns = np.nonzero(found.recovered & (np.hypot(*np.moveaxis(found.grid.nodes_mm(), -1, 0)) < 40.0))
    chosen = rng.choice(len(rows), 60, replace=False)
    at = rows[chosen], columns[chosen]
    places, along = found.grid.nodes_mm()[at], slopes[at]
    behind = found.behind_glass[at] & (np.hypot(*places.T) < 21.0)
    beside = ~found.behind_glass[at] & (np.hypot(*places.T) > 32.0)  # the silhouette ends at 30
    assert behind.sum() > 8
    assert beside.sum() > 10
    flat = np.zeros(len(places))
    still = np.median(np.hypot(*along[behind].T))
    assert 0.2 < still < 0.4
    assert np.hypot(*along[beside].T).max() < 0.12
    use = behind | beside
    wanted = found.pixel[0][at][use]
    pixel = drawn_px(view, np.column_stack((places, flat))[use], wanted)
    for rise in (-0.8, 0.8):
        risen = drawn_px(view, np.column_stack((places + rise * along, flat + rise))[use], wanted)
        straight_up = drawn_px(view, np.column_stack((places, flat + rise))[use], wanted)
        assert np.abs(risen - pixel).max() < 0.02  # px; what the aperture makes of depth is second order
        assert np.median(np.hypot(*(straight_up - pixel)[behind[use]].T)) > 0.06


@pytest.mark.parametrize("name", ["tilted_pair", "two_spheres_500", "pyramid_500"])
def test_slopes_are_what_planes_before_and_behind_differ_by(name):
    scene = small_scene(name, 252)
    scene = scene.with_bodies([body.moved(translate_by((0.0, 0.0, 1.0))) for body in scene.bodies])
    pixels = np.random.default_rng(3).uniform(0.0, 251.0, (400, 2))

    def landed(dz_mm):
        """What the pixels see of a plane that lies so much nearer to the camera."""
        at = (0.0, 0.0, -dz_mm)
        camera = replace(
            scene.camera, position_mm=(*scene.camera.position_mm[:2], scene.camera.position_mm[2] - dz_mm)
        )
        return trace(
            scene.with_camera(camera).with_bodies([b.moved(translate_by(at)) for b in scene.bodies]), pixels
        )

    near, far = landed(0.01), landed(-0.01)
    both = near.recovered & far.recovered
    assert both.sum() > 200
    wanted = (near.plane_mm - far.plane_mm)[both] / 0.02
    np.testing.assert_allclose(ray_slopes(scene, pixels)[both], wanted, atol=1e-9)


def test_nothing_is_said_where_nothing_is_seen():
    scene = two_balls()
    found = prepare(scene, layers=3).corrector.map
    slopes = node_slopes(found, scene)
    assert slopes.shape == found.pixel.shape
    np.testing.assert_array_equal(np.isfinite(slopes).all(axis=-1), found.weight > 0.0)
    assert np.isfinite(slopes[1]).any()  # a second view has a slope of its own
    with pytest.raises(StaleMap):
        node_slopes(found, scene.bare())
    assert np.isnan(ray_slopes(scene, np.array([[np.nan, 3.0]]))).all()


def test_vectors_have_the_mean_slope_of_what_their_windows_see():
    scene = two_balls()
    found = prepare(scene).corrector.map
    windows = window_grid(found.grid.shape, 32, 0.5)
    slopes, nodes = vector_slopes(found, scene, windows, 0.3), node_slopes(found, scene)[0]
    assert slopes.shape == (*windows.shape, 2)
    x, y = np.meshgrid(windows.x_px - 125.5, windows.y_px - 125.5)
    radius = np.hypot(x, y)
    middle = nodes[np.ix_(np.rint(windows.y_px).astype(int), np.rint(windows.x_px).astype(int))]
    calm = np.isfinite(middle).all(axis=-1) & np.isfinite(slopes).all(axis=-1)
    apart = np.where(calm, np.hypot(*np.moveaxis(slopes - middle, -1, 0)), 0.0)
    edge = np.array(found.grid.to_px(np.array((25.0, 0.0))))[0] - 125.5
    assert apart[np.abs(radius - edge) > 20.0].max() < 0.02
    assert apart[np.abs(radius - edge) < 8.0].max() > 0.05  # two views in one window

    patch = nodes[windows.row[4] : windows.row[4] + 32, windows.column[4] : windows.column[4] + 32]
    line = np.exp(-(((np.arange(32) - 15.5) / (0.3 * 32)) ** 2))
    weights = np.where(np.isfinite(patch[..., 0]), np.outer(line, line), 0.0)
    wanted = (weights[..., None] * np.nan_to_num(patch)).sum(axis=(0, 1)) / weights.sum()
    np.testing.assert_allclose(slopes[4, 4], wanted, atol=0.01)  # every fourth node of them
