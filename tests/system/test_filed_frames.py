"""Every frame of a run shows what its line says, and the comparison sees it where one does not."""

import numpy as np
import pytest

from daq.runs.run_folder import frame_entries
from rtpiv.command_line.cli import DONE, main
from sim.frame_truth import NoTruth
from tests.daq.small_bench import SHIFT, write_bench
from tests.system import misfiled
from tests.system.misfiled import find_misfiled

pytest.importorskip("harvesters", reason="the camera needs harvesters (extra rtpiv[camera])")


def acquired(folder, simulation):
    write_bench(folder, simulation=simulation)
    (folder / "plan.yaml").write_text(SHIFT)
    arguments = ["acquire", str(folder / "plan.yaml"), "--bench", str(folder / "bench.yaml"), "--no-correct"]
    assert main([*arguments, "-o", str(folder / "runs"), "--simulate", "--home"]) == DONE
    (run,) = (folder / "runs").glob("*_plan*")
    return run


@pytest.mark.slow
def test_a_run_says_the_truth_and_a_frame_that_lies_is_found(tmp_path, monkeypatch):
    run = acquired(tmp_path, "samples: 1\nprints_truth: true")
    assert find_misfiled(run) == []
    assert find_misfiled(run, within_mm=1e-4)  # nothing stands where it was measured to a tenth of a um

    def swapped(entries):
        """Two frames of different stops change places, as after a frame that came late."""
        found = {number: dict(entry) for number, entry in frame_entries(entries).items()}
        one, other = found[0], found[len(found) - 1]
        assert one["measured_mm"] != other["measured_mm"]
        for key in ("file", "crc32"):
            one[key], other[key] = other[key], one[key]
        return found

    monkeypatch.setattr(misfiled, "frame_entries", swapped)
    assert {wrong.frame for wrong in find_misfiled(run)} == {0, 7}

    def doubled(entries):
        found = {number: dict(entry) for number, entry in frame_entries(entries).items()}
        found[2] = found[1] | {"frame": 2}
        return found

    monkeypatch.setattr(misfiled, "frame_entries", doubled)
    assert "the same exposure as frame 1" in "".join(wrong.why for wrong in find_misfiled(run))

    monkeypatch.setattr(misfiled, "read_raw", lambda *_: (np.full((96, 96), 100, np.uint16), {}))
    with pytest.raises(NoTruth):
        find_misfiled(run)


def test_a_ring_or_a_small_sensor_is_refused(tmp_path):
    write_bench(tmp_path / "a", side_px=12, simulation="samples: 1\nprints_truth: true")
    arguments = ["bench", "stage", "where", "--bench", str(tmp_path / "a" / "bench.yaml"), "--simulate"]
    assert main(arguments) == 2
    write_bench(tmp_path / "b", simulation="prints_truth: true\nring: frames")
    arguments = ["bench", "stage", "where", "--bench", str(tmp_path / "b" / "bench.yaml"), "--simulate"]
    assert main(arguments) == 2
