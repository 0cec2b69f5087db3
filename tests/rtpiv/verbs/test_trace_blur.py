"""`rtpiv trace` of a scene with an aperture: the depth of field of the real scene, in numbers and a picture."""

import matplotlib.image
import pytest

from rtpiv.verbs.trace import trace

SCENE = """
camera: {f_mm: 60.0, L_mm: 500.0, pixel_pitch_um: 140.0, sensor_px: [120, 120], f_number: 11.0}
bodies:
  - {name: ball, kind: sphere, centre_mm: [0.0, 0.0, 26.0], radius_mm: 25.0, material: {n: 1.5}}
"""


@pytest.mark.slow
@pytest.mark.draws
def test_the_blur_is_said_and_drawn(tmp_path, capsys):
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE, encoding="utf-8")
    trace(scene, tmp_path / "out")
    assert "blur behind glass" in capsys.readouterr().out
    assert matplotlib.image.imread(tmp_path / "out" / "blur.png").std() > 0.05
