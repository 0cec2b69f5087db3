"""What makes no sense of a flow is one sentence on the screen, exit code 2, no run folder, and no pulse."""

from types import SimpleNamespace

import pytest

from daq.errors import ResumeRefused
from daq.runner.pair_writer import PairWriter
from daq.runs.run_folder import RunFolder
from daq.timing.box import TimingBox
from rtpiv.command_line.cli import USAGE, main
from tests.daq.flow_bench import BLOCKS, DIODES, write_flow
from tests.daq.runs.test_flow_pairs import flow

CHANGES = {
    "dt longer than the frame": ("plan", "dt_us: 100.0", "dt_us: 30000.0", "dt of 30000 us does not fit into"),
    "dt longer than the period": ("plan", "dt_us: 100.0", "dt_us: 50000.0", "longer than the 40000 us"),
    "rate above the camera's": ("bench", BLOCKS, f"{BLOCKS}, most_hz: 20.0", "more than the camera's 20"),
    "rate above the laser's": ("plan", "rate_hz: 25.0", "rate_hz: 26.0", "more than the laser's 25"),
    "missing marker": ("bench", ", marker: line_status, line: 2", "", "A and B need a marker"),
    "marker without its line": ("bench", ", line: 2}", "}", "marker line_status needs line"),
    "no word of pairs": ("bench", f"pairs: {{{BLOCKS}, marker: line_status, line: 2}}", "timeout_s: 1.0",
                         "which distinguishes exposure A from exposure B"),
    "run without dt": ("plan", "dt_us: 100.0", "", "key 'dt_us' is missing"),
}  # fmt: skip


@pytest.mark.parametrize("what", CHANGES)
def test_what_makes_no_sense_fires_nothing(tmp_path, monkeypatch, capsys, what):
    opened = []
    monkeypatch.setattr(TimingBox, "connect", lambda *_: opened.append(what))
    bench, plan = write_flow(tmp_path, channels=DIODES)
    which, old, new, words = CHANGES[what]
    path = bench if which == "bench" else plan
    text = path.read_text()
    assert old in text
    if what == "no word of pairs":
        text = text.replace("  timeout_s: 1.0\n", "")
    path.write_text(text.replace(old, new))
    command = ["acquire", str(plan), "--bench", str(bench), "-o", str(tmp_path / "runs"), "--simulate", "--home"]
    assert main([*command, "--operator", "test"]) == USAGE
    said = capsys.readouterr().err.strip()
    assert words in " ".join(said.split())
    assert "Traceback" not in said
    assert opened == []
    assert not list((tmp_path / "runs").glob("*"))


@pytest.mark.parametrize(("numbers", "words"), [
    (range(2), "its background was exposed for 100 us .frame 0. and the camera is at 90 us now"),
    (range(2, 8), "its pairs were exposed for 100 us .frame 2. and the camera is at 90 us now"),
])  # fmt: skip
def test_a_run_does_not_go_on_with_another_exposure(tmp_path, numbers, words):
    folder, exposures = RunFolder.open(flow(tmp_path, numbers=numbers)), SimpleNamespace(settings={})
    side = PairWriter(folder, None, None, SimpleNamespace(exposures=exposures))
    exposures.settings["ExposureTime"] = 90.0
    with pytest.raises(ResumeRefused, match=words):
        side.require_same_exposure()
    exposures.settings["ExposureTime"] = 100.0
    side.require_same_exposure()
