"""Supports on the simulated bench: what they hide, bodies beside the sheet, what cannot be drawn said at once."""

import re

import numpy as np
import pytest

from daq.errors import PlanError
from daq.plans.forecast import check_views
from rtpiv.command_line.cli import DONE, USAGE, main
from sim.renderer.patterns import Chessboard, Pose, place
from sim.renderer.render import render_irradiance, tables_of
from tests.daq.small_bench import load
from tracer.bodies import Rod, Sphere
from tracer.camera import Camera, look_at
from tracer.errors import SceneError
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

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
