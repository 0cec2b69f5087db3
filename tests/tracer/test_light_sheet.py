"""The scene as seen in a light sheet, against rays of the scene as it stands, carried to the tilted plane."""

from dataclasses import replace

import numpy as np
import pytest

from ground.errors import ConfigError
from tests.correction.small_scenes import EXAMPLES, small_scene
from tracer.bodies import Rod, translate_by
from tracer.errors import SceneError
from tracer.light_sheet import LightSheet
from tracer.scene.scene_file import dump_scene, load_scene
from tracer.strategies.sensitivity import TargetPose, landings
from tracer.strategies.trace import trace

SHEET = LightSheet(-0.3, 0.7, -1.1, 0.02, 0.03, (0.3, -0.2, 0.1), 1.2)


@pytest.fixture(scope="module")
def scene():
    return replace(small_scene("tilted_pair", 252), sheet=SHEET)


def test_rays_end_on_the_sheet(scene):
    rng = np.random.default_rng(1)
    pixels = rng.uniform(0.0, 251.0, (2000, 2))
    seen = trace(scene.in_light_sheet(), pixels)
    pose = TargetPose((0.0, 0.0, SHEET.z_mm), tuple(map(tuple, SHEET.axes())))
    wanted = landings(scene, pixels, pose)
    assert np.array_equal(seen.recovered, wanted.recovered)
    np.testing.assert_allclose(seen.plane_mm, wanted.point_mm, rtol=1e-9, atol=1e-9)
    world = pose.to_world(seen.plane_mm[seen.recovered])
    np.testing.assert_allclose(world[:, 2], SHEET.height_mm(world[:, 0], world[:, 1]), atol=1e-8)
    rise = SHEET.height_mm(np.array([10.0, 0.0]), np.array([0.0, 10.0])) - SHEET.z_mm
    np.testing.assert_allclose(rise, 10.0 * np.tan(np.deg2rad([0.7, -1.1])), rtol=1e-12)
    # Coordinates on the sheet are nearly the world's.
    near = np.abs(world).max(axis=1) < 100.0
    np.testing.assert_allclose(seen.plane_mm[seen.recovered][near], world[near, :2], atol=0.03)


def test_the_target_does_not_know_of_the_sheet(scene):
    plain = replace(scene, sheet=None)
    assert scene.content_hash() == plain.content_hash()
    assert scene.in_light_sheet().content_hash() != plain.content_hash()
    assert plain.in_light_sheet() is plain
    level = replace(scene, sheet=LightSheet()).in_light_sheet()
    pixels = np.random.default_rng(2).uniform(0.0, 251.0, (500, 2))
    assert np.array_equal(trace(level, pixels).rays, trace(plain, pixels).rays)
    assert level.content_hash() == plain.content_hash()


def test_a_scene_file_keeps_its_sheet(scene, tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(dump_scene(scene))
    assert load_scene(path).sheet == SHEET
    path.write_text(dump_scene(replace(scene, sheet=None)))
    assert "sheet" not in path.read_text()
    assert load_scene(path).sheet is None


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("z: 0.1", "z"),
        ("tilt_x_deg: 40.0", "30"),
        ("sigma_mm: -0.1", "sigma_mm"),
        ("thickness_mm: 0.0", "thickness_mm"),
        ("correlation: [0.9, 0.9, -0.9]", "contradict"),
        ("z_mm: 600.0", "behind the camera"),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(section, said, tmp_path):
    path = tmp_path / "scene.yaml"
    lines = (EXAMPLES / "two_spheres_500.yaml").read_text() + f"\nsheet: {{{section}}}\n"
    path.write_text(lines)
    with pytest.raises(ConfigError, match=said) as refused:
        load_scene(path)
    last = len(lines.rstrip().splitlines())
    assert [problem.line for problem in refused.value.problems] == [last]


def test_the_sheet_may_run_through_balls_and_not_through_a_rod():
    scene = small_scene("two_spheres_500", 252)  # its first ball touches the target's plane
    touching = replace(scene, sheet=LightSheet(0.4)).in_light_sheet()
    assert touching.spheres[0].lowest_mm == pytest.approx(-0.4)
    through = replace(scene, sheet=LightSheet(1.4))
    (cut,) = through.in_light_sheet().spheres_in_plane
    assert (cut.name, cut.lowest_mm) == ("near", pytest.approx(-1.4))
    rod = Rod("rod", (40.0, 0.0, 2.0), (60.0, 0.0, 2.0), 2.0)
    with pytest.raises(SceneError, match=r"runs through 'rod' \(1.4 mm deep\)"):
        through.with_bodies([*through.bodies, rod]).in_light_sheet()
    free = through.with_bodies([body.moved(translate_by((0.0, 0.0, 4.0))) for body in through.bodies])
    assert free.in_light_sheet().spheres[0].lowest_mm == pytest.approx(2.6)
