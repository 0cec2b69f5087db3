"""Printed patterns against their definitions, point by point."""

import math
import re

import cv2
import numpy as np
import pytest
import tifffile

from daq.errors import PlanError
from daq.plans.forecast import check_views
from rtpiv.command_line.cli import DONE, USAGE, main
from sim.demo.frames import load_frames, make_frames
from sim.demo.scenes import SCENES, at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard, Image, ParticleSheet, Plate, Pose, place, print_particles
from sim.renderer.render import render_irradiance, tables_of
from sim.renderer.sensor import SILENT
from tests.daq.small_bench import load
from tracer.board import LARGE_DOTS, Dots
from tracer.bodies import Rod, Sphere
from tracer.camera import Camera, look_at
from tracer.errors import SceneError
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene


def at(pattern, *points):
    return pattern.reflectance(np.array(points, dtype=np.float64))


def test_chessboard_squares_and_discs():
    board = Chessboard(dark=0.1, bright=0.9)
    dark, bright = np.float32(0.1), np.float32(0.9)
    # Near the corners of squares, away from discs: bright if column + row is odd.
    for i in range(-3, 4):
        for j in range(-3, 4):
            want = bright if (i + j) % 2 else dark
            assert at(board, (2.5 * i + 0.1, 2.5 * j + 2.3))[0] == want, (i, j)
            disc = (i, j) in {(0, 0), (0, -1), (-1, -1)}
            other = dark if (i + j) % 2 else bright
            middle = (2.5 * i + 1.25, 2.5 * j + 1.25)
            assert at(board, middle)[0] == (other if disc else want), (i, j)
            assert at(board, (middle[0] + 0.499, middle[1]))[0] == (other if disc else want)
            assert at(board, (middle[0], middle[1] - 0.501))[0] == want


def test_chessboard_of_other_size():
    board = Chessboard(square_mm=4.0, disc_mm=2.0)
    assert at(board, (2.0, 2.9))[0] == np.float32(0.92)  # in the disc of (0, 0)
    assert at(board, (2.0, 3.1))[0] == np.float32(0.08)
    with pytest.raises(SceneError, match="disc_mm"):
        Chessboard(square_mm=1.0)


def test_pose_turns_and_moves():
    pose = Pose((1.0, 2.0, -3.0), (0.0, 0.0, math.pi / 2))
    assert pose.to_world([(1.0, 0.0), (0.0, 2.0)]) == pytest.approx(
        np.array([(1.0, 3.0, -3.0), (-1.0, 2.0, -3.0)])
    )
    tipped = Pose(turn_rad=(0.1, 0.0, 0.0))
    assert tipped.axes()[2] == pytest.approx((0.0, math.cos(0.1), math.sin(0.1)))
    assert pose.translate(z_mm=5.0).offset_mm == (1.0, 2.0, 2.0)
    assert place(Chessboard(3.0), pose) == Chessboard(3.0, pose=pose)


def test_particles_are_the_plain_sum_of_gaussians():
    sheet = print_particles((8.0, 6.0), 12.0, seed=3, density_per_px=0.05, background=0.02)
    rng = np.random.default_rng(0)
    points = rng.uniform((-5.0, -4.0), (5.0, 4.0), (3000, 2))
    r2 = ((points[:, None] - sheet.places_mm) ** 2).sum(axis=2)
    plain = 0.02 + 0.9 * np.exp(-0.5 * r2 / sheet.sigma_mm**2).sum(axis=1)
    assert sheet.reflectance(points) == pytest.approx(np.minimum(plain, 1.0), abs=2e-5)
    assert (plain > 1.0).any()
    assert sheet.reflectance(np.array([(1e9, 0.0), (-1e9, -1e9), (0.0, 4.4)])) == pytest.approx(0.02)


def test_particle_density_and_diameter_are_those_of_the_stated_scale():
    sheet = print_particles((50.0, 40.0), 12.4, seed=1)
    assert len(sheet.places_mm) == pytest.approx(0.02 * 50 * 40 * 12.4**2, abs=1)
    assert sheet.sigma_mm == pytest.approx(0.75 / 12.4)
    assert np.array_equal(sheet.places_mm, print_particles((50.0, 40.0), 12.4, seed=1).places_mm)
    assert not np.array_equal(sheet.places_mm, print_particles((50.0, 40.0), 12.4, seed=2).places_mm)


def test_shifted_particles_are_an_exact_copy():
    sheet = print_particles((20.0, 20.0), 12.0, seed=4)
    shift = np.array([0.7983, -0.31])
    points = np.random.default_rng(1).uniform(-9.0, 9.0, (5000, 2))
    moved = sheet.displace(shift).reflectance(points + shift)
    assert moved == pytest.approx(sheet.reflectance(points), abs=2e-5)
    turned = sheet.displace(lambda places: 0.1 * places[:, ::-1] * (-1.0, 1.0))
    assert turned.places_mm == pytest.approx(sheet.places_mm + 0.1 * sheet.places_mm[:, ::-1] * (-1.0, 1.0))


def test_particles_of_their_own_brightness_and_none_at_all():
    sheet = ParticleSheet(np.array([(0.0, 0.0), (1.0, 0.0)]), 0.05, np.array([0.2, 0.7]), 0.0)
    assert at(sheet, (0.0, 0.0), (1.0, 0.0)) == pytest.approx((0.2, 0.7))
    empty = ParticleSheet(np.empty((0, 2)), 0.05, background=0.25)
    assert at(empty, (0.0, 0.0), (1.0, 0.0)) == pytest.approx(0.25)
    with pytest.raises(SceneError, match="finite"):
        ParticleSheet(np.array([(0.0, np.nan)]), 0.05)


def test_image_is_exact_at_its_pixels_and_linear_between():
    values = np.random.default_rng(2).random((5, 7), dtype=np.float32)
    image = Image(values, 0.5, outside=0.3)
    rows, columns = np.mgrid[0:5, 0:7]
    nodes = np.column_stack(((columns.ravel() - 3) * 0.5, (2 - rows.ravel()) * 0.5))
    assert image.reflectance(nodes) == pytest.approx(values.ravel(), abs=1e-6)
    assert at(image, (-1.5, 1.0))[0] == values[0, 0]  # row 0 at the top, column 0 at the left
    middle = values[1:3, 4:6].mean()
    assert at(image, (0.75, 0.25)) == pytest.approx([middle], abs=1e-6)
    assert at(image, (1.6, 0.0), (0.0, -1.1), (np.nan, 0.0)) == pytest.approx(0.3)
    with pytest.raises(SceneError, match="scale them"):
        Image(values * 255.0, 0.5)


def test_a_board_of_so_many_squares_lies_on_paper():
    board = Chessboard(2.0, discs=(), squares=(5, 4), origin_corner=(2, 1), odd_bright=False, scale=(1.5, 1.0))
    dark, bright = np.float32(0.08), np.float32(0.92)
    assert at(board, (0.1, 0.1), (3.1, 0.1), (0.1, 2.1)).tolist() == [bright, dark, dark]
    inside = [(-5.9, 0.1), (8.9, 0.1), (0.1, -1.9), (3.1, 5.9)]
    beyond = [(-6.1, 0.1), (9.1, 2.1), (0.1, -2.1), (3.1, 6.1)]
    assert at(board, *inside).tolist() == [bright, bright, dark, dark]
    assert (at(board, *beyond) == bright).all()


@pytest.mark.parametrize("step_mm", [1.0, -1.0])
def test_a_ray_meets_the_face_of_a_plate_its_grooves_or_the_wall_between(step_mm):
    """Rows of 5 mm, the origin on the face or in a groove; rays lean by 0.4 mm a step along y, or by 3."""
    plate = Plate(5.0, 2.5, discs=LARGE_DOTS, dots=Dots(1.5, True, "rows", step_mm), dark=0.1, bright=0.9)
    face = np.array([(0.0, 0.0), (0.0, 5.0), (5.0, 1.0), (5.0, 6.0), (20.0, -20.6)])
    met = plate.shade(face, face + np.array((0.0, 0.4)))
    dot = {True: np.float32(0.9), False: np.float32(0.1)}
    rows = np.array([0, 1, 0, 1, -4])
    on_face = (rows % 2 == 0) == (step_mm > 0.0)
    y = face[:, 1] + np.where(on_face, 0.0, 0.4)
    near = np.abs(y - 5.0 * rows)
    radius = np.array([1.25, 0.75, 1.25, 0.75, 0.75])
    assert met.tolist() == [dot[bool(r < size)] for r, size in zip(near, radius, strict=True)]
    steep = plate.shade(face[:2], face[:2] + np.array((0.0, 3.0)))
    assert steep.tolist() == [np.float32(0.9 if face_first else 0.03) for face_first in on_face[:2]]
    with pytest.raises(SceneError, match="levels"):
        Plate(5.0, 2.5, discs=LARGE_DOTS, dots=Dots(1.5))


# Supports on the simulated bench: what they hide, bodies beside the sheet, what cannot be drawn said at once.


SIDE_PX, PX_PER_MM, L_MM = 121, 1.0, 500.0
WHITE = Chessboard(400.0, 0.0, dark=1.0, bright=1.0)
SUPPORT = (
    "  - {name: support, kind: rod, start_mm: [-70.0, -60.0, -20.0],"
    " end_mm: [70.0, -60.0, -20.0], radius_mm: 3.0}\n"
)


def scene_of(*bodies):
    middle = 0.5 * (SIDE_PX - 1)
    place = (0.0, 0.0, L_MM)
    pose = look_at(place, (0.0, 0.0, 0.0))
    return Scene(Camera(PX_PER_MM * L_MM, (middle, middle), (SIDE_PX, SIDE_PX), place, pose), bodies)


def seen(*bodies, **options):
    return render_irradiance(scene_of(*bodies), WHITE, samples=3, **options)


def test_a_rod_and_an_opaque_ball_are_dark_where_they_stand_and_nowhere_else():
    rod = Rod("rod", (-30.0, 20.0, 40.0), (30.0, 20.0, 40.0), 4.0)
    ball = Sphere("lead", (-20.0, -25.0, 30.0), 8.0, None)
    light = seen(rod, ball)
    scale = L_MM / (L_MM - 40.0)  # thrown from the pinhole
    middle = light[:, 60]
    dark = np.flatnonzero(middle < 0.5)
    y_mm = 60.0 - dark
    assert y_mm.max() == pytest.approx(scale * 24.0, abs=1.0)
    assert y_mm.min() == pytest.approx(scale * 16.0, abs=1.0)
    scale = L_MM / (L_MM - 30.0)
    area = float((light[61:] < 0.5).sum())
    assert area == pytest.approx(np.pi * (8.0 * scale) ** 2, rel=0.06)
    assert light[5, 5] == pytest.approx(1.0)
    assert light[60 + round(25.0 * scale), 60 - round(20.0 * scale)] == 0.0


def test_glass_beside_the_sheet_may_reach_past_its_plane_and_shows_no_sheet():
    ball = Sphere("ball", (0.0, 45.0, 30.0), 20.0, ConstantMedium(1.5))
    forward = place(WHITE, Pose().translate(z_mm=25.0))  # the ball's middle is 5 mm before it
    with pytest.raises(SceneError, match="cuts through body 'ball'"):
        render_irradiance(scene_of(ball), forward, samples=2)
    with pytest.raises(SceneError, match="cuts through body 'ball'"):
        render_irradiance(scene_of(ball), forward, samples=2, sheet_mm=(60.0, 60.0))
    light = render_irradiance(scene_of(ball), forward, samples=2, sheet_mm=(60.0, 48.0))
    assert light[60, 60] == pytest.approx(1.0)
    assert light[12, 60] == 0.0  # through the middle of the ball one looks past the sheet


@pytest.mark.parametrize("kind", ["rod", "opaque ball"])
def test_a_support_beside_the_sheet_may_reach_past_it(kind):
    body = (
        Rod("post", (0.0, 50.0, 10.0), (0.0, 50.0, 80.0), 3.0)
        if kind == "rod"
        else Sphere("post", (0.0, 50.0, 25.0), 5.0, None)
    )
    pose = Pose().translate(z_mm=25.0)
    assert len(tables_of(scene_of(body), pose, None, (80.0, 80.0)).world.bounds) == 1
    with pytest.raises(SceneError, match="'post'"):
        tables_of(scene_of(body), pose, None, (80.0, 120.0))


def with_support(folder, text, **changes):
    """The example bench with a support, its keep-out zone left out: nothing else would refuse."""
    bench, plan = load(folder, **changes)
    (folder / "scene.yaml").write_text((folder / "scene.yaml").read_text() + text)
    bench_text = (folder / "bench.yaml").read_text()
    (folder / "bench.yaml").write_text(re.sub(r"^keep_out:\n(  .*\n)+", "", bench_text, flags=re.MULTILINE))
    return bench, plan


DEEP = "experiment: target\nclear: {z_mm: [0.0]}\nglass: {z_mm: [0.0, -20.0]}\n"


def test_what_cannot_be_drawn_is_refused_by_the_dry_run(tmp_path, capsys):
    with_support(tmp_path, SUPPORT, plan=DEEP)
    arguments = ["acquire", str(tmp_path / "plan.yaml"), "--bench", str(tmp_path / "bench.yaml"), "--dry-run"]
    assert main(arguments) == DONE  # a real bench draws nothing
    assert main([*arguments, "--simulate"]) == USAGE
    said = capsys.readouterr().err
    assert "target_glass_z-20" in said
    assert "'support'" in said
    assert "cable" not in said


def test_a_lab_with_supports_can_be_shown(tmp_path):
    text = SUPPORT.replace("-20.0]", "20.0]") + (
        "  - {name: lead, kind: sphere, centre_mm: [0.0, -40.0, 10.0], radius_mm: 8.0, material: opaque}\n"
    )
    with_support(tmp_path, text, plan=DEEP)
    arguments = ["acquire", str(tmp_path / "plan.yaml"), "--bench", str(tmp_path / "bench.yaml"), "--dry-run"]
    assert main([*arguments, "--simulate"]) == DONE


def test_a_bench_that_cannot_be_misaligned_is_refused(tmp_path, mocker):
    bench, plan = load(tmp_path, DEEP)
    mocker.patch("sim.arranged.true_scene", side_effect=SceneError("the bodies stand too close; move them apart"))
    with pytest.raises(PlanError, match="cannot be set up: the bodies stand too close"):
        check_views(bench, plan.steps)


# Frame sets: what is on disk is what is said to be there.


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    return make_frames("two_spheres_500", 504, 3, tmp_path_factory.mktemp("demo"), sensor=SILENT, samples=3)


def test_folder_holds_the_whole_set(frames):
    targets = ["clear_z+10mm", "clear_z+20mm", "clear_z-10mm", "clear_z-20mm", "clear"]
    targets += ["glass_z-10mm", "glass_z-20mm", "glass"]
    wanted = {f"target_{t}" for t in targets} | {f"particles_{v}_{ab}" for v in ("clear", "glass") for ab in "ab"}
    assert set(frames.kinds) == wanted
    names = {path.name for path in frames.folder.iterdir()}
    assert names == {f"{kind}.tif" for kind in wanted} | {"scene.yaml", "truth.yaml", "frames.json"}
    image = frames.frame("target_glass")
    assert (image.shape, image.dtype) == ((504, 504), np.uint16)
    with tifffile.TiffFile(frames.path("target_glass")) as file:
        assert file.pages[0].compression == tifffile.COMPRESSION.ADOBE_DEFLATE


def test_truth_is_hidden_and_read_back(frames):
    again = load_frames(frames.folder)
    assert again == frames
    assert frames.nominal.content_hash() == at_size(demo_scene("two_spheres_500"), 504).content_hash()
    assert frames.truth.content_hash() == misalign(frames.nominal, 3).content_hash()
    assert frames.truth.content_hash() != frames.nominal.content_hash()


@pytest.mark.parametrize("kind", ["clear", "clear_z+10mm", "clear_z-20mm"])
def test_board_corners_lie_where_the_true_camera_projects_them(frames, kind):
    z = float(kind.removeprefix("clear_z").removesuffix("mm")) if "z" in kind else 0.0
    i, j = np.mgrid[-20:21:3, -20:21:3]
    corners = np.stack((2.5 * i, 2.5 * j, np.full(i.shape, z)), axis=-1).reshape(-1, 3)
    expected = frames.truth.camera.project(corners).astype(np.float32)
    image = frames.frame(f"target_{kind}").astype(np.float32)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    found = cv2.cornerSubPix(image, expected.reshape(-1, 1, 2).copy(), (2, 2), (-1, -1), stop).reshape(-1, 2)
    assert np.abs((found - expected).mean(axis=0)).max() < 0.01
    assert (found - expected).std() < 0.09  # cornerSubPix itself: 0.07 px at 8 px a square, whatever the sampling


def test_particles_move_fourteen_pixels_to_the_north_east(frames):
    a, b = (frames.frame(f"particles_clear_{ab}").astype(np.float32)[40:-40, 40:-40] for ab in "ab")
    (right, down), _ = cv2.phaseCorrelate(a, b)
    assert np.hypot(right, down) == pytest.approx(14.0, abs=0.1)
    assert right == pytest.approx(-down, abs=0.1)
    scale = frames.truth.camera.focal_px / frames.truth.camera.position_mm[2]
    assert np.hypot(*frames.shift_mm) * scale == pytest.approx(14.0, abs=0.05)


def test_a_set_repeats_and_replaces(tmp_path):
    one = make_frames("pair_off_axis", 64, 1, tmp_path / "one", stack=False, samples=2)
    make_frames("pair_off_axis", 64, 2, tmp_path / "two", stack=False, samples=2)
    two = make_frames("pair_off_axis", 64, 1, tmp_path / "two", stack=False, samples=2)
    for kind in one.kinds:
        assert np.array_equal(one.frame(kind), two.frame(kind))
    a, clear = one.frame("target_glass"), one.frame("target_clear")
    assert not np.array_equal(a[:10], clear[:10])  # each frame has noise of its own


@pytest.mark.parametrize("name", sorted(SCENES))
def test_misalignment_is_small_legal_and_everywhere(name):
    nominal = demo_scene(name)
    for seed in range(8):
        truth = misalign(nominal, seed)
        for before, after in zip(nominal.spheres, truth.spheres, strict=True):
            step = np.abs(np.subtract(after.centre_mm, before.centre_mm))
            assert 0.0 < step.max() < 0.8
            assert after.radius_mm == before.radius_mm
        assert 0.0 < np.abs(np.subtract(truth.camera.position_mm, nominal.camera.position_mm)).max() < 0.61
        turn = nominal.camera.rotation_matrix @ truth.camera.rotation_matrix.T
        assert 1e-5 < np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)) < 0.006
        assert truth.camera.focal_px == nominal.camera.focal_px
    barrel = misalign(nominal, 1, barrel=0.018).camera
    edge = barrel.ideal([(barrel.principal_px[0] + 1007.5, barrel.principal_px[1])])[0, 0] - barrel.principal_px[0]
    assert edge == pytest.approx(1007.5 * 1.018)


def test_size_keeps_the_field_of_view():
    full, half = demo_scene("tilted").camera, at_size(demo_scene("tilted"), 1008).camera
    # The outer edges of the sensor, half a pixel outside the outermost centres.
    for whole, part in ((-0.5, -0.5), (2015.5, 1007.5)):
        assert half.directions((part, part)) == pytest.approx(full.directions((whole, whole)), abs=1e-14)


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(SceneError, match="two_spheres_500"):
        demo_scene("nowhere")
