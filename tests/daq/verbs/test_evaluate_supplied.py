"""The second test of the paper on the supplied frames, by one command."""

import json

import numpy as np
import pytest

from daq.verbs.evaluate import evaluate
from tests.supplied import supplied
from tracer.scene_file import dump_scene


@pytest.mark.parametrize("name", ["two_spheres", "one_sphere"])
def test_shift_behind_the_glass(name, tmp_path):
    """R11 with the true scene: std <= 0.10 px behind the glass, <= 0.05 px beside it, bias <= 0.02 px."""
    frames = supplied(name)
    (tmp_path / "scene.yaml").write_text(dump_scene(frames.truth))
    pair = [frames.path(f"particles_glass_{letter}") for letter in "ab"]
    (found,) = evaluate(pair, tmp_path / "out", tmp_path / "scene.yaml", shift_mm=frames.shift_mm, vtk=True)
    assert found.shift is not None
    direct, middle = found.shift.regions["seen directly"], found.shift.regions["behind glass, r < 0.75 R"]
    assert max(direct.std_px) <= 0.05
    assert max(middle.std_px) <= 0.10
    assert max(np.abs((*direct.bias_px, *middle.bias_px))) <= 0.02
    assert found.field.counts["rejected"] + found.field.counts["replaced"] < 0.01 * found.shift.valid
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"vectors.nc", "vectors.vtk", "evaluation.json", "report.html", "vectors.svg", "rings.svg"} <= names
    summary = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert summary["scene_hash"] == frames.truth.content_hash()
