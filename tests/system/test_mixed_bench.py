"""A bench of several worlds, from plan to report.

A rail and a portal on Grbl, a target on a Thorlabs rack, and glass that Micro-Manager moves: once its simulated
core in a world with screws, once the real core with its DemoCamera.
"""

import json
import sys
from types import ModuleType

import numpy as np
import pytest

from daq.bench.bench_table import STAGES
from daq.runs.raw_frame import checksum, read_raw
from daq.runs.run_folder import RunFolder, frame_entries
from rtpiv.command_line.cli import DONE, main
from sim.bench import SimulatedBench
from tests.daq.small_bench import (
    GLASS_CHANNELS,
    SHIFT,
    SIMULATED_GLASS,
    with_glass,
    with_grbl_rail,
    with_thorlabs_target,
    write_bench,
)

pytest.importorskip("harvesters", reason="the camera needs harvesters (extra rtpiv[camera])")
pytestmark = pytest.mark.filterwarnings("ignore:.* is moved by:RuntimeWarning")

UNIT_MM = 0.1  # DemoCamera's Z goes 300 units either way
SHIFTED_MM = {"glass_x": 0.0, "glass_y": -7.0, "glass_z": 0.5}  # where the glass truly is when the core reads 0
CORE = "tests_demo_core:Core"


def acquire(folder, plan, *options):
    """Run the verb; return the run's folder."""
    (folder / "plan.yaml").write_text(plan)
    before = set((folder / "runs").glob("*_plan*"))
    arguments = ["acquire", str(folder / "plan.yaml"), "--bench", str(folder / "bench.yaml")]
    assert main([*arguments, "-o", str(folder / "runs"), "--simulate", "--home", *options]) == DONE
    return RunFolder((set((folder / "runs").glob("*_plan*")) - before).pop())


def check_books(run, frames):
    done = json.loads((run.path / "done.json").read_text())
    books = done["conservation"]
    assert books["imbalance"] == 0
    assert books["triggered"] == books["written"] == frames
    entries = frame_entries(run.entries())
    assert sorted(entries) == list(range(frames))
    for number, entry in entries.items():
        assert checksum(read_raw(run.frame_path(number))[0]) == entry["crc32"]
    return done


def check_displacements(run, largest_um):
    """Commanded, measured and true apart; the true one, which nothing of the software knows, within 10 um."""
    found = json.loads((run.path / "displacements.json").read_text())
    for entry in found:
        commanded, measured, true = (np.array(entry[f"{kind}_mm"]) for kind in ("commanded", "measured", "true"))
        assert np.abs(true - commanded).max() <= largest_um * 1e-3
        assert np.abs(true - commanded).max() > 0.0  # a screw that never errs would be no simulation
        assert np.abs(measured - commanded).max() <= 5e-3
        assert np.linalg.norm(commanded) > 0.1
    return found


def from_plan_to_report(folder):
    run = acquire(folder, SHIFT)
    check_books(run, 8)
    assert len(check_displacements(run, 10.0)) == 4
    said = [entry["said_mm"] for entry in run.entries() if entry["kind"] == "session"]
    assert [set(one) for one in said] == [set(GLASS_CHANNELS)]  # the run tells whose reference is a person's word
    assert "homing: hand" in json.loads((run.path / "run.json").read_text())["bench"]
    assert main(["report", str(run.path)]) == DONE
    assert (run.path / "report" / "report.html").stat().st_size > 10_000
    return run


@pytest.mark.slow
def test_glass_by_a_simulated_core(tmp_path):
    with_glass(with_grbl_rail(with_thorlabs_target(write_bench(tmp_path))), SIMULATED_GLASS)
    from_plan_to_report(tmp_path)


class DemoBench(SimulatedBench):
    """The simulated bench, but for the glass, which the real core moves in its own world."""

    def __init__(self, bench, shows="chessboard", exposures_before=0):
        super().__init__(bench, shows, exposures_before)
        theirs = {"glass": bench.table.stages.controllers["glass"]}
        stages = self.sections[STAGES]
        self.sections[STAGES] = stages.model_copy(update={"controllers": {**stages.controllers, **theirs}})
        by_screws = self.world._stages.true_mm
        self.world._stages.true_mm = lambda axis: by_screws(axis) if axis not in GLASS_CHANNELS else glass_mm(axis)


def glass_mm(axis):
    """Where the core's own stages stand, in the coordinate of the bench file."""
    core = sys.modules["tests_demo_core"].cores[-1]
    units = core.getPosition("Z") if axis == "glass_z" else core.getXYPosition("XY")[axis == "glass_y"]
    return units * UNIT_MM + SHIFTED_MM[axis]


@pytest.mark.slow
def test_glass_by_the_real_core(tmp_path, monkeypatch):
    adapters = pytest.importorskip("mm_test_adapters")
    pymmcore = pytest.importorskip("pymmcore")
    module = ModuleType("tests_demo_core")
    module.cores = []

    class Core(pymmcore.CMMCore):
        def __init__(self):
            super().__init__()
            module.cores.append(self)

    module.Core = Core
    monkeypatch.setitem(sys.modules, "tests_demo_core", module)
    glass = {
        "adapters": adapters.device_adapter_path(),
        "mm_per_unit": UNIT_MM,
        "core": CORE,
        "devices": {
            "hub": {"library": "DemoCamera", "device": "DHub"},
            "XY": {"library": "DemoCamera", "device": "DXYStage", "parent": "hub"},
            "Z": {"library": "DemoCamera", "device": "DStage", "parent": "hub"},
        },
    }
    bench = f"{__name__}:DemoBench"
    path = with_grbl_rail(with_thorlabs_target(write_bench(tmp_path)))
    with_glass(path, glass, bench=bench, transport="pty", speed=10.0)
    run = from_plan_to_report(tmp_path)
    steps = [entry for entry in run.entries() if entry["kind"] == "step"]
    assert {round(entry["true_mm"]["glass_y"]) for entry in steps} == {0, -130}  # it was driven out and back
    for entry in steps:
        for name in GLASS_CHANNELS:
            assert np.isclose(entry["true_mm"][name], entry["measured_mm"][name], atol=2e-6)
