"""The renderer's rays against hand-computed optics, brute force, and the tracer's other formulation."""

import math

import numpy as np
import pytest

from sim.demo.scenes import SCENES, demo_scene
from sim.renderer.kernels.rays import camera_ray, to_plane
from sim.renderer.kernels.surfaces import World, entry_rod, entry_sphere, snell
from sim.renderer.patterns import Pose
from sim.renderer.render import Aperture, tables_of
from tracer.bodies import Sphere
from tracer.camera import Camera, Lens, look_at
from tracer.errors import SceneError
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

GLASS = ConstantMedium(1.5)
PLANE = Pose().axes()
NO_RODS = np.empty((0, 7))
NO_WALLS = np.empty((0, 13))
MIDDLE = np.zeros(3)


def world_of(spheres):
    """Spheres alone before the sheet; what stands for the camera is not asked for."""
    return World(np.empty(22), spheres, NO_RODS, NO_WALLS, np.empty((0, 4)), PLANE)


def table(*rows):
    return np.array([(*row, 0.0) if len(row) == 5 else row for row in rows], dtype=np.float64).reshape(-1, 6)


@pytest.mark.parametrize("share", [1.0, 0.0])
def test_a_tilted_sensor_is_sharp_on_an_oblique_plane(share):
    """Scheimpflug: tan(tilt) = tan(41 degrees) f/(L - f); without the tilt rays of a pixel meet elsewhere."""
    angle, image_mm = math.radians(41.0), 60.0 * 500.0 / 440.0
    place = (500.0 * math.sin(angle), 0.0, 500.0 * math.cos(angle))
    camera = Camera(image_mm / 0.02, (400.0, 300.0), (801, 601), place, look_at(place, (0.0, 0.0, 0.0)))
    tilt = -share * math.atan(image_mm / 500.0 * math.tan(angle))
    camera, lens = camera.with_tilted_sensor(0.0, tilt), Aperture(60.0, 2.0, 500.0, (0.0, tilt))
    numbers = tables_of(Scene(camera, ()), Pose(), lens).world.camera
    for pixel in ((0.0, 0.0), (123.0, 600.0), (800.0, 300.0)):
        middle = camera_ray(*pixel, 0.0, 0.0, numbers)[3:]
        assert middle == pytest.approx(camera.directions(np.array(pixel)), abs=1e-12)
        rays = np.array([camera_ray(*pixel, *at, numbers) for at in ((-15.0, 0.0), (15.0, 0.0), (0.0, 15.0))])
        met = rays[:, :2] - rays[:, 2:3] * rays[:, 3:5] / rays[:, 5:]
        off = float(np.ptp(met, axis=0).max())
        assert off < 1e-9 if share else off > 1.0


def test_snell_at_thirty_degrees_into_glass():
    dx, dy, dz, part = snell(0.5, 0.0, -math.cos(math.pi / 6), 0.0, 0.0, 1.0, 1.0 / 1.5)
    assert dx == pytest.approx(1.0 / 3.0, abs=1e-15)  # sin 30 / 1.5
    assert dy == 0.0
    assert dz == pytest.approx(-math.sqrt(8.0) / 3.0, abs=1e-15)
    # r_s = -sin(i - t)/sin(i + t), r_p = tan(i - t)/tan(i + t)
    i, t = math.pi / 6, math.asin(1.0 / 3.0)
    rs, rp = math.sin(i - t) / math.sin(i + t), math.tan(i - t) / math.tan(i + t)
    assert part == pytest.approx(1.0 - 0.5 * (rs**2 + rp**2), abs=1e-14)


def test_snell_on_a_slanted_normal_in_three_dimensions():
    normal = np.array([1.0, 2.0, 2.0]) / 3.0
    ray = np.array([0.0, 0.0, -1.0])
    *out, _ = snell(*ray, *normal, 1.0 / 1.53)
    assert np.linalg.norm(out) == pytest.approx(1.0, abs=1e-15)
    assert np.cross(out, normal) * 1.53 == pytest.approx(np.cross(ray, normal), abs=1e-15)


@pytest.mark.parametrize(
    ("angle_rad", "eta", "transmitted"),
    [
        (0.0, 1.0 / 1.5, 0.96),  # 4n/(1+n)^2
        (0.0, 1.5, 0.96),
        (math.atan(1.5), 1.0 / 1.5, 1.0 - 0.5 * (1.25 / 3.25) ** 2),  # Brewster: r_p = 0
        (math.radians(45.0), 1.5, 0.0),  # beyond the limit angle of 41.8 degrees
        (1.1, 1.0, 1.0),
    ],
)
def test_transmittance_of_known_cases(angle_rad, eta, transmitted):
    *_, part = snell(math.sin(angle_rad), 0.0, -math.cos(angle_rad), 0.0, 0.0, 1.0, eta)
    assert part == pytest.approx(transmitted, abs=1e-14)


def test_sphere_entry_ahead_behind_and_missed():
    assert entry_sphere(0.0, 0.0, 10.0, 0.0, 0.0, -1.0, MIDDLE, 2.0) == pytest.approx(8.0)
    assert entry_sphere(0.0, 0.0, 10.0, 0.0, 0.0, 1.0, MIDDLE, 2.0) == math.inf
    assert entry_sphere(2.1, 0.0, 10.0, 0.0, 0.0, -1.0, MIDDLE, 2.0) == math.inf


@pytest.mark.parametrize("height_mm", [0.0, 3.0, 11.0, 20.0, 24.5])
def test_one_sphere_by_angles(height_mm):
    """A ray parallel to the axis: the angles in the meridian, no vectors."""
    radius, n, centre = 25.0, 1.53, 40.0
    i = math.asin(height_mm / radius)
    t = math.asin(height_mm / radius / n)
    around = i + math.pi - 2.0 * t  # polar angle of the exit, from the camera's side
    bend = 2.0 * (i - t)
    x_exit, z_exit = radius * math.sin(around), centre + radius * math.cos(around)
    expected = x_exit - math.tan(bend) * z_exit
    spheres = table((0.0, 0.0, centre, radius, n))
    x, y, part = to_plane(0.6 * height_mm, 0.8 * height_mm, 300.0, 0.0, 0.0, -1.0, world_of(spheres))
    assert (x, y) == pytest.approx((0.6 * expected, 0.8 * expected), abs=1e-11)
    assert 0.0 < part <= (4 * n / (1 + n) ** 2) ** 2 + 1e-12


@pytest.mark.parametrize("height_mm", [0.0, 3.0, 11.0, 19.9, 20.1, 24.5])
def test_a_hollow_sphere_by_angles(height_mm):
    """Through the core, or reflected at it: the turns of the two surfaces add up."""
    radius, n, core, centre = 25.0, 1.53, 20.0, 40.0
    outer = math.asin(height_mm / radius) - math.asin(height_mm / radius / n)
    i = math.asin(height_mm / n / core)
    inner = 2.0 * i - math.pi if height_mm > core else 2.0 * (i - math.asin(height_mm / core))
    bend = 2.0 * outer + inner
    spheres = np.array([(0.0, 0.0, centre, radius, n, 0.0, core, 1.0)])
    x, y, part = to_plane(0.6 * height_mm, 0.8 * height_mm, 300.0, 0.0, 0.0, -1.0, world_of(spheres))
    expected = height_mm / math.cos(bend) - centre * math.tan(bend)
    assert (x, y) == pytest.approx((0.6 * expected, 0.8 * expected), abs=1e-10)
    assert 0.0 < part <= ((4 * n / (1 + n) ** 2) ** (2 if height_mm > core else 4)) + 1e-12


def test_axis_through_a_touching_stack_on_the_plane():
    spheres = table(*((0.0, 0.0, z, 25.0, 1.5) for z in (25.0, 75.0, 125.0)))
    x, y, part = to_plane(0.0, 0.0, 500.0, 0.0, 0.0, -1.0, world_of(spheres))
    assert (x, y) == (0.0, 0.0)
    assert part == pytest.approx(0.96**6)


@pytest.mark.parametrize("turn", [0.3, 1.0, 2.0, 4.4])
def test_ray_through_a_slanted_contact_goes_straight(turn):
    """Along the line of centres nothing bends, wherever rounding puts the contact."""
    way = np.array([0.3 * math.cos(turn), 0.3 * math.sin(turn), -1.0])
    way /= np.linalg.norm(way)
    upper = np.array([3.0, -2.0, 90.0])
    lower = upper + 45.0 * way  # radii 20 and 25 touch
    spheres = table((*upper, 20.0, 1.5), (*lower, 25.0, 1.5))
    start = upper - 300.0 * way
    expected = start - way * start[2] / way[2]
    for off in (0.0, 1e-13, -1e-12, 1e-9):
        x, y, part = to_plane(start[0] + off, start[1], start[2], *way, world_of(spheres))
        assert (x, y) == pytest.approx(expected[:2], abs=1e-7)
        assert part == pytest.approx(0.96**4, abs=1e-9)


def test_opaque_sphere_and_upward_rays_are_dark():
    spheres = table((0.0, 0.0, 25.0, 25.0, 1.0, 1.0))
    assert to_plane(0.0, 0.0, 500.0, 0.0, 0.0, -1.0, world_of(spheres))[2] == 0.0
    assert to_plane(30.0, 0.0, 500.0, 0.0, 0.0, -1.0, world_of(spheres)) == (30.0, 0.0, 1.0)
    assert to_plane(0.0, 0.0, 500.0, 0.6, 0.0, 0.8, world_of(spheres))[2] == 0.0


def test_rod_is_hit_exactly_where_the_line_passes_near_its_axis():
    rng = np.random.default_rng(5)
    rod = np.array([-20.0, 5.0, 30.0, 35.0, -10.0, 60.0, 4.0])
    along = np.linspace(0.0, 1.0, 4001)[:, None]
    axis = (1.0 - along) * rod[:3] + along * rod[3:6]
    hits = 0
    for _ in range(400):
        start, aim = np.array([0.0, 0.0, 500.0]), rng.uniform((-45, -30, 40), (55, 30, 41))
        way = (aim - start) / np.linalg.norm(aim - start)
        near = np.linalg.norm(np.cross(axis - start, way), axis=1).min()
        t = entry_rod(*start, *way, rod)
        assert (t < math.inf) == (near < 4.0)
        if t < math.inf:
            hits += 1
            point = start + t * way
            assert np.linalg.norm(axis - point, axis=1).min() == pytest.approx(4.0, abs=1e-4)
    assert 30 < hits < 370


def test_lens_terms_follow_the_documented_equation():
    pose = look_at((0.0, 0.0, 400.0), (0.0, 0.0, 0.0))
    lens = Lens(k1=0.2, k2=-0.1, k3=0.05, p1=0.01, p2=-0.02)
    camera = Camera(1000.0, (500.0, 400.0), (1001, 801), (0.0, 0.0, 400.0), pose, lens)
    tables = tables_of(Scene(camera), Pose(), None)
    x, y = 0.3, -0.2  # r^2 = 0.13
    gain = 1.0 + 0.2 * 0.13 - 0.1 * 0.0169 + 0.05 * 0.002197
    right = x * gain + 2 * 0.01 * x * y - 0.02 * (0.13 + 2 * 0.09)
    down = y * gain + 0.01 * (0.13 + 2 * 0.04) + 2 * -0.02 * x * y
    *_, dx, dy, dz = camera_ray(800.0, 200.0, 0.0, 0.0, tables.world.camera)
    assert (dx / -dz, dy / -dz) == pytest.approx((right, -down), abs=1e-14)


def test_pupil_rays_of_a_pixel_meet_in_the_focus_plane():
    camera = SCENES["tilted"]().camera
    tables = tables_of(Scene(camera), Pose(), Aperture(60.0, 3.0, 430.0))  # a pupil of 10 mm
    meeting = []
    for lens in ((0.0, 0.0), (10.0, 0.0), (-3.0, 7.0)):
        ray = np.array(camera_ray(300.0, 1500.0, *lens, tables.world.camera))
        depth = camera.rotation_matrix[2] @ ray[3:]
        behind = camera.rotation_matrix[2] @ (ray[:3] - camera.position_mm)
        meeting.append(ray[:3] + ray[3:] * (430.0 - behind) / depth)
    assert meeting[1] == pytest.approx(meeting[0], abs=1e-10)
    assert meeting[2] == pytest.approx(meeting[0], abs=1e-10)


def test_a_target_that_cuts_a_body_is_refused():
    scene = demo_scene("two_spheres_500")
    with pytest.raises(SceneError, match="cuts through body 'sphere1'"):
        tables_of(scene, Pose((0.0, 0.0, 10.0)), None)
    behind = tables_of(scene, Pose((0.0, 0.0, 50.0)), None)
    assert len(behind.world.spheres) == 1  # the nearer to the camera; the other is behind the target
    assert len(tables_of(scene, Pose((0.0, 0.0, -20.0)), None).world.spheres) == 2


def test_index_is_taken_against_the_room():
    camera = demo_scene("one_sphere_500").camera
    ball = Sphere("ball", (0.0, 0.0, 30.0), 20.0, GLASS)
    scene = Scene(camera, (ball,), ambient=ConstantMedium(1.25))
    assert tables_of(scene, Pose(), None).world.spheres[0, 4] == pytest.approx(1.2)
