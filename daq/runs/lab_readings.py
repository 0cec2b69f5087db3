"""What gauges of the lab showed over some steps of a run: how many showed it, their mean, how it varied.

A result says it of the steps that its frames are of, each step once; see `daq.bench.reading`.
"""

import json
from collections.abc import Iterable, Mapping
from statistics import fmean, stdev
from typing import Any, NotRequired

from pydantic import with_config
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from daq.runs.journal_lines import ReadingRecord
from daq.runs.records import STRICT, Count

ATTRIBUTE = "readings"  # of a file of vectors


@with_config(STRICT)
class Shown(TypedDict):
    """What a gauge showed over some steps; `std` of two or more, `mean` of one or more."""

    unit: str
    steps: Count  # at which it showed a value
    missing: Count  # at which it showed none
    mean: NotRequired[float]
    std: NotRequired[float]  # from step to step


def shown_over(steps: Iterable[Mapping[str, ReadingRecord]]) -> dict[str, Shown]:
    """Return it by the name of each gauge, from what the journal has of each step."""
    records: dict[str, list[ReadingRecord]] = {}
    for step in steps:
        for name, record in step.items():
            records.setdefault(name, []).append(record)
    return {name: _shown(of_one) for name, of_one in records.items()}


def _shown(records: list[ReadingRecord]) -> Shown:
    values = [record["value"] for record in records if "value" in record]
    found: Shown = {
        "unit": records[0]["unit"],
        "steps": len(values),
        "missing": len(records) - len(values),
    }
    if values:
        found["mean"] = fmean(values)
    if len(values) > 1:
        found["std"] = stdev(values)
    return found


def said_in_files(shown: Mapping[str, Shown]) -> dict[str, Any]:
    """Return the attribute of a file of vectors, JSON in plain letters; nothing where no gauge was read."""
    return {ATTRIBUTE: json.dumps(shown)} if shown else {}
