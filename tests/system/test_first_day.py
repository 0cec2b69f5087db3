"""The first day as docs/at-the-bench.md tells it, on four kinds of controllers behind device files."""

import io
import re
from pathlib import Path

import pytest
import yaml

from daq.bench.bench_file import load_bench
from rtpiv.command_line.cli import DONE, main
from tests.system.served import HASTE, served_bench

PAGE = Path(__file__).resolve().parents[2] / "docs" / "at-the-bench.md"
PLAN = "experiment: target\nclear: {z_mm: [0.0, -10.0]}\nglass: {z_mm: [0.0]}\n"


def lines_of_the_prompt():
    return re.findall(r"^ +stage> (.*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


def script_of_the_page():
    block = re.search(
        r"((?:    .*\n|\n)*    with open_session(?:.*\n)(?:    .*\n)+)", PAGE.read_text(encoding="utf-8")
    )
    return re.sub(r"(?m)^    ", "", block[1])


@pytest.fixture
def bench(tmp_path):
    with served_bench(tmp_path) as served:
        (tmp_path / "plan-target.yaml").write_text(PLAN)
        yield served


@pytest.mark.slow
def test_the_prompt_goes_through_as_written(bench, monkeypatch, capsys):
    lines = lines_of_the_prompt()
    assert {line.split()[0] for line in lines} >= {"home", "where", "move", "jog", "here", "save", "quit"}
    before = bench.path.read_text()
    monkeypatch.chdir(bench.folder)
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(lines) + "\n"))
    bench.clock.set_speed(HASTE)
    assert main(["bench", "stage", "--bench", "bench.yaml"]) == DONE
    out = capsys.readouterr().out
    for axis in bench.world.motors:
        assert bench.true_mm(axis) == pytest.approx(0.0, abs=0.1)  # the boards' zeros are off by the play
    written = yaml.safe_load(bench.path.read_text())
    assert written["scene_at_mm"] == pytest.approx(dict.fromkeys(bench.world.motors, 0.0), abs=0.01)
    said = {name: table["identity"] for name, table in written["stages"]["controllers"].items()}
    assert re.search(r"serial \d+", said["glass"])
    assert said["rail"].startswith("iMC-S8")
    kept = re.search(r"the old file is (\S+)", out)
    assert Path(kept[1]).read_text() == before
    comments = [line for line in before.splitlines() if line.lstrip().startswith("#")]
    assert [line for line in bench.path.read_text().splitlines() if line.lstrip().startswith("#")] == comments
    load_bench(bench.path)


def test_the_script_on_the_page(bench, monkeypatch, capsys):
    monkeypatch.chdir(bench.folder)
    script = script_of_the_page()
    assert len([line for line in script.splitlines() if line.strip()]) <= 10
    bench.clock.set_speed(HASTE)
    exec(compile(script, "at-the-bench.md", "exec"), {})
    said = capsys.readouterr().out
    assert len(re.findall(r"asked for -\d+ mm, [+-]\d+\.\d um off, \d attempts", said)) == 2
    assert bench.true_mm("glass_y") == pytest.approx(-25.0, abs=0.1)
