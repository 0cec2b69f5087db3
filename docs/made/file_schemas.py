"""The page of file schemas: every section with its keys, from the tables that check the files."""

import re
from collections.abc import Iterator
from typing import Any

from correction.target.board_file import PrintedBoard
from daq.bench.reading import ReadingSection
from daq.timing.timing_table import TimingTable
from made.command_line import escaped
from rtpiv.analysis.pairs.piv_file import PivTable
from rtpiv.verbs.schema import bench_schema, plan_schema, scene_schema
from sim.bench_table import SimulationTable

Schema = dict[str, Any]
KINDS = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}
BOUNDS = {
    "minimum": "at least {:g}", "exclusiveMinimum": "above {:g}",
    "maximum": "at most {:g}", "exclusiveMaximum": "below {:g}",
    "minLength": "at least {} characters", "maxLength": "at most {} characters",
}  # fmt: skip


def text() -> str:
    """Write Markdown: one part a file, one heading a section."""
    parts = list[str]()
    for file, tables in _files().items():
        parts.append(f"## {file}")
        shown = set[str]()
        for title, tree in tables.items():
            for name, table in {title: tree, **tree.get("$defs", {})}.items():
                if name not in shown:
                    parts += _Section(file, name, table).lines()
                    shown.add(name)
    return "\n\n".join(parts) + "\n"


def _files() -> dict[str, dict[str, Schema]]:
    """Schemas of each file, by what they are of."""
    plans = plan_schema()
    by_experiment = {
        f"Plan of the experiment {one['if']['properties']['experiment']['const']}": {
            **one["then"],
            "$defs": plans["$defs"],
        }
        for one in plans["allOf"]
    }
    return {
        "scene.yaml": {"The file": scene_schema()},
        "bench.yaml": {
            "The file": bench_schema(),
            "A timing unit among the devices": TimingTable.model_json_schema(),
            "A reading among the devices": ReadingSection.model_json_schema(),
            "The simulation": SimulationTable.model_json_schema(),
        },
        "plan.yaml": by_experiment,
        "board.yaml": {"The file": PrintedBoard.model_json_schema()},
        "piv.yaml": {"The file": PivTable.model_json_schema()},
    }


def _title(name: str) -> str:
    """The name of a table as words: `FitCameraTable` is "Fit camera"."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", re.sub(r"(Table|Section)$", "", name))
    return words[:1] + words[1:].lower() if words != name else name


class _Section:
    """One table of one file."""

    def __init__(self, file: str, name: str, table: Schema) -> None:
        self.file, self.name, self.table = file, name, table

    def lines(self) -> Iterator[str]:
        """Its heading, which others link to, what it is for, and its keys."""
        yield f"({self._place(self.name)})="
        yield f"### {_title(self.name)}"
        if description := self.table.get("description"):
            yield escaped(" ".join(description.split("\n\n")[0].split()))
        needed = self.table.get("required", ())
        for key, value in self.table.get("properties", {}).items():
            default = value.get("default")
            plain = default is not None and not isinstance(default, dict)
            holds = " Required." if key in needed else f" Default: `{_as_yaml(default)}`." if plain else ""
            yield f"`{key}`\n: {self._kind(value)}.{holds}"

    def _place(self, name: str) -> str:
        return re.sub(r"\W+", "-", f"{self.file} {name}").lower()

    def _kind(self, value: Schema) -> str:
        """What may stand there, in words."""
        if "$ref" in value:
            name = value["$ref"].rpartition("/")[2]
            return f"[{_title(name)}](#{self._place(name)})"
        if "const" in value or "enum" in value:
            return " or ".join(f"`{_as_yaml(each)}`" for each in value.get("enum", [value.get("const")]))
        if choices := value.get("anyOf") or value.get("oneOf"):
            return ", or ".join(dict.fromkeys(self._kind(each) for each in choices if each.get("type") != "null"))
        if value.get("type") == "array":
            return self._list(value)
        if value.get("type") == "object":
            held = value.get("additionalProperties") or next(
                iter(value.get("patternProperties", {}).values()), None
            )
            return (
                f"names, each with: {self._kind(held)}"
                if isinstance(held, dict) and len(held) > 1
                else "a section"
            )
        bounds = [text.format(value[name]) for name, text in BOUNDS.items() if name in value]
        return ", ".join([KINDS.get(value.get("type", ""), "anything"), *bounds])

    def _list(self, value: Schema) -> str:
        """A list: how many of what."""
        if "prefixItems" in value:
            return "list of " + " and ".join(map(self._kind, value["prefixItems"]))
        low, high = value.get("minItems"), value.get("maxItems")
        many = f" of {low}" if low is not None and low == high else f" of {low} or more" if low else ""
        return f"list{many}: {self._kind(value.get('items', {}))}"


def _as_yaml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
