"""The second test of the paper on the supplied frames, by one command each."""

import json
import shutil

import numpy as np
import pytest
from scipy.io import netcdf_file

from rtpiv.analysis.pairs.evaluation import PairDetails
from rtpiv.command_line.cli import DONE, main
from rtpiv.verbs.evaluate import EvaluationOutput, evaluate
from tests.supplied import FRAMES, NOMINAL, ROOT, supplied
from tracer.scene.scene_file import dump_scene

VALID = {"two_spheres": 11_000, "one_sphere": 4_100}  # as in the paper, where a support hid part of the view


def check(found, name):
    """R11: std <= 0.10 px behind glass, <= 0.05 px beside it, bias <= 0.02 px; R12: vectors of 125 x 125 nodes."""
    assert found.shift is not None
    direct, middle = found.shift.regions["seen directly"], found.shift.regions["behind glass, r < 0.75 R"]
    assert max(direct.std_px) <= 0.05
    assert max(middle.std_px) <= 0.10
    assert max(np.abs((*direct.bias_px, *middle.bias_px))) <= 0.02
    assert found.shift.valid >= VALID.get(name, 0)
    assert found.field.counts["rejected"] + found.field.counts["replaced"] < 0.01 * found.shift.valid


@pytest.mark.parametrize("name", ["two_spheres", pytest.param("one_sphere", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_shift_behind_the_glass_with_the_true_scene(name, tmp_path):
    frames = supplied(name)
    (tmp_path / "scene.yaml").write_text(dump_scene(frames.truth))
    pair = [frames.path(f"particles_glass_{letter}") for letter in "ab"]
    (found,) = evaluate(
        pair,
        tmp_path / "out",
        tmp_path / "scene.yaml",
        details=PairDetails(frames.shift_mm),
        output=EvaluationOutput(vtk=True, figures=True),
    ).details
    check(found, name)
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"vectors.nc", "vectors.vtk", "evaluation.json", "report.html", "vectors.svg", "vectors.png"} <= names
    summary = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert summary["scene_hash"] == frames.truth.content_hash()
    assert found.map_sigma is None
    assert summary["no_map_sigma"].startswith("there is no fit")


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["two_spheres", "one_sphere"])
def test_shift_behind_the_glass_with_the_fitted_scene(name, tmp_path):
    """From the target's frames to the report, nothing known but the nominal scene."""
    frames = supplied(name)
    (tmp_path / "target").mkdir()
    for path in (FRAMES / name).glob("target_*.tif"):
        shutil.copy(path, tmp_path / "target")
    scene, fit = ROOT / "examples" / f"{NOMINAL[name]}.yaml", tmp_path / "fit"
    assert main(["calibrate", str(tmp_path / "target"), "--scene", str(scene), "-o", str(fit)]) == DONE
    pair = [frames.path(f"particles_glass_{letter}") for letter in "ab"]
    (found,) = evaluate(pair, tmp_path / "out", fit / "scene.yaml", details=PairDetails(frames.shift_mm)).details
    check(found, name)
    with netcdf_file(tmp_path / "out" / "vectors.nc", mmap=False) as file:
        place, way = (np.nanmedian(file.variables[f"map_sigma_{axis}"][:]) for axis in "xu")
    assert 0.0 < way < 0.2 * place < 0.01
