"""From rays to frames: integration, energy, focus, repeatability, sensor."""

from dataclasses import replace

import numpy as np
import pytest

from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.kernels import rays
from sim.renderer.kernels import reflectance as prints
from sim.renderer.patterns import Chessboard, Image, ParticleSheet, Pose, print_particles
from sim.renderer.render import Aperture, render, render_irradiance, tables_of
from sim.renderer.sensor import SILENT, Sensor
from tracer.bodies import Sphere
from tracer.errors import SceneError
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

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
