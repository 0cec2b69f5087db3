"""The whole campaign through real client libraries and byte protocols: target run, shift run, corrections."""

import json

import numpy as np
import pytest

from daq.runs.raw_frame import checksum, read_raw
from daq.runs.run_folder import RunFolder, frame_entries
from piv.files.frame_file import read_frame
from rtpiv.command_line.cli import DONE, main
from tests.daq.small_bench import SHIFT, TARGET, write_bench

pytest.importorskip("harvesters", reason="the camera needs harvesters (extra rtpiv[camera])")


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


def check_corrected_again(folder, run, tmp_path, size_px):
    """Batch correction of the same raw frames gives the same pixels."""
    steps = json.loads((run.path / "run.json").read_text())["steps"]
    glass = [run.frame_path(s["first_frame"]) for s in steps if s["view"] == "glass" and s["on_plane"]]
    arguments = ["correct", *map(str, glass), "--scene", str(folder / "scene.yaml"), "-o", str(tmp_path / "again")]
    assert main(arguments) == DONE
    for path in glass:
        live = read_frame(run.path / "corrected" / path.name, (size_px, size_px))
        assert np.array_equal(live, read_frame(tmp_path / "again" / path.name))
        assert np.count_nonzero(live) > 0.1 * live.size
    return glass


@pytest.mark.slow
def test_target_and_shift_at_small_size(tmp_path):
    write_bench(tmp_path)
    target = acquire(tmp_path, TARGET)
    check_books(target, 3)
    assert sorted(path.stem for path in (target.path / "corrected").glob("0*.tif")) == ["000000", "000002"]
    bare, deep, glass = (read_raw(target.frame_path(number))[0].astype(float) for number in range(3))
    assert np.abs(bare - deep).mean() > 20.0  # the target has moved in the picture
    assert np.abs(bare - glass).mean() > 20.0  # and the glass is in front of it

    shift = acquire(tmp_path, SHIFT)
    done = check_books(shift, 8)
    assert len(check_displacements(shift, 10.0)) == 4
    assert len(check_corrected_again(tmp_path, shift, tmp_path, 96)) == 3
    flow = done["flow"][0]
    assert flow["corrected_live"] + flow["skipped_live"] == 6  # frames with the sheet in the plane
    assert flow["latency_ms"]["p99"] > 0.0
    truth, known = ((shift.path / name).read_text() for name in ("truth.yaml", "run.json"))
    assert "position_mm" in truth
    assert truth not in known  # the hidden misalignment stays hidden
