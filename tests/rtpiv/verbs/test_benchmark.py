"""`rtpiv benchmark` is the project's benchmark, run on one scene."""

import json
import shutil
import sys
from pathlib import Path

import pytest

from rtpiv.command_line.cli import DEVICE, DONE, USAGE, main

SCENE = """
wavelength_nm: 532.0
camera: {f_mm: 60.0, L_mm: 500.0, pixel_pitch_um: 220.0, sensor_px: [100, 100]}
bodies:
  - {name: near, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: N-BK7}
"""


@pytest.mark.slow
def test_table_and_picture(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE)
    assert main(["benchmark", str(tmp_path / "scene.yaml"), "-o", str(tmp_path / "out"), "--rounds", "2"]) == DONE
    report = json.loads((tmp_path / "out" / "benchmark.json").read_text())
    row = report["scenes"][0]
    assert row["scene"] == "scene"
    assert row["contenders"]["rtpiv"]["error_um"]["centre"]["max_um"] < 1e-9
    assert {"ray_map", "correction_map", "quintic"} <= row["contenders"]["rtpiv"]["tasks"].keys()
    assert row["limit_ms"]["arithmetic"] > 0.0
    assert report["growth"]["memory_bytes_px"]["ray map, kept"] < 20.0
    assert (tmp_path / "out" / "benchmark.png").stat().st_size > 10_000


def test_what_goes_wrong_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE.replace("f_mm: 60.0", "f_mm: wide"))
    assert main(["benchmark", str(scene)]) == USAGE
    assert "scene.yaml:3" in capsys.readouterr().err
    scene.write_text(SCENE)
    monkeypatch.setattr(sys, "executable", shutil.which("false"))
    assert main(["benchmark", str(scene), "-o", str(tmp_path / "out")]) == DEVICE
    assert "benchmark stopped" in capsys.readouterr().err
