"""What a frame says of itself survives the camera, is never misread, and shows what is filed wrongly."""

import random
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from daq.bench.bench_file import load_bench
from sim.bench_table import simulation_of
from sim.camera.packing import FORMATS, to_format_bits
from sim.demo.scenes import demo_scene, misalign
from sim.frame_truth import WORLDS, FrameTruth, NoTruth, truth_of, with_truth
from sim.light import COLOURS, colours_of
from sim.renderer.patterns import Chessboard
from sim.renderer.render import Aperture, render_irradiance
from sim.world import World
from tests.daq.small_bench import write_bench
from tests.loops import loop_over
from tests.tracer.scenes import ball, camera_at
from tracer.light import band, light_of, line, white_led
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_priors, load_scene

AXES = ["rail_z", "glass_x", "target_y"]
TRUTH = FrameTruth(7, 4_000_000_001, {"rail_z": -194.9995, "glass_x": 0.0, "target_y": 1700.123}, True)


def picture(seed=0, bits=12, shape=(60, 70)):
    return np.random.default_rng(seed).integers(0, 1 << bits, shape).astype(np.uint16)


def expected(truth):
    return FrameTruth(
        truth.trigger,
        truth.exposure,
        {axis: round(at_mm, 3) for axis, at_mm in truth.true_mm.items()},
        truth.is_moving,
        truth.world,
    )


@loop_over("name", FORMATS)
def test_it_goes_through_every_format(name):
    image = to_format_bits(with_truth(picture(), TRUTH, 12), 12, name)
    read = truth_of(image, AXES)
    assert (read.trigger, read.exposure, read.is_moving) == (7, 4_000_000_001, True)
    assert read.true_mm == pytest.approx(TRUTH.true_mm, abs=0.0006)


def test_it_goes_through_gain_offset_and_a_crop_of_the_other_sides():
    image = with_truth(picture(), TRUTH, 12)
    for changed in (np.minimum(image * 3.7, 4095), image // 2 + 300, image * 0.1 + 17, image[:20, :40]):
        assert truth_of(changed.astype(np.uint16), AXES).true_mm == pytest.approx(TRUTH.true_mm, abs=0.0006)


def test_the_rest_of_the_picture_is_what_it_was():
    before = picture()
    after = with_truth(before, TRUTH, 12)
    assert np.array_equal(after[8:], before[8:])
    assert np.array_equal(after[:, 32:], before[:, 32:])


def test_a_damaged_block_is_never_read_as_another_one():
    rng = random.Random(2)
    image = with_truth(picture(), TRUTH, 12)
    right = truth_of(image, AXES)
    refused = 0
    for _ in range(500):
        damaged = image.copy()
        for _ in range(rng.randint(1, 6)):
            damaged[rng.randrange(8), rng.randrange(32)] = rng.choice((0, 4095))
        try:
            assert truth_of(damaged, AXES) == right
        except NoTruth:
            refused += 1
    assert refused > 250


@pytest.mark.parametrize(
    "image",
    [
        picture(),
        np.zeros((60, 70), np.uint16),
        np.full((60, 70), 4095, np.uint16),
        picture(shape=(4, 70)),
        with_truth(picture(), TRUTH, 12)[:, 1:],
        with_truth(picture(), TRUTH, 12)[1:],
    ],
)
def test_a_frame_without_truth_tells_none(image):
    with pytest.raises(NoTruth):
        truth_of(image, AXES)


def test_the_truth_of_another_bench_is_refused():
    with pytest.raises(NoTruth, match="3 axes, not of 2"):
        truth_of(with_truth(picture(), TRUTH, 12), AXES[:2])


def test_every_draw_comes_back():
    rng = random.Random(1)
    for _ in range(200):
        places_mm = {f"a{index}": rng.uniform(-2000, 2000) for index in range(rng.randint(1, 12))}
        numbers = rng.getrandbits(32), rng.getrandbits(32)
        truth = FrameTruth(*numbers, places_mm, rng.random() < 0.5, rng.randrange(WORLDS))
        read = truth_of(with_truth(picture(rng.randrange(9), 10), truth, 10), list(places_mm))
        assert read == expected(truth)


# The focal depth that two balls need, as the paper found it: a wide aperture, the camera travelling along z.
#
# Behind two balls the target's centre comes to a focus of its own, a real image 124.7 mm before the plane
# (twice the Gaussian formula of a ball lens, n R / (2 (n - 1)) from its centre), while what is seen beside them
# is sharp at the plane.  A single corner of the board fills the view, so that magnification does not change how
# much edge there is.


VIEW_PX = 33
LENS = Aperture(60.0, 2.8, 500.0)  # focused 500 mm ahead, wherever the camera stands
BOARD = Chessboard(square_mm=10.0, disc_mm=0.0)


def sharpness(scene, travel_mm):
    """Mean squared gradient of the view along the axis, with the camera moved back."""
    camera = scene.camera
    middle = 0.5 * (VIEW_PX - 1)
    place = (0.0, 0.0, camera.position_mm[2] + travel_mm)
    camera = replace(camera, sensor_px=(VIEW_PX, VIEW_PX), principal_px=(middle, middle), position_mm=place)
    light = render_irradiance(scene.with_camera(camera), BOARD, samples=12, aperture=LENS)
    return float(np.mean(np.sum(np.square(np.gradient(light)), axis=0)))


def best_focus(scene, travels_mm):
    """Vertex of the parabola through the sharpest place of a scan and its neighbours."""
    found = np.array([sharpness(scene, travel) for travel in travels_mm])
    top = int(np.argmax(found))
    assert 0 < top < len(found) - 1, found
    a, b, _ = np.polyfit(travels_mm[top - 1 : top + 2], found[top - 1 : top + 2], 2)
    return -b / (2.0 * a)


@pytest.mark.slow
def test_two_balls_need_125_mm_of_focal_depth():
    scene = demo_scene("two_spheres_500")
    background = best_focus(scene.with_bodies(()), np.arange(-8.0, 8.1, 4.0))
    centre = best_focus(scene, np.arange(108.0, 140.1, 8.0))
    assert background == pytest.approx(0.0, abs=1.0)
    assert centre - background == pytest.approx(124.7, abs=3.0)


# Balls that are said to touch do so in the true scene, which is moved and turned as one.


SCENE = Scene(
    camera_at(),
    (
        ball("a", 0.0, 0.0, 30.0, 10.0),
        ball("b", 20.0, 0.0, 30.0, 10.0),
        ball("c", 32.0, 16.0, 30.0, 10.0),
        ball("apart", -40.0, 0.0, 30.0, 10.0),
    ),
)


def gaps(scene: Scene) -> np.ndarray:
    centres = [body.centre_mm for body in scene.spheres]
    return np.array([np.linalg.norm(np.subtract(a, b)) - 20.0 for a, b in combinations(centres, 2)])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_packing_is_off_as_a_whole(seed):
    true = misalign(SCENE, seed, is_packed=True)
    np.testing.assert_allclose(gaps(true)[[0, 1, 3]], gaps(SCENE)[[0, 1, 3]], atol=1e-9)
    moved = np.subtract([body.centre_mm for body in true.spheres], [body.centre_mm for body in SCENE.spheres])
    assert (np.linalg.norm(moved, axis=1) > 0.05).all()
    assert np.ptp(moved[:3], axis=0).max() > 1e-3  # turned as well
    assert np.linalg.norm(moved[3] - moved[:3].mean(axis=0)) > 0.02  # the ball apart by itself
    alone = misalign(SCENE, seed)
    assert gaps(alone)[[0, 3]].min() > 1e-3  # balls that are not said to touch come apart
    rest = replace(true, bodies=()), replace(alone, bodies=())
    assert rest[0] == rest[1]


# A simulated target is seen in the light that the scene file tells of it, particles in that of the laser.


def world(folder, shows, *, scene_nm=532.0, light=None):
    """A small bench's world with two balls of N-BK7, and everything at home."""
    path = write_bench(folder, 64, "samples: 1\nis_misaligned: false")
    tree = yaml.safe_load((folder / "scene.yaml").read_text())
    for body in tree["bodies"]:
        body["material"] = "N-BK7"
    tree |= {"wavelength_nm": scene_nm} | ({} if light is None else {"fit": {"light": light}})
    (folder / "scene.yaml").write_text(yaml.safe_dump(tree))
    bench = load_bench(path)
    stages = SimpleNamespace(true_mm=bench.home_mm.__getitem__, is_moving=False)
    return World(bench, simulation_of(bench), stages, shows, 0)


def test_a_board_lit_by_an_led_is_drawn_in_its_light(tmp_path):
    red = world(tmp_path / "led", "chessboard", light={"mean_nm": 625.0})
    as_red, as_green = (world(tmp_path / f"{nm}", "chessboard", scene_nm=nm) for nm in (625.0, 532.0))
    frame = red.frame(0, 0)
    assert np.array_equal(frame, as_red.frame(0, 0))
    assert not np.array_equal(frame, as_green.frame(0, 0))


def test_particles_are_drawn_in_the_lasers_light(tmp_path):
    told = world(tmp_path / "led", "particles", light={"mean_nm": 625.0})
    assert np.array_equal(told.frame(0, 0), world(tmp_path / "none", "particles").frame(0, 0))
    assert "fit" not in yaml.safe_load(told.truth())


def test_a_wide_light_is_the_sum_of_its_colours(tmp_path):
    lines = {"lines": [[450.0, 1.0], [650.0, 3.0]]}
    sides = [world(tmp_path / f"{nm}", "chessboard", light={"mean_nm": nm}).light() for nm in (450.0, 650.0)]
    both = world(tmp_path / "both", "chessboard", light=lines).light()
    assert both == pytest.approx(0.25 * sides[0] + 0.75 * sides[1], abs=1e-5)


def test_the_truth_says_which_light(tmp_path):
    led = {"mean_nm": 625.0, "width_nm": 20.0}
    told = world(tmp_path / "led", "chessboard", light=led)
    (tmp_path / "truth.yaml").write_text(told.truth())
    assert load_priors(tmp_path / "truth.yaml").light.model_dump(exclude_none=True, exclude_defaults=True) == led
    assert load_scene(tmp_path / "truth.yaml").content_hash() == told.scene.content_hash()


@pytest.mark.parametrize("light", [white_led(4000.0), band(450.0, 650.0)], ids=["white", "band"])
def test_a_few_colours_have_the_moments_of_the_spectrum(light):
    lengths, shares = np.array(colours_of(light)).T
    assert len(lengths) == COLOURS
    assert shares.min() > 0.0
    for order in range(2 * COLOURS):
        spectrum = np.dot(((np.array(light.wavelength_nm) - 550.0) / 100.0) ** order, light.weight)
        assert np.dot(((lengths - 550.0) / 100.0) ** order, shares) == pytest.approx(spectrum, rel=1e-9, abs=1e-9)


def test_few_lines_are_drawn_as_they_are():
    assert colours_of(line(532.0)) == ((532.0, 1.0),)
    assert colours_of(light_of([450.0, 550.0, 650.0], [1.0, 0.0, 3.0])) == ((450.0, 0.25), (650.0, 0.75))
