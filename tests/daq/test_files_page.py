"""docs/files.md is what people write their files from: it must name every key there is."""

import re
from pathlib import Path

import pytest
from pydantic import TypeAdapter

from daq.acquisition.bench.bench_table import BenchTable
from daq.acquisition.plans.experiments import EXPERIMENTS, plan_table
from daq.acquisition.runs.displacement import Moved
from daq.acquisition.runs.done_file import DoneFile
from daq.acquisition.runs.journal_lines import Line
from daq.acquisition.runs.run_file import RunFile
from daq.analysis.piv_file import PivTable
from daq.analysis.series.series_folder import SeriesFile
from daq.timing.timing_table import TimingTable
from ground.config import load_yaml, validate
from sim.bench_table import SimulationTable
from tracer.scene_file import load_scene
from tracer.scene_tables import SceneTable

PAGE = Path(__file__).resolve().parents[2] / "docs" / "files.md"


def keys_of(model: object) -> set[str]:
    schema = TypeAdapter(model).json_schema()
    tables = [schema, *schema.get("$defs", {}).values()]
    return {key for table in tables for key in table.get("properties", {})}


@pytest.mark.parametrize(
    "model",
    [
        *(SceneTable, BenchTable, SimulationTable, TimingTable, RunFile, Line, DoneFile, Moved),
        *(PivTable, SeriesFile),
        *map(plan_table, EXPERIMENTS),
    ],
)
def test_every_key_is_on_the_page(model):
    words = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]+)`", PAGE.read_text(encoding="utf-8")))))
    assert keys_of(model) <= words


def test_the_scene_on_the_page_can_be_loaded(tmp_path):
    block = re.search(r"((?:    .*\n)+)", PAGE.read_text(encoding="utf-8"))
    assert block
    path = tmp_path / "scene.yaml"
    path.write_text(re.sub(r"(?m)^    ", "", block[1]), encoding="utf-8")
    assert len(load_scene(path).bodies) == 1


@pytest.mark.parametrize("name", ["bench-sim.yaml", "bench-flow.yaml", "demo/bench.yaml", "demo/bench-flow.yaml"])
def test_the_examples_are_benches(name):
    validate(load_yaml(PAGE.parents[1] / "examples" / name), BenchTable)
