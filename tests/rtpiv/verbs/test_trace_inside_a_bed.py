"""`rtpiv trace` between the balls of a bed: its first figure is the share of the gaps that is seen."""

import re
from dataclasses import replace

import numpy as np
import pytest

from correction.fitted.prepared import prepare
from correction.maps.correction_map import build_correction_map
from correction.node_status import NodeStatus
from daq.bench.scene_plausibility import scene_questions
from daq.errors import RunUsageError
from ground.errors import ConfigError
from ground.terminal import console
from rtpiv.analysis.gaps import gap_share, share_of_scene
from rtpiv.analysis.pictures.before_after import before_after
from rtpiv.analysis.report.page import Page, through_lead
from rtpiv.verbs.calibrate import calibrate
from rtpiv.verbs.check import check, check_files
from rtpiv.verbs.show import say_through, show_through
from rtpiv.verbs.trace import trace
from tests.correction.small_scenes import EXAMPLES
from tests.slow_cases import slow
from tests.tracer.scenes import ball, camera_at
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_scene
from tracer.strategies.ray_map import build_ray_map

R, CELL = 20.0, 46.2


@pytest.mark.parametrize(
    ("name", "low", "high"), [slow("inside_a_bed", 0.999, 1), ("inside_a_bed_deeper", 0.08, 0.1)]
)
def test_by_hand_all_of_the_top_layer_and_nine_per_cent_below_it(name, low, high, capsys):
    traced = trace(load_scene(EXAMPLES / f"{name}.yaml"), pictures=False)
    assert traced.gaps is not None
    assert low <= traced.gaps.share <= high
    assert capsys.readouterr().out.startswith("inside a bed: ")


@pytest.mark.slow
def test_a_packed_tube_is_lit_along_its_axis():
    """Twenty balls in rings of four: few gaps are seen, and what is left is right mirrored."""
    gaps = trace(load_scene(EXAMPLES / "packed_tube.yaml"), pictures=False).gaps
    assert 0.1 < gaps.share < 0.12
    assert 0.06 < gaps.lit.both_mm2 / gaps.gas_mm2 < 0.075
    sides = {side.name: side for side in gaps.lit.balls}
    for right, left in (("b11", "b13"), ("b31", "b33"), ("b51", "b53")):
        assert sides[right].lit == pytest.approx(sides[left].lit, abs=0.02)
        assert abs(sides[right].height_mm) < 0.01


def test_the_gaps_are_those_of_discs():
    """Nine discs of a square lattice, all in view: their hull less their areas, and lines of sight over it."""
    balls = [ball(f"b{i}{j}", i * CELL, j * CELL, 0.0, R) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    scene = Scene(camera_at((0.0, 0.0, 2000.0), focal_px=8000.0, sensor_px=(640, 640)), tuple(balls))
    gaps = gap_share(scene, build_correction_map(scene, build_ray_map(scene)))
    hull = (2.0 * CELL) ** 2 + 4.0 * 2.0 * CELL * R + np.pi * R**2
    assert gaps.gas_mm2 == pytest.approx(hull - 9.0 * np.pi * R**2, rel=0.01)
    assert gaps.glass == pytest.approx(9.0 * np.pi * R**2 / 160.0**2, rel=0.01)
    assert gaps.share > 0.99


def test_one_ball_and_balls_before_the_plane_have_no_gaps():
    for z in (0.0, 20.0):
        scene = Scene(camera_at(focal_px=1000.0, sensor_px=(64, 64)), (ball("one", 0.0, 0.0, z, R),))
        assert gap_share(scene, build_correction_map(scene, build_ray_map(scene))) is None


def asked(tmp_path, *heights_mm):
    """Questions of `check` about balls of 10 mm in a row, at these heights."""
    balls = [
        f"  - {{name: b{n}, kind: sphere, centre_mm: [{25.0 * n}, 0.0, {z}], radius_mm: 10.0, material: N-BK7}}"
        for n, z in enumerate(heights_mm)
    ]
    camera = "camera: {f_mm: 100.0, L_mm: 900.0, pixel_pitch_um: 11.0, sensor_px: [1008, 1008]}"
    (tmp_path / "scene.yaml").write_text("\n".join(["wavelength_nm: 532.0", camera, "bodies:", *balls]))
    return " ".join(scene_questions(tmp_path / "scene.yaml"))


def test_a_wrong_sign_of_z_is_asked_about(tmp_path):
    assert "all stand behind the plane z = 0" in asked(tmp_path, -10.0, -10.0)
    assert "b1: reaches 15 mm through the plane, as no other ball does" in asked(tmp_path, 10.0, -5.0)
    assert "plane" not in asked(tmp_path, 10.0, 10.0)
    assert "plane" not in asked(tmp_path, 0.0, 0.0)
    assert "plane" not in asked(tmp_path, 2.0)


BED = """
wavelength_nm: 532.0
camera: {f_mm: 100.0, L_mm: 900.0, pixel_pitch_um: 88.0, sensor_px: [126, 126]}
bodies:
"""
FROM_LEFT = "thickness_mm: 1.0, sources: [{from_deg: 180.0, width_mm: 150.0}]"


def bed(tmp_path, sheet, radius=R, height=0.0):
    """Nine balls whose centres lie so high over the board, and a light sheet."""
    balls = [
        f"  - {{name: b{i}{j}, kind: sphere, centre_mm: [{i * CELL}, {j * CELL}, {height}], radius_mm: {radius},"
        " material: N-BK7}"
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
    ]
    path = tmp_path / "scene.yaml"
    path.write_text(BED + "\n".join(balls) + f"\nsheet: {{{sheet}}}\n")
    return path


def test_lit_and_seen_comes_first(tmp_path, capsys, monkeypatch):
    path = bed(tmp_path, FROM_LEFT)
    path.write_text(path.read_text() + "fit: {contact_mm: 0.02}\n")
    monkeypatch.setattr("rtpiv.verbs.trace.MOST_FORECAST_BALLS", 8)
    traced = trace(path, pictures=False)
    lit = traced.gaps.lit
    assert 0.4 < lit.both_mm2 / traced.gaps.gas_mm2 < 0.8
    assert traced.share.areas_mm2[NodeStatus.DARK] > 100.0
    assert 0.2 < lit.reflected < 0.3  # three balls in a row reflect 8 % each, and more at their rims
    sides = {side.name: side for side in lit.balls}
    assert sides["b10"].lit > sides["b-10"].lit > 0.2  # behind the bed the light of three lenses
    out = capsys.readouterr().out
    assert "of the gaps is lit and seen" in out
    assert "gas within 0.25 R of each ball" in out
    assert "for up to 8 balls in contact, not for 9" in " ".join(out.split())


def test_the_sheet_in_the_bed_is_shown_and_not_the_board(tmp_path, capsys):
    """Balls 30 mm over the board: with the sheet at 30 mm the gaps are those of balls in the plane."""
    behind = trace(bed(tmp_path, "z_mm: 30.0", height=30.0), pictures=False)
    assert "the light sheet at z = +30.000" in capsys.readouterr().out
    (tmp_path / "plane").mkdir()
    plane = trace(bed(tmp_path / "plane", "z_mm: 0.0"), pictures=False)
    assert behind.gaps.share == pytest.approx(plane.gaps.share, abs=0.01)
    assert behind.gaps.lit is None
    assert trace(bed(tmp_path, "z_mm: 0.2", height=30.0), pictures=False).gaps is None


def test_verbs_of_vectors_begin_with_the_gaps_that_are_lit_and_seen(tmp_path, capsys):
    scene = load_scene(bed(tmp_path, f"z_mm: 30.0, {FROM_LEFT}", height=30.0))
    show_through(console(), scene)
    out = capsys.readouterr().out
    assert out.startswith("inside a bed: ")
    assert "of the gaps is lit and seen" in out
    page, lit = Page("bed"), scene.in_light_sheet()
    frame = np.arange(126 * 126, dtype=np.uint16).reshape(scene.camera.shape)
    corrector = prepare(lit).corrector
    through_lead(page, before_after(frame, corrector(frame), corrector, lit, 65535.0).through, lit, 0.5)
    first = re.search("<b>(.*?) %</b><span>(.*?)<", page.html())
    assert first is not None
    assert first[2] == "of the gaps is lit and seen"
    assert f"inside a bed: {first[1]} % of the gaps" in out
    say_through(console(), share_of_scene(scene), scene)
    assert capsys.readouterr().out == out
    assert f"; {out.strip()}" in " ".join(check_files([tmp_path / "scene.yaml"])[0].said.split())


def test_a_correction_leaves_the_dark_out(tmp_path):
    scene = load_scene(bed(tmp_path, FROM_LEFT))
    lit, even = prepare(scene.in_light_sheet()), prepare(replace(scene, sheet=None))
    assert lit.content_key != even.content_key
    status = lit.corrector.status
    assert (status == NodeStatus.DARK).sum() > 500
    assert (even.corrector.status[status == NodeStatus.DARK] == NodeStatus.RECOVERED).all()
    written = tmp_path / "again.yaml"
    written.write_text(dump_scene(scene))
    assert load_scene(written).sheet == scene.sheet


ASIDE = "L_mm: 900.0, position_mm: [0, 60, 900], look_at_mm: [0, 60, 0]"
BALL = "  - {name: whole, kind: sphere, centre_mm: [0, 0, 150], radius_mm: 100.0, material: N-BK7}"
TUBE = (
    "  - {name: t, kind: tube, start_mm: [-99, 0, 90], end_mm: [99, 0, 90], outer_radius_mm: 90.0,"
    " inner_radius_mm: 20.0, material: N-BK7}"
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{BED}{BALL}\nsheet: {{z_mm: 150.0}}\n", "lies inside body 'whole'"),
        (f"{BED}{BALL}\nsheet: {{z_mm: 150.0, {FROM_LEFT}}}\n", "lies inside body 'whole'"),
        (f"{BED}{TUBE}\nsheet: {{z_mm: 145.0}}\n", "lies inside body 't'"),
        (
            BED.replace("L_mm: 900.0", ASIDE) + f"{BALL}\nsheet: {{{FROM_LEFT.replace('150.0', '1.0')}}}\n",
            "never reaches the view",
        ),
        (f"{BED}{BALL}\nsheet: {{{FROM_LEFT.replace('thickness_mm: 1.0, ', '')}}}\n", "and no thickness_mm"),
        (
            f"{BED}{BALL}\nsheet: {{z_mm: 60.0, {FROM_LEFT.replace('150.0', '2.0, fan_deg: 4.0')}}}\n",
            "inside body 'whole', by its width_mm",
        ),
    ],
)
def test_light_that_cannot_be_is_refused_by_every_verb(tmp_path, text, words):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    for verb in (trace, check, lambda file: calibrate(tmp_path, scene=file)):
        with pytest.raises((ConfigError, RunUsageError), match=words) as refused:
            verb(path)
        assert len(str(refused.value).splitlines()) == 1


def test_a_tube_seen_along_its_axis_has_gas_in_its_middle(tmp_path):
    """All four corners of the view lie in its wall."""
    tube = TUBE.replace("[-99, 0, 90], end_mm: [99, 0, 90]", "[0, 0, -30], end_mm: [0, 0, 60]")
    path = tmp_path / "scene.yaml"
    path.write_text(f"{BED}{tube}\nsheet: {{z_mm: 30.0}}\n".replace("20.0, material", "40.0, material"))
    assert load_scene(path).in_light_sheet().bodies[0].lowest_mm == -60.0
