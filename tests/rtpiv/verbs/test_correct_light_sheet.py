"""Which frames are corrected in the light sheet, and which in the plane of the target."""

import json
from dataclasses import replace

import numpy as np
import pytest

from correction.fitted.scene_sigma import KIND
from correction.light_sheet.disparities import BLOCKS
from daq.runs.names import FILE
from daq.runs.run_views import shows_light_sheet
from ground.map_file import save_arrays
from piv.errors import FrameError
from piv.files.frame_file import write_frame
from rtpiv.analysis.series.series_input import tasks_of
from rtpiv.verbs.correct import correct
from tests.correction.small_scenes import small_scene
from tests.daq.small_run import about_run, planned
from tracer.light_sheet import LightSheet
from tracer.scene.scene_file import dump_scene
from tracer.strategies.sensitivity import CAMERA, SPHERE


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A scene with a sheet, its file, and two frames of particles."""
    folder = tmp_path_factory.mktemp("lab")
    scene = replace(small_scene("two_spheres_500", 126), sheet=LightSheet(-0.25, 0.3))
    (folder / "scene.yaml").write_text(dump_scene(scene))
    for name in "ab":
        frame = np.random.default_rng(7).integers(0, 200, scene.camera.shape).astype(np.uint8)
        write_frame(folder / f"{name}.tif", frame, 1.0, {})
    return scene, folder


def test_frames_of_no_run_show_particles_and_checked_ones_the_target(lab, tmp_path, capsys):
    scene, folder = lab
    correct([folder / "a.tif"], folder / "scene.yaml", tmp_path / "sheet")
    assert "z = -0.250 +- 0.5 mm" in " ".join(capsys.readouterr().out.split())
    said = json.loads((tmp_path / "sheet" / "correction.json").read_text())
    assert said["scene_hash"] == scene.in_light_sheet().content_hash()
    correct([folder / "a.tif"], folder / "scene.yaml", tmp_path / "target", check_target=True)
    said = json.loads((tmp_path / "target" / "correction.json").read_text())
    assert said["scene_hash"] == scene.content_hash()


@pytest.mark.parametrize("shows", ["particles", "target"])
def test_a_sheet_without_a_word_is_said_once_of_frames_that_show_particles(lab, tmp_path, capsys, shows):
    scene, _ = lab
    (tmp_path / "scene.yaml").write_text(dump_scene(replace(scene, sheet=None)))
    rows, columns = np.indices(scene.camera.shape)
    bright = (rows // 9 + columns // 9) % 2 if shows == "target" else (rows % 7 == 0) & (columns % 5 == 0)
    for name in "ab":
        write_frame(tmp_path / f"{name}.tif", (20 + 150 * bright).astype(np.uint8), 1.0, {})
    correct([tmp_path / "a.tif", tmp_path / "b.tif"], tmp_path / "scene.yaml", tmp_path / "out", pictures=False)
    said = " ".join(capsys.readouterr().out.split())
    assert (
        said.count("does not say where the light sheet is") == said.count("rtpiv sheet") == (shows == "particles")
    )
    assert (f"from {BLOCKS} pairs or more" in said) == (shows == "particles")  # what `sheet` asks for


def test_two_frames_are_measured_in_the_sheet_and_say_so(lab, tmp_path):
    scene, folder = lab
    (task,) = tasks_of([folder / "a.tif", folder / "b.tif"], tmp_path, folder / "scene.yaml").tasks
    assert task.scene.content_hash() == scene.in_light_sheet().content_hash()
    assert "z = -0.250" in task.note


@pytest.mark.parametrize(("shift_mm", "columns"), [(None, 3), ((0.5, 0.0), 0)])
def test_a_sheet_without_a_word_is_unsure_where_particles_are_lit_by_it(lab, tmp_path, shift_mm, columns):
    """Two frames of a flow; but what was moved by a known way is printed on the board."""
    scene, folder = lab
    silent = replace(scene, sheet=None)
    (tmp_path / "scene.yaml").write_text(dump_scene(silent))
    header = {
        "names": [],
        "scene_hash": silent.content_hash(),
        "nominal_hash": silent.content_hash(),
        "history": [],
    }
    root = np.zeros((len(CAMERA) + len(SPHERE) * len(scene.spheres), 1))
    save_arrays(tmp_path / "fit.npz", KIND, header, {"scene_root": root})
    frames = [folder / "a.tif", folder / "b.tif"]
    given = tasks_of(frames, tmp_path, tmp_path / "scene.yaml", shift_mm=shift_mm)
    assert given.sigma.plane_root.shape == (6, columns)
    (task,) = given.tasks
    assert ("rtpiv sheet" in task.note) == (shift_mm is None)
    assert ("+- 0.5 mm" in task.note) == (shift_mm is None)


@pytest.mark.parametrize(
    ("step", "is_lit"),
    [({}, False), ({"group": 2}, True), ({"dt_us": 500.0}, True), ({"dt_us": 500.0, "group": 2}, True)],
)
def test_a_run_knows_what_its_frames_show(step, is_lit, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "daq.runs.run_views.run_of",
        lambda path: None if path.name == "alone.tif" else _Run(path.parent, [planned(0) | step]),
    )
    frames = [tmp_path / "frames" / "000000.tif"]
    assert shows_light_sheet(frames) is is_lit
    mixed = [*frames, tmp_path / "alone.tif"]
    if is_lit:
        assert shows_light_sheet(mixed)
    else:
        with pytest.raises(FrameError, match="correct them apart"):
            shows_light_sheet(mixed)


class _Run:
    def __init__(self, path, steps):
        self.path, self.about = path / FILE, about_run(steps)
