"""Slips of the pen that a configuration file answers with the cure."""

from pathlib import Path

import pytest

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
