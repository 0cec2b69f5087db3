"""The project's benchmark, run on one scene."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.commands import PARTS, budget, compare

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


def test_commands_are_held_against_a_record_in_units_of_a_reference() -> None:
    def times(**used: float) -> dict[str, list[float]]:
        return {part: [9.0, used.get(part, 0.0)] for part in ("all", *PARTS)}

    now = budget({
        "reference": times(all=2.0), "trace": times(all=4.0, work=1.6, draw=2.0), "trace, cold": times(all=99.0),
        "check": times(all=1.0),
    })  # fmt: skip
    assert set(now) == {"trace", "check"}
    record = {"trace": {"all": 1.6, "work": 0.75, "draw": 0.6, "load": 0.0}}
    slower, new = compare(now, record)
    assert slower == "trace: 2.00 references, 1.25 of the record; grew: all 1.60 -> 2.00, draw 0.60 -> 1.00"
    assert new == "check: 0.50 references, no record"
