"""docs/files.md is what people write their files from: it must name every key there is."""

import dataclasses
import re
from pathlib import Path

from pydantic import TypeAdapter

from daq.bench.bench_table import BenchTable
from daq.bench.reading import ReadingSection
from daq.plans.plan import EXPERIMENTS, plan_table
from daq.runs.displacement import Moved
from daq.runs.done_file import DoneFile
from daq.runs.frame_accounting import FrameAccounting
from daq.runs.journal_lines import Line
from daq.runs.run_file import RunFile
from daq.timing.timing_table import TimingTable
from ground.config import load_yaml, validate
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorFlag
from rtpiv.analysis.pairs.piv_file import PivOptions, PivTable
from rtpiv.analysis.series.series_folder import SeriesFile
from sim.bench_table import SimulationTable
from tests.loops import loop_over
from tracer.scene.scene_file import load_scene
from tracer.scene.scene_tables import SceneTable

PAGE = Path(__file__).resolve().parents[2] / "docs" / "files.md"
GLOSSARY = PAGE.with_name("conventions.md")


def keys_of(model: object) -> set[str]:
    schema = TypeAdapter(model).json_schema()
    tables = [schema, *schema.get("$defs", {}).values()]
    return {key for table in tables for key in table.get("properties", {})}


@loop_over(
    "model",
    [
        *(SceneTable, BenchTable, SimulationTable, TimingTable, ReadingSection, RunFile, Line, DoneFile, Moved),
        *(PivTable, SeriesFile),
        *map(plan_table, EXPERIMENTS),
    ],
)
def test_every_key_is_on_the_page(model):
    words = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]+)`", PAGE.read_text(encoding="utf-8")))))
    assert keys_of(model) <= words


def test_the_glossary_says_what_becomes_of_frames_and_vectors():
    """All counts of a report's tables; none of them says itself what it is."""
    rows = re.findall(r"^\|.*\|$", GLOSSARY.read_text(encoding="utf-8"), re.MULTILINE)
    words = set(re.findall(r"\w+", " ".join(rows)))
    assert FrameAccounting().to_dict().keys() <= words
    assert {flag.name.lower() for flag in VectorFlag} <= words


def test_the_page_has_each_setting_of_piv_with_its_default():
    rows = dict(re.findall(r"^\| (`.*?) \| (.*?) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE))
    said = {key: text for keys, text in rows.items() for key in re.findall(r"`(\w+)`", keys)}
    assert set(PivOptions.__annotations__) - {"piv"} == set(PivTable.model_fields) <= set(said)
    for field in dataclasses.fields(PivSettings):
        if field.name in PivTable.model_fields and field.default is not None and len(said[field.name]) < 8:
            assert said[field.name].strip("`").lower() == str(field.default).lower(), field.name


def test_the_scene_on_the_page_can_be_loaded(tmp_path):
    block = re.search(r"((?:    .*\n)+)", PAGE.read_text(encoding="utf-8"))
    assert block
    path = tmp_path / "scene.yaml"
    path.write_text(re.sub(r"(?m)^    ", "", block[1]), encoding="utf-8")
    assert len(load_scene(path).bodies) == 1


@loop_over(
    "name", ["bench-sim.yaml", "bench-flow.yaml", "bench-by-hand.yaml", "demo/bench.yaml", "demo/bench-flow.yaml"]
)
def test_the_examples_are_benches(name):
    validate(load_yaml(PAGE.parents[1] / "examples" / name), BenchTable)
