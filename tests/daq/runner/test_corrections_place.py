"""Frames of a flow are corrected through the glass where the plan has it, not where the scene file has it."""

from dataclasses import replace

import pytest

from daq.runner.session import Request, make_corrections
from tests.daq.small_bench import load


@pytest.mark.parametrize("off_mm", [0.0, 4.0])
def test_the_glass_is_where_the_steps_have_it(tmp_path, off_mm):
    bench, plan = load(tmp_path)
    home_mm = bench.table.home_mm["glass_z"]
    steps = [
        replace(step, positions_mm=tuple((step.targets_mm | {"glass_z": home_mm + off_mm}).items()))
        if step.view == "glass" else step
        for step in plan.steps
    ]  # fmt: skip
    request = Request(tmp_path / "bench.yaml", tmp_path / "plan.yaml")
    made = make_corrections(request, bench, tmp_path / "maps", steps)
    assert made is not None
    assert [s.centre_mm[2] for s in made.scene.spheres] == [25.0 + off_mm, 75.0 + off_mm]
    assert (made.scene.content_hash() == bench.scene.content_hash()) == (off_mm == 0.0)
