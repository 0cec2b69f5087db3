"""The renderer against supplied frames, made by a path tracer that is not ours, from the stated truth.

What their path tracer does and ours does not: reflections (a ring at the rims, some 0.5 % of stray light inside
glass), a sampling noise of its own inside glass, and one numerical artefact.  After every refraction it moves
the ray's origin off the surface by (1 + max|x|, |y|, |z|) * 1500 * 2^-24, a common guard of float32 ray tracers:
4 to 9 um here, which shifts the view inside glass radially by up to 0.14 px.  With that single, unfitted number
put in (`theirs`, below), the two renderers agree to 0.015 px in every ring; without it they do not, so the test
would also notice a shift of that size in ours.
"""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.kernels import rays
from sim.renderer.kernels import reflectance as prints
from sim.renderer.patterns import Chessboard, Image, ParticleSheet, Pose, print_particles
from sim.renderer.render import Aperture, render, render_irradiance, tables_of
from sim.renderer.sensor import SILENT, Sensor
from tracer.bodies import Sphere
from tracer.camera import Camera, Lens, look_at, thin_lens_distance_mm
from tracer.errors import SceneError
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

FRAMES = Path(__file__).resolve().parents[4] / "shared" / "frames"
SILHOUETTE = {"two_spheres": (996.0, 998.0, 365.0), "one_sphere": (1000.0, 1010.0, 935.0)}  # u, v, radius [px]
RINGS = ((0.0, 0.5), (0.5, 0.8), (0.8, 0.92))
BORDER_PX = 40  # their distortion step has nothing to show at the border
SPAWN = 1500.0 * 2.0**-24


def true_scene(name):
    truth = json.loads((FRAMES / name / "truth.json").read_text())
    focal_px = thin_lens_distance_mm(truth["f"], truth["L"]) / 0.011
    x, y, z = truth["cam"]
    position = (x, y, truth["L"] + z)
    pose = look_at(position, (x + truth["aim"][0], y + truth["aim"][1], 0.0), truth["roll"])
    lens = Lens(k1=truth.get("k1", 0.0) * (focal_px / 1007.5) ** 2)
    glass = ConstantMedium(truth["n"])
    bodies = [Sphere(f"s{i}", tuple(c), r, glass) for i, (c, r) in enumerate(truth["spheres"])]
    return Scene(Camera(focal_px, (1007.5, 1007.5), (2016, 2016), position, pose, lens), tuple(bodies))


def theirs(scene, pixels, spawn):
    """Plane points (N, 2) of the rays through all spheres from the top down, origins moved off by `spawn`."""
    camera = scene.camera
    way = camera.directions(pixels)
    at = np.broadcast_to(np.array(camera.position_mm), way.shape)
    for sphere in sorted(scene.spheres, key=lambda s: -s.centre_mm[2]):
        for eta, side in ((1.0 / 1.53, -1.0), (1.53, 1.0)):
            from_centre = at - np.array(sphere.centre_mm)
            half = (from_centre * way).sum(1)
            with np.errstate(invalid="ignore"):
                reach = np.sqrt(half**2 - (from_centre**2).sum(1) + sphere.radius_mm**2)
            at = at + (-half + side * reach)[:, None] * way
            normal = -side * (at - np.array(sphere.centre_mm)) / sphere.radius_mm
            cos = -(way * normal).sum(1)
            way = eta * way + (eta * cos - np.sqrt(1.0 - eta**2 * (1.0 - cos**2)))[:, None] * normal
            at = at - normal * spawn * (1.0 + np.abs(at).max(1))[:, None]
    return (at - way * (at[:, 2:] / way[:, 2:]))[:, :2]


class Pair:
    """A supplied frame and ours, both in counts, with the geometry of the regions."""

    def __init__(self, name):
        self.scene = true_scene(name)
        self.supplied = tifffile.imread(FRAMES / name / "target_glass.tif").astype(np.float32)
        light = render_irradiance(self.scene, Chessboard(), samples=2)
        self.ours = 3300.0 * gaussian_filter(light, 0.5, mode="nearest") + 35.0
        u, v, radius = SILHOUETTE[name]
        rows, columns = np.mgrid[0:2016, 0:2016].astype(np.float32)
        self.du, self.dv = columns - u, rows - v
        self.r = np.hypot(self.du, self.dv) / radius
        self.inner = np.zeros(self.r.shape, bool)
        self.inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True

    def region(self, low, high):
        return self.inner & (self.r >= low) & (self.r < high)

    def shifts(self, regions, ours):
        """Mean and radial shift (u, v, r) [px] of the supplied frame in each region: least squares on slopes."""
        a, m = gaussian_filter(self.supplied, 0.7), gaussian_filter(ours, 0.7)
        gv, gu = np.gradient(m)
        radial = (gu * self.du + gv * self.dv) / np.maximum(np.hypot(self.du, self.dv), 1.0)
        found = []
        for region in regions:
            columns = [-gu[region], -gv[region], -radial[region], m[region] / 1e3, np.ones(region.sum())]
            matrix = np.stack(columns).astype(np.float64)
            found.append(np.linalg.solve(matrix @ matrix.T, matrix @ a[region])[:3])
        return np.array(found)

    def with_their_offset(self):
        """Our frame shifted as their ray offset shifts it, to first order, and where that can be said.

        Where the view folds (d plane / d pixel singular) a shift has no meaning; such pixels are left out.
        """
        rows, columns = np.mgrid[0:2016:4, 0:2016:4]
        points = np.column_stack((columns.ravel(), rows.ravel())).astype(np.float64)
        exact = theirs(self.scene, points, 0.0)
        moved = theirs(self.scene, points, SPAWN) - exact
        step = np.array(((0.25, 0.0), (0.0, 0.25)))
        slopes = [(theirs(self.scene, points + s, 0.0) - theirs(self.scene, points - s, 0.0)) / 0.5 for s in step]
        (xu, yu), (xv, yv) = slopes[0].T, slopes[1].T
        det = xu * yv - xv * yu
        delta = np.stack(
            ((yv * moved[:, 0] - xv * moved[:, 1]) / det, (xu * moved[:, 1] - yu * moved[:, 0]) / det), 1
        )
        grid = np.nan_to_num(delta, nan=9.0).reshape(504, 504, 2).astype(np.float32)
        full = cv2.warpAffine(grid, np.array([[4.0, 0.0, 0.0], [0.0, 4.0, 0.0]]), (2016, 2016), borderMode=1)
        valid = maximum_filter(np.abs(full).max(axis=2), 9) < 0.3
        gv, gu = np.gradient(self.ours)
        return np.where(valid, self.ours + gu * full[..., 0] + gv * full[..., 1], self.ours), valid


@pytest.fixture(scope="module", params=["two_spheres", pytest.param("one_sphere", marks=pytest.mark.slow)])
def pair(request):
    if not (FRAMES / request.param / "target_glass.tif").exists():
        pytest.skip(f"supplied frames {request.param} are not here")
    return Pair(request.param)


def plain(image):
    """Pixels without an edge within three pixels, by our frame."""
    return maximum_filter(image, 7) - minimum_filter(image, 7) < 0.02 * 3300.0


@pytest.mark.slow
def test_brightness_agrees_to_the_noise_beside_the_glass(pair):
    region = pair.region(1.02, 9.0) & plain(pair.ours)
    for shade in (pair.ours < 1000.0, pair.ours > 2000.0):
        mine, other = pair.ours[region & shade], pair.supplied[region & shade]
        assert len(mine) > 50_000
        assert other.mean() == pytest.approx(mine.mean(), abs=0.002 * 3300.0)
        noise = np.sqrt((mine.mean() - 35.0) / 2.4 + 36.0)
        assert np.std(other - mine) == pytest.approx(noise, rel=0.02)


def test_brightness_agrees_to_the_stray_light_inside_the_glass(pair):
    """Transmittance: what is left is their stray light (under 1 % of white) and their own noise."""
    for low, high in RINGS:
        region = pair.region(low, high) & plain(pair.ours)
        for shade in (pair.ours < 1000.0, pair.ours > 1500.0):
            difference = pair.supplied[region & shade] - pair.ours[region & shade]
            assert len(difference) > 3000
            assert abs(difference.mean()) < 0.01 * 3300.0
            assert difference.std() < 0.05 * 3300.0


def test_corners_agree(pair):
    """Corners found in our frame, refined in both: mean difference below 0.01 px, in glass and beside it."""
    image = pair.ours.astype(np.float64)
    xx, yy, xy = (gaussian_filter(image, 2.0, order=order) for order in ((0, 2), (2, 0), (1, 1)))
    saddle = xy * xy - xx * yy
    strong = (saddle == maximum_filter(saddle, 13)) & (saddle > 0.15 * np.percentile(saddle, 99.9))
    rows, columns = np.nonzero(strong & pair.inner)
    start = np.column_stack((columns, rows)).astype(np.float32).reshape(-1, 1, 2)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    ours, supplied = (
        cv2.cornerSubPix(frame.astype(np.float32), start.copy(), (5, 5), (-1, -1), stop).reshape(-1, 2)
        for frame in (pair.ours, pair.supplied)
    )
    good = (np.abs(ours - start[:, 0]).max(1) < 3.0) & (np.abs(supplied - ours).max(1) < 1.0)
    r = pair.r[rows, columns]
    for low, high, least in ((0.0, 0.92, 150), (1.02, 9.0, 600)):
        region = (r >= low) & (r < high)
        difference = (supplied - ours)[good & region]
        assert good[region].mean() > 0.98
        assert len(difference) >= least
        assert np.abs(difference.mean(axis=0)).max() < 0.01


def test_views_are_registered_beside_the_glass(pair):
    assert np.abs(pair.shifts([pair.region(1.02, 9.0)], pair.ours)).max() < 0.004


@pytest.mark.slow
def test_views_are_registered_in_every_ring_of_the_glass(pair):
    """The geometry of rays through glass is held by test_rays.py, which is fast."""
    same, valid = pair.with_their_offset()
    regions = [pair.region(*ring) & valid for ring in RINGS]
    assert valid[pair.r < 0.92].mean() > 0.8
    plainly, offset = pair.shifts(regions, pair.ours), pair.shifts(regions, same)
    assert np.abs(plainly[:, :2]).max() < 0.01  # the mean shift of a ring, with nothing put in
    assert np.abs(offset[:, :2]).max() < 0.01
    assert np.abs(offset[:, 2]).max() < 0.015  # radial; stray light at the centre and second order limit it
    assert 0.04 < np.abs(plainly[:, 2]).max() < 0.16  # the artefact is there, and seen


# From rays to frames: integration, energy, focus, repeatability, sensor.


WHITE = Image(np.ones((1, 1), np.float32), 1.0, outside=1.0)


def small(name="two_spheres_500", size=200):
    return at_size(demo_scene(name), size)


@pytest.mark.parametrize("aperture", [None, Aperture(60.0, 4.0, 500.0)])
def test_compiled_loops_do_what_the_python_says(aperture):
    scene = misalign(small("tilted", 40), 1)
    tables, n, count = tables_of(scene, Pose(), aperture), 3, 60
    pixels = np.random.default_rng(0).integers(8, 30, (count, 2))
    world = tables.world
    results = []
    for trace in (rays.trace_pixels, rays.trace_pixels.py_func):
        points, light, spread = np.empty((count, 9, 2)), np.empty((count, 9), np.float32), np.empty(count)
        trace(pixels, n, 5, world, np.arange(9)[::-1].copy(), points, light, spread)
        results.append((points, light, spread))
    for compiled, plain in zip(*results, strict=True):
        assert compiled == pytest.approx(plain, rel=1e-9, abs=1e-9)
    sheet = print_particles((60.0, 60.0), 3.0, seed=1)
    flat = results[0][0].reshape(-1, 2)
    out = np.empty(len(flat), np.float32)
    prints.particles.py_func(flat, sheet._bins, sheet.sigma_mm, sheet.background, out)
    assert sheet.reflectance(flat) == pytest.approx(out, abs=1e-6)
    board = Chessboard()
    discs, shades = np.array(board.discs, float), np.array([0.08, 0.92], np.float32)
    for squares, lines in ((None, [[-np.inf] * 2, [np.inf] * 2]), ((9, 8), [[-4.0, -4.0], [5.0, 4.0]])):
        board = Chessboard(squares=squares)
        prints.chessboard.py_func(flat, 2.5, 0.5, discs, np.array(lines), True, shades, out)
        assert np.array_equal(board.reflectance(flat), out)


def test_index_one_gives_the_direct_view():
    scene = small()
    sheet = print_particles((200.0, 200.0), scene.camera.focal_px / 500.0, seed=1)
    air = [replace(s, medium=ConstantMedium(1.0)) for s in scene.spheres]
    through = render_irradiance(scene.with_bodies(air), sheet)
    direct = render_irradiance(scene.with_bodies(()), sheet)
    # The rims get more rays, so pixels there differ by their sampling; none may be off otherwise.
    assert np.median(np.abs(through - direct)) < 1e-6
    assert np.abs(through - direct).max() < 0.05
    assert direct.std() > 0.05


def test_glass_never_adds_light():
    light = render_irradiance(small("pyramid_500"), WHITE)
    assert light.max() <= 1.0
    assert light.min() >= 0.0
    assert light[:10].min() == 1.0  # bare corner of the frame
    assert light[100, 100] < 0.93  # two spheres: (4n / (1 + n)^2)^4 = 0.838
    on_axis = render_irradiance(small("two_spheres_500", 201), WHITE)[100, 100]
    assert on_axis == pytest.approx((4 * 1.53 / 2.53**2) ** 4, abs=2e-4)


def test_body_behind_the_plane_is_never_seen():
    scene = small()
    bare = scene.with_bodies(())
    behind = scene.with_bodies([Sphere("behind", (0.0, 0.0, -30.0), 20.0, None)])
    assert np.array_equal(render_irradiance(behind, Chessboard()), render_irradiance(bare, Chessboard()))


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("edge", [0.13, 0.5, 0.81])
def test_edge_coverage_is_unbiased(edge, upright):
    """An edge at a known fraction of a pixel: the mean over many pixels is that fraction."""
    scene = small(size=201).with_bodies(())
    width = 500.0 / scene.camera.focal_px
    away = (100.0 * width, 100.0 * width)
    step = (edge - 0.5) * width
    # One corner of huge squares: the edge lies at `edge` of pixel 100, the other edge is out of the frame.
    offset = (step, -away[1], 0.0) if upright else (-away[0], -step, 0.0)
    board = Chessboard(1e4, 1.0, dark=0.0, bright=1.0, pose=Pose(offset))
    light = render_irradiance(scene, board, seed=2)
    line = light[20:180, 100] if upright else light[100, 20:180]
    covered = edge if upright else 1.0 - edge
    shade = line.mean() if light[50, 50] == 1.0 else 1.0 - line.mean()
    assert min(abs(shade - covered), abs(shade - 1.0 + covered)) < 0.004
    assert line.std() < 0.04  # a 4 x 4 grid in line with the edge would do no better than 0.07
    neighbours = light[20:180, 99] if upright else light[99, 20:180]
    assert np.ptp(neighbours) == 0.0


def test_same_bits_for_any_number_of_threads(monkeypatch):
    scene = misalign(small("tilted", 160), 4)
    monkeypatch.setenv("RTPIV_THREADS", "1")
    one = render(scene, Chessboard(), Sensor(), seed=5)
    monkeypatch.setenv("RTPIV_THREADS", "3")
    assert np.array_equal(one, render(scene, Chessboard(), Sensor(), seed=5))
    assert not np.array_equal(one, render(scene, Chessboard(), Sensor(), seed=6))


def test_compressed_view_converges():
    """Four times the samples change rims and all by little: the extra rays go where they are needed."""
    scene = small("one_sphere_250", 120)
    sheet = print_particles((200.0, 200.0), 1.0, seed=2)
    coarse, fine = render_irradiance(scene, sheet), render_irradiance(scene, sheet, samples=12)
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 0.004


@pytest.mark.slow
def test_defocus_widens_a_particle_as_a_thin_lens_does():
    """Second moments of the image add up: particle, blur disc (radius^2 / 4 an axis), pixel (1/12)."""
    scene = at_size(demo_scene("two_spheres_500"), 401).with_bodies(())
    scene = scene.with_camera(replace(scene.camera, principal_px=(40.0, 40.0), sensor_px=(81, 81)))
    pupil, back = Aperture(60.0, 2.0, 500.0), 60.0
    sheet = ParticleSheet(np.zeros((1, 2)), 0.3, 1.0, 0.0, Pose((0.0, 0.0, -back)))
    away2 = (np.arange(81) - 40.0) ** 2

    def moment(aperture):
        frames = [render_irradiance(scene, sheet, samples=8, aperture=aperture, seed=seed) for seed in range(8)]
        light = np.mean(frames, axis=0, dtype=np.float64)
        return (light * away2).sum() / light.sum(), (light.T * away2).sum() / light.sum()

    px_mm = (500.0 + back) / scene.camera.focal_px
    blur_px = 15.0 * back / 500.0 / px_mm  # pupil radius 60 / (2 * 2.0)
    sharp = (0.3 / px_mm) ** 2 + 1.0 / 12.0
    assert moment(None) == pytest.approx((sharp, sharp), rel=0.01)
    assert moment(pupil) == pytest.approx((sharp + 0.25 * blur_px**2,) * 2, rel=0.01)
    assert moment(replace(pupil, focus_mm=560.0)) == pytest.approx((sharp, sharp), rel=0.01)


def test_wide_pupil_still_meets_glass_beside_the_chief_ray():
    """The skip of bare pixels must allow for the pupil: more samples around the rim change nothing on average."""
    scene = small("two_spheres_500", 120)
    wide = Aperture(60.0, 1.4, 500.0)
    light = render_irradiance(scene, WHITE, samples=6, aperture=wide)
    far = Scene(scene.camera, (*scene.bodies, Sphere("far", (0.0, 0.0, -500.0), 480.0, None)))
    assert np.array_equal(light, render_irradiance(far, WHITE, samples=6, aperture=wide))
    sharp = render_irradiance(scene, WHITE, samples=6)
    assert ((light < 1.0) & (sharp == 1.0)).sum() > 200  # the blurred rim is wider than the sharp one


def test_photon_and_read_noise():
    flat = np.full((400, 400), 0.5, np.float32)
    frame = Sensor(white_counts=3000.0).expose(flat, seed=1).astype(np.float64)
    assert frame.mean() == pytest.approx(1535.0, abs=0.3)
    assert frame.var() == pytest.approx(1500.0 / 2.4 + 36.0 + 1.0 / 12.0, rel=0.02)
    dark = Sensor().expose(0.0 * flat, seed=2).astype(np.float64)
    assert (dark.mean(), dark.std()) == pytest.approx((35.0, 6.0), abs=0.1)


def test_sensor_saturates_and_repeats():
    bright = np.full((50, 50), 2.0, np.float32)
    assert (Sensor().expose(bright, seed=1) == 4095).all()
    assert Sensor(bits=8, white_counts=100.0).expose(bright, seed=1).max() <= 255
    half = np.full((50, 50), 0.5, np.float32)
    assert np.array_equal(Sensor().expose(half, seed=3), Sensor().expose(half, seed=3))
    assert not np.array_equal(Sensor().expose(half, seed=3), Sensor().expose(half, seed=4))
    assert (SILENT.expose(half, seed=1, illumination=0.5) == 860).all()  # 3300 / 4 + 35


def test_blur_spreads_a_point_and_keeps_its_light():
    point = np.zeros((41, 41), np.float32)
    point[20, 20] = 1.0
    frame = replace(SILENT, bits=16, white_counts=50000.0, offset_counts=0.0, blur_px=0.8).expose(point, seed=0)
    columns = np.arange(41) - 20.0
    assert frame.sum() == pytest.approx(50000, rel=1e-3)
    assert (frame.sum(axis=0) * columns**2).sum() / frame.sum() == pytest.approx(0.64, rel=0.03)


def test_impossible_settings_say_what_to_change():
    with pytest.raises(SceneError, match="samples"):
        render_irradiance(small(), WHITE, samples=0)
    with pytest.raises(SceneError, match="bits"):
        Sensor(bits=0)
    with pytest.raises(SceneError, match="f_number"):
        Aperture(60.0, 0.0, 500.0)
