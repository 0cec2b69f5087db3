"""The time in which a simulated bench draws a picture is not the camera's: no timeout counts it."""

import json
import time

import pytest

from daq.runs.frame_accounting import rejection_sentence
from daq.runs.run_folder import RunFolder
from rtpiv.command_line.cli import DONE, main
from sim.world import World
from tests.daq.small_bench import TARGET, load
from tests.slow_cases import slow

TIMEOUT_S = 0.5
PATIENT_S = 2.5  # no frame of a busy computer comes so late by itself
# The camera works one frame after the other: that of the next trigger waits for the late one
LATE = 1.3


def run_of(folder, capsys, simulation, timeout_s=TIMEOUT_S):
    """Take the frames of a target plan on a simulated bench; what became of them, and what was said."""
    bench, plan = load(folder, TARGET, simulation=f"samples: 1\n{simulation}")
    text = bench.path.read_text()
    assert text.count("timeout_s: 60.0") == 1
    bench.path.write_text(text.replace("timeout_s: 60.0", f"timeout_s: {timeout_s}"))
    words = ["acquire", str(plan.path), "--bench", str(bench.path), "-o", str(folder / "runs")]
    assert main([*words, "--simulate", "--home", "--no-correct"]) == DONE, capsys.readouterr().err
    (path,) = (path.parent for path in (folder / "runs").glob("*/run.json"))
    books = json.loads((path / "done.json").read_text())["conservation"]
    return RunFolder.open(path), books, capsys.readouterr().out


@pytest.mark.parametrize("transport", ["memory", slow("genicam")])
def test_pictures_that_take_longer_than_the_timeout_are_taken_once(tmp_path, capsys, monkeypatch, transport):
    drawn = World._light

    def slowly(self, true_mm):
        time.sleep(2.5 * TIMEOUT_S)
        return drawn(self, true_mm)

    monkeypatch.setattr(World, "_light", slowly)
    folder, books, said = run_of(tmp_path, capsys, f"camera_transport: {transport}")
    assert (books["triggered"], books["written"], books["rejected"]) == (3, 3, 0)
    assert rejection_sentence(folder.entries()) == ""
    assert "frames rejected" not in said


def test_a_frame_that_is_late_on_its_way_is_rejected_and_explained(tmp_path, capsys):
    late = f"camera_transport: memory\nfaults: {{late_s: {{1: {LATE * PATIENT_S}}}}}"
    folder, books, said = run_of(tmp_path, capsys, late, PATIENT_S)
    assert (books["written"], books["rejected"], books["imbalance"]) == (3, 1, 0)
    sentence = (
        "frames rejected: 1 came after timeout_s of the bench file had passed; nothing of the run shows them"
    )
    assert rejection_sentence(folder.entries()) == sentence
    assert sentence in " ".join(said.split())
