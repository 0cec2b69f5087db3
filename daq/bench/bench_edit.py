"""Write values into a person's YAML file; comments, order and layout stay as they are.

A YAML library that reads and writes loses comments and lays everything out anew. Here the file is read for the
places of its nodes only; then the characters of a value are replaced, or a new pair is put behind the last one of
its mapping, in the style that the mapping has: `{a: 1.0, b: 2.0}` or one pair a line. What comes out is read again
and compared: exactly the values asked for have changed, or nothing is written.
"""

import difflib
import json
import math
import re
import shutil
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from daq.atomic_write import write_text
from daq.errors import RunUsageError
from ground.config import load_yaml

Place = tuple[str, ...]
Value = float | str

DECIMALS = 4  # of a position in mm: a tenth of a micrometre
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_.()/&+ -]*[A-Za-z0-9_.)]")


def with_values(text: str, values: Mapping[Place, Value], after: Mapping[str, str]) -> str:
    """Return a YAML text with some values set.

    Parameters
    ----------
    text : str
        The file.
    values : mapping of tuple to float or str
        What to set, by the keys that lead there. Mappings on the way must exist, but for one at the top.
    after : mapping of str to str
        Behind which key at the top a mapping is put that is not there yet.

    Raises
    ------
    RunUsageError
        The file is laid out in a way that cannot be edited; write it by hand.
    """
    root = yaml.compose(text, yaml.SafeLoader)
    newline = "\r\n" if "\r\n" in text else "\n"
    edits: list[tuple[int, int, str]] = []
    by_mapping: dict[Place, dict[str, Value]] = {}
    for place, value in values.items():
        by_mapping.setdefault(place[:-1], {})[place[-1]] = value
    for place, pairs in by_mapping.items():
        node = _at(root, place)
        if node is None and len(place) == 1:
            edits.append(_new_mapping(text, root, place[0], pairs, after[place[0]], newline))
        elif isinstance(node, yaml.MappingNode):
            edits += _set(text, node, pairs, newline)
        else:
            raise RunUsageError(f"{'.'.join(place)} is not a mapping in the file; edit the file by hand")
    for start, end, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[end:]
    return text


def difference(path: Path, before: str, after: str) -> str:
    """Return what a change of a file would do, as a person reads it; empty if nothing."""
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), path.name, path.name, n=1, lineterm="")
    return "\n".join(lines)


def edit_values(path: Path, values: Mapping[Place, Value], after: Mapping[str, str]) -> tuple[str, str]:
    """Return the text of a YAML file as it is, and with some values set; makes sure of the result, writes nothing.

    Raises
    ------
    ConfigError
        The file cannot be read.
    RunUsageError
        It is laid out in a way that cannot be edited.
    """
    load_yaml(path)  # it may have been edited since; errors are reported with their line
    before = path.read_bytes().decode("utf-8")
    text = with_values(before, values, after)
    wanted = json.loads(json.dumps(yaml.safe_load(before)))  # what two aliases share must not change twice
    for place, value in values.items():
        at: Any = wanted
        for key in place[:-1]:
            at = at.setdefault(key, {})
        at[place[-1]] = _round(value)
    if yaml.safe_load(text) != wanted:
        raise RunUsageError(f"{path} is laid out in a way that cannot be edited safely; write the values by hand")
    return before, text


def replace_file(path: Path, text: str) -> Path:
    """Write a file anew, whole or not at all; return where the old one is kept.

    Raises
    ------
    DiskError
        It cannot be written; the old one is untouched.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%f")[:-3]
    kept = path.with_name(f"{path.name}.{stamp}.bak")
    shutil.copy2(path, kept)
    write_text(path, text)
    shutil.copymode(kept, path)
    return kept


def _round(value: Value) -> Value:
    return value if isinstance(value, str) else round(value, DECIMALS) + 0.0  # no minus zero


def _format_value(value: Value) -> str:
    """Write a value so that it is read back as it was."""
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and yaml.safe_load(value) == value
        return value if plain else '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if not math.isfinite(value):
        raise RunUsageError(f"{value} is not a position")
    text = f"{_round(value):.{DECIMALS}f}".rstrip("0")
    return text + "0" if text.endswith(".") else text


def _at(node: yaml.Node | None, place: Place) -> yaml.Node | None:
    for key in place:
        if not isinstance(node, yaml.MappingNode):
            return None
        node = next((value for name, value in node.value if name.value == key), None)
    return node


def _set(
    text: str, node: yaml.MappingNode, pairs: Mapping[str, Value], newline: str
) -> list[tuple[int, int, str]]:
    there = {name.value: value for name, value in node.value}
    edits = [
        (there[key].start_mark.index, there[key].end_mark.index, _format_value(value))
        for key, value in pairs.items()
        if key in there
    ]
    new = [f"{key}: {_format_value(value)}" for key, value in pairs.items() if key not in there]
    if not new:
        return edits
    if node.flow_style:
        end = node.value[-1][1].end_mark.index if node.value else node.start_mark.index + 1
        edits.append((end, end, (", " if node.value else "") + ", ".join(new)))
        return edits
    first, last = node.value[0][0], node.value[-1][1]
    indent = " " * first.start_mark.column
    end = _line_end(text, last.end_mark.index if not isinstance(last, yaml.MappingNode) else _last(last))
    edits.append((end, end, "".join(f"{newline}{indent}{pair}" for pair in new)))
    return edits


def _last(node: yaml.Node) -> int:
    """End of a node's own text: YAML ends a block before the next key, behind comments that are not its own."""
    while isinstance(node, yaml.MappingNode | yaml.SequenceNode) and node.value and not node.flow_style:
        last = node.value[-1]
        node = last[1] if isinstance(last, tuple) else last
    return int(node.end_mark.index)


def _new_mapping(
    text: str, root: yaml.Node | None, name: str, pairs: Mapping[str, Value], behind: str, newline: str
) -> tuple[int, int, str]:
    before = _at(root, (behind,))
    if before is None:
        raise RunUsageError(f"the file has no key {behind!r}; write {name} by hand")
    end = _line_end(text, _last(before))
    inner = ", ".join(f"{key}: {_format_value(value)}" for key, value in pairs.items())
    return end, end, f"{newline}{name}: {{{inner}}}"


def _line_end(text: str, index: int) -> int:
    """End of the line of a place, its comment included."""
    found = re.compile(r"\r?\n|\Z").search(text, index)
    return found.start() if found else len(text)
