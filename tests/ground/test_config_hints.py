"""Slips of the pen that a configuration file answers with the cure."""

from pathlib import Path

import pytest

from daq.bench.bench_file import load_bench
from daq.plans.plan import read_plan
from ground.errors import ConfigError
from tracer.scene.scene_file import load_scene

SCENE = """\
camera: {f_mm: 60.0, L_mm: 500.0, pixel_pitch_um: 11.0, sensor_px: [2016, 2016]}
bodies:
  - {kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: acrylic}
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("radius_mm: 25.0", 'radius_mm: "20,5"', "should be a number, not '20,5'; write a decimal point: 20.5"),
        ("radius_mm: 25.0", "radius_mm: 20,5", "radius_mm: 20,5: a decimal comma? write a decimal point: 20.5"),
        ("f_mm: 60.0", "f_mm: 60,05", "f_mm: 60,05: a decimal comma? write a decimal point: 60.05"),
        ("[0.0, 0.0, 25.0]", "[0,0, 0,0, 25,5]", "three entries, not 6; a decimal comma? write points"),
        ("material: acrylic", "material: 1.5", "; an index is written {n: 1.5}"),
        ("radius_mm: 25.0", "diameter_mm: 50.0", "'bodies.1.diameter_mm'; give radius_mm, which is half"),
    ],
)  # fmt: skip
def test_the_cure_is_said(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        load_scene(path)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("load", "given", "words"),
    [
        (
            load_scene,
            "bench",
            "this is a bench file; a scene file is wanted here, and scene.yaml beside it is one",
        ),
        (load_scene, "plan", "this is a plan file; a scene file is wanted here"),
        (load_bench, "scene", "this is a scene file; a bench file is wanted here"),
        (load_bench, "plan", "this is a plan file; a bench file is wanted here"),
        (read_plan, "scene", "this is a scene file; a plan file is wanted here"),
        (read_plan, "bench", "this is a bench file; a plan file is wanted here"),
    ],
)
def test_a_file_of_another_kind_is_told_as_such(tmp_path, load, given, words):
    """And nothing of the dozen keys that it has not."""
    text = {"bench": "name: lab\nscene: scene.yaml\nstages: {}\n", "plan": "experiment: shift\n", "scene": SCENE}
    path = tmp_path / f"{given}.yaml"
    path.write_text(text[given])
    if given == "bench":
        (tmp_path / "scene.yaml").write_text(SCENE)
    with pytest.raises(ConfigError) as caught:
        load(path)
    assert str(caught.value) == f"{path}: {words}"
