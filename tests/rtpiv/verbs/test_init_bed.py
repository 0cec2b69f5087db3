"""`rtpiv init` of a bed by its layers: the light sheet lies between the balls, the board hangs behind them."""

from itertools import combinations

import numpy as np
import pytest

from daq.bench.bench_file import load_bench
from daq.bench.guards import sheet_clearances_mm
from daq.bench.scene_plausibility import scene_questions
from daq.errors import RunUsageError
from rtpiv.templates.files import scene_of
from rtpiv.templates.lab import Lab
from rtpiv.verbs.check import check
from rtpiv.verbs.init import GivenLab, init
from sim.demo.scenes import misalign
from tests.slow_cases import slow
from tracer.scene.scene_file import load_priors, load_scene


@pytest.mark.parametrize(
    ("shape", "balls", "plane"), [("bcc", 22, 1.5), ("hcp", 17, 2.0), slow("bcc", 22, 1.0), slow("sc", 27, 1.3)]
)
def test_a_bed_of_layers_has_its_sheet_between_the_balls(tmp_path, capsys, shape, balls, plane):
    bed = GivenLab(arrangement=shape, layers=3, plane=plane, ball_mm=30.0, lens_mm=16.0)
    init(tmp_path, bed, ask=False)
    assert "of the gaps is lit and seen" in capsys.readouterr().out
    scene = load_scene(tmp_path / "scene.yaml")
    assert len(scene.bodies) == balls
    heights = sorted({ball.centre_mm[2] for ball in scene.spheres})
    assert scene.sheet.z_mm == pytest.approx(heights[2] - (plane - 1.0) * (heights[2] - heights[1]), abs=0.01)
    centres = np.array([ball.centre_mm for ball in scene.spheres])
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1) + 1e3 * np.eye(balls)
    assert apart.min(axis=1) == pytest.approx(30.01, abs=1e-3)  # each in contact, but for a hundredth
    assert scene.sheet.sources
    assert scene.in_light_sheet().spheres_in_plane
    assert load_priors(tmp_path / "scene.yaml").contact_mm == 0.02
    bench = load_bench(tmp_path / "bench-flow.yaml")
    assert bench.table.simulation["flow"]["field"] == "between_balls"
    near = [mm for _, mm in sheet_clearances_mm(bench, bench.home_mm | {"target_z": -30.0})]
    assert min(near) >= bench.more["laser"].section.clear_mm


def test_a_packed_tube_has_its_sheet_down_its_axis():
    """Rings of four balls in contact within a tube; on the bench both are off as one."""
    lab = Lab(arrangement="tube", layers=5, plane=2.0, balls=20, ball_mm=15.0, gap_mm=5.0, lens_mm=50.0)
    scene = scene_of(lab)
    (tube,) = (body for body in scene.bodies if body.kind == "tube")
    assert scene.sheet.z_mm == pytest.approx(tube.start_mm[2])
    assert tube.capsule.start_mm[2] - tube.outer_radius_mm == pytest.approx(5.0, abs=0.01)
    balls = [ball for ball in scene.bodies if ball.kind == "sphere"]
    for placed in (scene, misalign(scene, 7, is_packed=True)):
        centres = np.array([ball.centre_mm for ball in placed.bodies if ball.kind == "sphere"])
        apart = np.linalg.norm(centres[:, None] - centres, axis=-1) + 1e3 * np.eye(len(balls))
        assert apart.min(axis=1) == pytest.approx(15.01, abs=1e-3)
        (wall,) = (body for body in placed.bodies if body.kind == "tube")
        start, way = np.array(wall.start_mm), np.subtract(wall.end_mm, wall.start_mm) / wall.length_mm
        off = centres - start
        far = np.linalg.norm(off - (off @ way)[:, None] * way, axis=1)
        assert far + 7.5 == pytest.approx(wall.inner_radius_mm - 0.2, abs=0.02)
    assert np.abs(np.subtract(wall.start_mm, tube.start_mm)).max() > 0.01


@pytest.mark.slow  # the scene and its bench: test_a_packed_tube_has_its_sheet_down_its_axis
def test_a_packed_tube_is_a_lab(tmp_path):
    init(tmp_path, GivenLab(arrangement="tube", layers=5, ball_mm=15.0, lens_mm=50.0, glass="N-BK7"), ask=False)
    assert len(load_scene(tmp_path / "scene.yaml").bodies) == 21
    assert not list(scene_questions(tmp_path / "scene.yaml"))


def test_layers_that_cannot_be(tmp_path):
    for wrong, said in (
        (GivenLab(plane=1.5), "give --layers too"),
        (GivenLab(layers=3, balls=9), "leave --balls out"),
        (GivenLab(layers=3, plane=4.0), "a plane from 1"),
        (GivenLab(layers=3, arrangement="behind"), "a bed has layers"),
        (GivenLab(arrangement="tube"), "give --layers"),
        (GivenLab(arrangement="tube", layers=5, plane=1.0), "down its axis"),
    ):
        with pytest.raises(RunUsageError, match=said):
            init(tmp_path / "bed", wrong, ask=False)


def test_balls_in_contact_are_accepted(tmp_path):
    """Contact written with four decimals overlaps by less than a tenth of a micrometre."""
    init(tmp_path, GivenLab(layers=3, plane=1.5, lens_mm=16.0), ask=False)
    text = (tmp_path / "scene.yaml").read_text()
    exact = {46.1996: 40.0 * 2.0 / 3.0**0.5, 23.0998: 40.0 / 3.0**0.5, 48.0998: 25.0 + 40.0 / 3.0**0.5}
    exact[71.1996] = 25.0 + 80.0 / 3.0**0.5
    for written, contact in exact.items():
        text = text.replace(f"{written:.4f}", f"{contact:.4f}")
    (tmp_path / "scene.yaml").write_text(text)
    centres = [ball.centre_mm for ball in load_scene(tmp_path / "scene.yaml").spheres]
    assert min(np.linalg.norm(np.subtract(a, b)) for a, b in combinations(centres, 2)) < 40.0001
    check([tmp_path / "scene.yaml"])
    assert not list(scene_questions(tmp_path / "scene.yaml"))
