"""`rtpiv setup schema`: write JSON schemas of the input files for editors."""

import json
from functools import cache
from pathlib import Path
from typing import Any

from daq.atomic_write import write_text
from daq.bench.bench_table import BenchTable
from daq.plans.plan import EXPERIMENTS, plan_table
from ground.terminal import console
from rtpiv.verbs.results import require_folder
from tracer.scene.scene_tables import SceneTable

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema(out: Path | str = Path("schemas")) -> list[Path]:
    """Write a schema for scene, bench and plan files, made from the tables that check them.

    A file that names its schema in a first line ``# yaml-language-server: $schema=schemas/scene.schema.json`` is
    completed and checked by editors with a YAML language server.

    Parameters
    ----------
    out : path
        Folder.

    Returns
    -------
    list of Path
        ``scene.schema.json``, ``bench.schema.json``, ``plan.schema.json``.

    Raises
    ------
    DiskError
        The folder cannot be written to.
    """
    files = write_schemas(require_folder(out))
    console().print(f"{', '.join(file.name for file in files)} are in {out}", soft_wrap=True)
    return files


def write_schemas(folder: Path) -> list[Path]:
    """Write the three schemas."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name, text in _texts().items():
        files.append(folder / f"{name}.schema.json")
        write_text(files[-1], text)
    return files


@cache  # what makes many labs waits for it once
def _texts() -> dict[str, str]:
    """Contents of the three files."""
    trees = {"scene": scene_schema(), "bench": bench_schema(), "plan": plan_schema()}
    return {name: json.dumps({"$schema": DIALECT, **tree}, indent=1) + "\n" for name, tree in trees.items()}


def scene_schema() -> dict[str, Any]:
    """Schema of scene files."""
    return {**SceneTable.model_json_schema(), "title": "scene of rtpiv"}


def bench_schema() -> dict[str, Any]:
    """Schema of bench files."""
    return {**BenchTable.model_json_schema(), "title": "bench of rtpiv"}


def plan_schema() -> dict[str, Any]:
    """Schema of plan files: the experiment says which keys there are."""
    definitions: dict[str, Any] = {}
    plans = {}
    for name in EXPERIMENTS:
        tree = plan_table(name).model_json_schema()
        definitions |= tree.pop("$defs", {})
        plans[name] = tree
    chosen = [
        {"if": {"properties": {"experiment": {"const": name}}, "required": ["experiment"]}, "then": plan}
        for name, plan in plans.items()
    ]
    return {
        "title": "plan of rtpiv",
        "type": "object",
        "required": ["experiment"],
        "properties": {"experiment": {"enum": list(EXPERIMENTS)}},
        "allOf": chosen,
        "$defs": definitions,
    }
