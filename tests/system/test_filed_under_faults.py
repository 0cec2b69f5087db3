"""Whatever the camera does wrong: no frame is filed under a stop that it does not show."""

import random

import pytest

from daq.runs.run_folder import RunFolder, frame_entries
from rtpiv.command_line.cli import DONE, main
from tests.daq.cameras.rigs import need_aravis
from tests.daq.small_bench import write_bench
from tests.system.misfiled import find_misfiled

pytest.importorskip("harvesters", reason="the camera needs harvesters (extra rtpiv[camera])")

PLAN = """experiment: shift
views: [clear]
displacements:
  - {along: [1.0, 0.0, 0.0], mm: 0.6}
  - {along: [0.0, 1.0, 0.0], mm: 0.7}
  - {along: [1.0, 1.0, 0.0], mm: 1.2}
"""
CAMERA = """camera:
  backend: BACKEND
  options: {}
  settings: {PixelFormat: Mono12p, ExposureTime: 2000.0, TriggerSelector: FrameStart, TriggerMode: "On",
             TriggerSource: Software}
  timeout_s: 1.5
"""


def faults(seed):
    """Some frames late by less and by more than the camera's patience, some lost, some broken."""
    rng = random.Random(seed)
    numbers = rng.sample(range(9), 3)
    late = ", ".join(f'"{number}": {rng.choice((0.4, 1.4, 1.6, 2.2, 3.4))}' for number in numbers)
    return f"{{late_s: {{{late}}}, dropped: {[rng.randrange(9)]}, incomplete: {[rng.randrange(9)]}}}"


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["harvesters", "aravis"])
@pytest.mark.parametrize("seed", range(4))
def test_no_frame_is_filed_under_a_stop_it_does_not_show(tmp_path, seed, backend):
    if backend == "aravis":
        need_aravis()
    simulation = f"samples: 1\nprints_truth: true\nfaults: {faults(seed)}"
    write_bench(tmp_path, simulation=simulation, camera=CAMERA.replace("BACKEND", backend))
    (tmp_path / "plan.yaml").write_text(PLAN)
    arguments = ["acquire", str(tmp_path / "plan.yaml"), "--bench", str(tmp_path / "bench.yaml"), "--no-correct"]
    code = main([*arguments, "-o", str(tmp_path / "runs"), "--simulate", "--home"])
    (run,) = (tmp_path / "runs").glob("*_plan*")
    assert find_misfiled(run) == []
    for _ in range(3):
        if code == DONE:
            break
        code = main(["acquire", "--resume", str(run), "--home"])
        assert find_misfiled(run) == []
    if code == DONE:
        assert len(frame_entries(RunFolder(run).entries())) == 6
