"""Lasers that `laser off` may mean in a lab's folder: those of the bench files there, and those that are open.

A bench file is read as far as its devices of kind `timing`: a scene that is missing, or a mistake in another part
of it, must not keep a laser from being switched off.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from daq.timing.in_use import lasers_in_use
from daq.timing.pulses import Role
from daq.timing.timing_table import TimingTable
from ground.config import MAX_BYTES, open_document
from ground.errors import ConfigError
from ground.plain_file import read_plain

KIND = "timing"
_NAMES_ONE = re.compile(r"""kind["']?\s*:\s*["']?timing\b""")


@dataclass(frozen=True)
class KnownLaser:
    """A laser, and who names it.

    Parameters
    ----------
    name : str
        Of the device, or of the process that has it open.
    bench : Path or None
        Bench file; None of one that only a process knows.
    table : TimingTable or None
        Its timing unit; None if the file names it and does not say how to reach it.
    """

    name: str
    bench: Path | None
    table: TimingTable | None

    def __str__(self) -> str:
        where = [str(self.bench)] if self.bench is not None else []
        return f"{self.name} ({', '.join([*where, self.table.port if self.table is not None else 'no port'])})"


def lasers_near(start: Path) -> list[KnownLaser]:
    """Return the lasers of the bench files in a folder, or in the nearest one above it whose files name any."""
    start = start.resolve()
    for folder in (start, *start.parents):
        if found := [laser for path in _yaml_files(folder) for laser in lasers_of(path)]:
            return found
    return []


def lasers_of(path: Path) -> list[KnownLaser]:
    """Return the lasers that a file names; of a bench file that cannot be read one that has no port."""
    try:
        text = read_plain(path, MAX_BYTES).decode(errors="replace")
    except OSError:
        return []
    if not _NAMES_ONE.search(text):
        return []
    devices = _tree_of(path, text).get("devices")
    if not isinstance(devices, dict):
        return [KnownLaser("laser", path, None)]
    return [
        KnownLaser(str(name), path, _table_of(section))
        for name, section in devices.items()
        if isinstance(section, dict) and section.get("kind") == KIND
    ]


def is_unreadable(path: Path) -> bool:
    """Return whether there is such a file, and it cannot be read which lasers it names."""
    try:
        read_plain(path, MAX_BYTES)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


def open_lasers() -> list[KnownLaser]:
    """Return the lasers that any process of this user has open."""
    return [KnownLaser(f"laser of process {process}", None, table) for process, table in lasers_in_use()]


def each_once(lasers: list[KnownLaser]) -> list[KnownLaser]:
    """Leave out who is named a second time, with the same box on the same port."""
    once: dict[object, KnownLaser] = {}
    for laser in lasers:
        table = laser.table
        unit = (
            (laser.name, laser.bench)
            if table is None
            else (
                str(Path(table.port).resolve()),
                table.box,
                table.identity,
                tuple(sorted(table.channels.items())),
            )
        )
        once.setdefault(unit, laser)
    return list(once.values())


def _yaml_files(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.suffix in (".yaml", ".yml"))
    except OSError:
        return []


def _tree_of(path: Path, text: str) -> Mapping[str, Any]:
    """Contents of a file; as YAML has it where our own reader refuses it."""
    try:
        tree = open_document(path).tree
    except ConfigError:
        try:
            tree = yaml.safe_load(text)
        except (yaml.YAMLError, RecursionError, ValueError):
            return {}
    return tree if isinstance(tree, dict) else {}


def _table_of(section: Mapping[str, Any]) -> TimingTable | None:
    """A timing unit; if its section is wrong, what is right of it and enough to reach the box."""
    try:
        return TimingTable.model_validate({key: value for key, value in section.items() if key != "kind"})
    except ValidationError:
        pass
    box, port, baud, identity = (section.get(key) for key in ("box", "port", "baud", "identity"))
    if not (isinstance(box, str) and isinstance(port, str)):
        return None
    named, roles = section.get("channels"), {role.value for role in Role}
    return TimingTable.model_construct(
        box=box,
        port=port,
        baud=baud if isinstance(baud, int) else None,
        identity=identity if isinstance(identity, str) else None,
        channels={key: str(output) for key, output in named.items() if key in roles}
        if isinstance(named, dict)
        else {},
    )
