"""The project's benchmark, run on one scene."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCENE = """
wavelength_nm: 532.0
camera: {f_mm: 60.0, L_mm: 500.0, pixel_pitch_um: 220.0, sensor_px: [100, 100]}
bodies:
  - {name: near, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: N-BK7}
"""


@pytest.mark.slow
def test_table_and_picture(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE)
    words = ["--scenes", str(tmp_path / "scene.yaml"), "-o", str(tmp_path / "out"), "--rounds", "2"]
    subprocess.run([sys.executable, "-m", "benchmarks", *words], check=True)
    report = json.loads((tmp_path / "out" / "benchmark.json").read_text())
    row = report["scenes"][0]
    assert row["scene"] == "scene"
    assert row["contenders"]["rtpiv"]["error_um"]["centre"]["max_um"] < 1e-9
    assert {"ray_map", "correction_map", "quintic"} <= row["contenders"]["rtpiv"]["tasks"].keys()
    assert row["limit_ms"]["arithmetic"] > 0.0
    assert report["growth"]["memory_bytes_px"]["ray map, kept"] < 20.0
    assert (tmp_path / "out" / "benchmark.png").stat().st_size > 10_000
