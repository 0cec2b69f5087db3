"""`rtpiv align` on the simulated bench, rendered: from 1.5 mm off in each direction to within a step sideways."""

import re

import numpy as np
import pytest

from daq.bench.bench_file import load_bench
from daq.errors import PlanError
from daq.runs.run_folder import RunFolder
from rtpiv.verbs.align import align
from tests.daq.small_bench import SHIFT, write_bench
from tracer.scene.scene_file import load_scene

STEP_MM = 0.01
PLAY = re.compile(r"(glass_[xyz]: \{lead_mm: 4.0, steps_per_rev: 12800, travel_mm: [^}]+)\}")
LIGHT = "samples: 2\nblur_px: 2.0\nuneven_light: 0.03\n"


def bench_of(folder, side_px, seed, off_mm):
    """A bench whose glass was put up beside its place, with 5 um of play, a soft view and uneven light."""
    path = write_bench(folder, side_px, LIGHT + f"glass_off_mm: {off_mm}")
    text, played = PLAY.subn(r"\1, backlash_um: 5.0}", path.read_text())
    assert played == 3
    text = text.replace("seed: 7", f"seed: {seed}")
    path.write_text(text)
    (folder / "plan.yaml").write_text("experiment: align\n")
    return path


def test_a_dry_run_says_where_it_looks_and_opens_nothing(tmp_path, capsys):
    bench = bench_of(tmp_path, 96, 7, [0.0, 0.0, 0.0])
    assert align(tmp_path / "plan.yaml", bench, tmp_path / "runs", dry_run=True) is None
    said = capsys.readouterr()
    assert "look_0" in said.out
    assert "up to 3 moves" in said.out
    assert "glass_z has 1.00 mm to its limit" in said.err
    assert not (tmp_path / "runs").exists()


def test_another_plan_is_refused(tmp_path):
    bench = bench_of(tmp_path, 96, 7, [0.0, 0.0, 0.0])
    (tmp_path / "plan.yaml").write_text(SHIFT)
    with pytest.raises(PlanError, match="give one of experiment: align"):
        align(tmp_path / "plan.yaml", bench, tmp_path / "runs", simulate=True)


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("seed", range(11, 17))
def test_from_far_off_to_within_a_step(tmp_path, seed):
    rng = np.random.default_rng(seed)
    off_mm = np.where(rng.uniform(size=3) < 0.5, -1.0, 1.0) * (1.5, 1.5, rng.uniform(0.0, 1.5))
    path = bench_of(tmp_path, 2016, seed, off_mm.round(3).tolist())
    run = RunFolder.open(align(tmp_path / "plan.yaml", path, tmp_path / "runs", simulate=True, home=True))
    bench, truth = load_bench(path), load_scene(run.path / "truth.yaml")
    last = [entry for entry in run.entries() if entry["kind"] == "step"][-1]
    carried = np.array(bench.table.offset_mm("glass", last["true_mm"])) + off_mm
    far = np.subtract(truth.spheres[1].centre_mm, bench.scene.spheres[1].centre_mm) + carried
    look = [entry for entry in run.entries() if entry["kind"] == "look"][-1]
    print(f"seed {seed}: {1e3 * far} um off, seen {look['glass_mm']} +- {look['glass_sigma_mm']} mm")
    assert np.hypot(*far[:2]) < STEP_MM
    assert abs(look["glass_mm"][2] - far[2]) < 3.0 * look["glass_sigma_mm"][2]
