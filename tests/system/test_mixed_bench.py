"""A bench of several worlds, from plan to report.

A rail and a portal on Grbl, a target on a Thorlabs rack, and glass that Micro-Manager's simulated core moves.
"""

import json

import numpy as np
import pytest

from daq.runs.raw_frame import checksum, read_raw
from daq.runs.run_folder import RunFolder, frame_entries
from rtpiv.command_line.cli import DONE, main
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


def acquire(folder, plan):
    """Run the verb; return the run's folder."""
    (folder / "plan.yaml").write_text(plan)
    before = set((folder / "runs").glob("*_plan*"))
    arguments = ["acquire", str(folder / "plan.yaml"), "--bench", str(folder / "bench.yaml")]
    assert main([*arguments, "-o", str(folder / "runs"), "--simulate", "--home"]) == DONE
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


@pytest.mark.slow
def test_a_run_on_boxes_of_three_kinds_is_whole_and_has_its_report(tmp_path):
    with_glass(with_grbl_rail(with_thorlabs_target(write_bench(tmp_path))), SIMULATED_GLASS)
    run = acquire(tmp_path, SHIFT)
    check_books(run, 8)
    assert len(check_displacements(run, 10.0)) == 4
    said = [entry["said_mm"] for entry in run.entries() if entry["kind"] == "session"]
    assert [set(one) for one in said] == [set(GLASS_CHANNELS)]  # the run tells whose reference is a person's word
    assert "homing: hand" in json.loads((run.path / "run.json").read_text())["bench"]
    assert main(["report", str(run.path)]) == DONE
    assert (run.path / "report" / "report.html").stat().st_size > 10_000
