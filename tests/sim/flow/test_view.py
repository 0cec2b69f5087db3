"""Images of points through glass against brute force: discs rendered ray by ray, and what must be conserved."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from sim.demo.scenes import at_size, demo_scene
from sim.flow.view import ParticleView, pupil_points
from sim.renderer.kernels.rays import camera_ray, last_way
from sim.renderer.patterns import Pose
from sim.renderer.render import Aperture, render_irradiance, tables_of
from tests.slow_cases import slow
from tracer.bodies import Rod, translate_by
from tracer.errors import SceneError

GAP_MM = 4.0
CROP_PX = 13
ZOOM = 8


def flow_scene(name="two_spheres_500", size=504):
    scene = at_size(demo_scene(name), size)
    return scene.with_bodies([body.moved(translate_by((0.0, 0.0, GAP_MM))) for body in scene.bodies])


@dataclass(frozen=True)
class Disc:
    """A lone white disc on a black sheet."""

    x_mm: float
    y_mm: float
    radius_mm: float
    pose: Pose

    def reflectance(self, points_mm):
        off = np.hypot(points_mm[:, 0] - self.x_mm, points_mm[:, 1] - self.y_mm)
        return (off < self.radius_mm).astype(np.float32)

    def points_mm(self, count=800):
        k = np.arange(count)
        r, angle = self.radius_mm * np.sqrt((k + 0.5) / count), np.pi * (3.0 - np.sqrt(5.0)) * k
        return np.column_stack(
            (self.x_mm + r * np.cos(angle), self.y_mm + r * np.sin(angle), np.full(count, self.pose.offset_mm[2]))
        )


def seen_by_rays(scene, disc, about_px, aperture, samples):
    """Centroid and light of a disc by brute force, in pixels an eighth as large around where it should be."""
    camera = scene.camera
    corner = np.round(about_px) - CROP_PX // 2
    place = tuple(ZOOM * (np.array(camera.principal_px) - corner + 0.5) - 0.5)
    side = ZOOM * CROP_PX
    fine = replace(camera, focal_px=ZOOM * camera.focal_px, principal_px=place, sensor_px=(side, side))
    light = render_irradiance(scene.with_camera(fine), disc, samples=samples, aperture=aperture).astype(np.float64)
    rows, columns = np.indices(light.shape)
    total = light.sum()
    fine_px = np.array([(columns * light).sum(), (rows * light).sum()]) / total
    return corner + (fine_px + 0.5) / ZOOM - 0.5, total / ZOOM**2


@pytest.mark.parametrize(
    ("name", "z_mm"),
    [
        slow("two_spheres_500", -0.9),
        ("two_spheres_500", 0.8),
        slow("three_spheres_500", 0.8),
        slow("pair_off_axis", -0.9),
    ],
)
def test_a_point_is_seen_where_and_as_bright_as_its_rays_say(name, z_mm):
    scene = flow_scene(name, 1008)
    view = ParticleView(scene, (-1.0, 1.0))
    tables = tables_of(scene, Pose(), None)
    px_mm = tables.px_mm
    rng = np.random.default_rng(3)
    compared = 0
    for _ in range(9):
        u, v = rng.uniform(200.0, 800.0, 2)
        *way, part, _ = last_way(*camera_ray(u, v, 0.0, 0.0, tables.world.camera), tables.world)
        if part <= 0.0:
            continue
        at = np.array(way[:3]) + (z_mm - way[2]) / way[5] * np.array(way[3:])
        gains = view.images(at[None, :], np.ones(1))
        gains = gains[np.hypot(gains[:, 0] - u, gains[:, 1] - v) < CROP_PX]
        if len(gains) != 1 or gains[0, 2] > 3.5:
            continue  # cut by a rim, or near a fold, where a second image lies beside it
        # Its image covers about half a pixel, however much glass makes it larger or smaller.
        disc = Disc(at[0], at[1], 0.4 * px_mm / np.sqrt(gains[0, 2]), Pose((0.0, 0.0, z_mm)))
        points = disc.points_mm()
        images = view.images(points, np.full(len(points), 1.0 / len(points))).astype(np.float64)
        images = images[np.hypot(images[:, 0] - u, images[:, 1] - v) < 0.5 * CROP_PX]
        if len(images) != len(points) or np.ptp(images[:, :2], axis=0).max() > 0.3 * CROP_PX:
            continue  # cut by a rim, or smeared over the crop
        light = images[:, 2].sum()
        centroid = images[:, :2].T @ images[:, 2] / light
        true_px, true_light = seen_by_rays(scene, disc, centroid, None, 5)
        # A disc shines by its area across the ray, on the bare way by that of a pixel; a particle all round.
        _, _, oz, _, _, dz = camera_ray(u, v, 0.0, 0.0, tables.world.camera)
        bare_cos = -dz
        bare_det = px_mm**2 * ((oz - z_mm) / oz) ** 2
        expected = true_light * bare_cos * bare_det / (-way[5] * np.pi * disc.radius_mm**2)
        assert centroid == pytest.approx(true_px, abs=0.01)
        assert light == pytest.approx(expected, rel=0.02)
        compared += 1
    assert compared > 3


def test_a_bare_view_is_the_pinhole_s_projection():
    scene = flow_scene(size=300).with_bodies([])
    view = ParticleView(scene, (-2.0, 2.0))
    rng = np.random.default_rng(0)
    points = np.column_stack((rng.uniform(-70.0, 70.0, (500, 2)), rng.uniform(-2.0, 2.0, 500)))
    shine = rng.uniform(0.5, 2.0, 500)
    images = view.images(points, shine)
    camera = scene.camera
    ahead = (points - np.array(camera.position_mm)) @ camera.rotation_matrix.T
    places = np.array(camera.principal_px) + camera.focal_px * ahead[:, :2] / ahead[:, 2:]
    order, found = np.lexsort(places.T), np.lexsort(images[:, 1::-1].T[::-1])
    assert len(images) == 500
    np.testing.assert_allclose(images[found, :2], places[order], atol=2e-4)
    np.testing.assert_allclose(images[found, 2], shine[order], rtol=1e-3)
    light = view.light(points, shine)
    assert light.sum() == pytest.approx(shine.sum(), rel=1e-4)  # no spot is cut: all energy arrives


@pytest.mark.slow
@pytest.mark.parametrize(("name", "z_mm"), [("two_spheres_500", 0.4), ("three_spheres_500", -0.4)])
def test_rays_close_to_the_rims_find_their_way_back(name, z_mm):
    """Where glass squeezes most a ray's own pixel is found again, once, as far as half a pixel from any rim.

    On a fold images have no place of their own.
    """
    scene = flow_scene(name, 1008)
    view, tables = ParticleView(scene, (-1.0, 1.0)), tables_of(scene, Pose(), None)

    def way(u, v):
        ray = camera_ray(u, v, 0.0, 0.0, tables.world.camera)
        *last, part, chain = last_way(*ray, tables.world)
        return np.add(last[:2], (z_mm - last[2]) / last[5] * np.array(last[3:5])), chain if part > 0.0 else -1

    def around(u, v, reach_px):
        return {way(u + reach_px * x, v + reach_px * y)[1] for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1))}

    off, off_at_rims = [], []
    for u, v in np.random.default_rng(8).uniform(150.0, 850.0, (5000, 2)):
        at, chain = way(u, v)
        if chain <= 0 or around(u, v, 0.4) != {chain}:
            continue
        rate = np.stack([way(u + 0.01, v)[0] - at, way(u, v + 0.01)[0] - at]) / (0.01 * tables.px_mm)
        if not 0.1 < abs(np.linalg.det(rate)) < 50.0:
            continue
        images = view.images(np.array([[*at, z_mm]]), np.ones(1))
        apart = np.sort(np.hypot(images[:, 0] - u, images[:, 1] - v))
        (off if around(u, v, 3.0) == {chain} else off_at_rims).append(apart[0] if len(apart) else np.inf)
        assert len(apart) < 2 or apart[1] > 0.01
    assert len(off) > 500
    assert np.max(off) < 1e-3
    assert len(off_at_rims) > 10
    assert np.quantile(off_at_rims, 0.9) < 1e-3


def test_cells_half_as_large_change_nothing():
    scene = flow_scene()
    rng = np.random.default_rng(5)
    points = np.column_stack((rng.uniform(-20.0, 20.0, (4000, 2)), rng.uniform(-1.0, 1.0, 4000)))
    coarse, fine = (
        ParticleView(scene, (-1.0, 1.0), step_px=step).light(points, np.ones(4000)) for step in (2.0, 1.0)
    )
    rows, columns = np.indices(coarse.shape)
    off = np.hypot(columns - 251.5, rows - 251.5)
    inside = (off < 60.0) | (off > 120.0)  # the fold and the balls' edge lie between
    assert np.abs(coarse - fine)[inside].max() < 0.01 * fine[inside].max()
    assert coarse.sum() == pytest.approx(fine.sum(), rel=0.05)


def test_a_rod_blocks_and_bits_do_not_depend_on_threads(monkeypatch):
    monkeypatch.setenv("RTPIV_THREADS", "3")
    scene = flow_scene(size=200).with_bodies([Rod("rod", (-60.0, 0.0, 40.0), (60.0, 0.0, 40.0), 5.0)])
    view = ParticleView(scene, (-1.0, 1.0), aperture=Aperture(60.0, 8.0, 500.0))
    rng = np.random.default_rng(5)
    points = np.column_stack((rng.uniform(-60.0, 60.0, (9000, 2)), rng.uniform(-1.0, 1.0, 9000)))
    light = view.light(points, np.ones(9000))
    assert light[97:103].max() == 0.0
    assert light[:80].sum() > 0.0
    monkeypatch.setenv("RTPIV_THREADS", "1")
    np.testing.assert_array_equal(light, view.light(points, np.ones(9000)))


@pytest.mark.parametrize("count", [1, 7, 19, 37])
def test_points_of_the_pupil_have_the_disc_s_moments(count):
    points = pupil_points(count)
    assert len(points) == count
    assert points.mean(axis=0) == pytest.approx((0.0, 0.0), abs=1e-12)
    if count > 1:
        assert points.T @ points / count == pytest.approx(0.25 * np.eye(2), abs=1e-12)


def test_what_cannot_be_is_refused():
    with pytest.raises(SceneError, match="7, 19, 37"):
        pupil_points(8)
    with pytest.raises(SceneError, match="two heights"):
        ParticleView(flow_scene(size=50), (1.0, -1.0))


def test_a_point_that_leaves_the_plane_along_its_ray_is_seen_where_it_was():
    scene = flow_scene()
    view = ParticleView(scene, (-1.0, 1.0))
    points = np.array([[0.0, 8.0, 0.0], [14.0, 3.0, 0.0], [45.0, -40.0, 0.0]])  # two behind the balls, one beside
    for point in points:
        pixel = max(view.images(point[None], np.ones(1)), key=lambda image: image[2])[:2].astype(float)
        slope = view.slopes(pixel[None])[0]
        for rise in (-0.8, 0.8):
            moved = point + rise * np.array([*slope, 1.0])
            found = view.images(moved[None], np.ones(1))[:, :2]
            assert np.abs(found - pixel).max(axis=1).min() < 0.02
    x_mm, _, z_mm = scene.camera.position_mm
    assert slope[0] == pytest.approx((x_mm - 45.0) / z_mm, abs=2e-3)  # beside the glass
    assert np.isnan(view.slopes(np.array([[-500.0, 3.0], [np.nan, 3.0]]))).all()
