"""Statistics of the readings of gauges over some steps of a run: number, mean, standard deviation.

A result says it of the steps that its frames are of, each step once; see `daq.bench.reading`.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from math import fsum, sqrt
from statistics import fmean, stdev
from typing import Any, NotRequired

from daq.runs.journal_lines import ReadingRecord
from daq.runs.records import Count, Record

ATTRIBUTE = "readings"  # of a file of vectors


class Shown(Record):
    """Statistics of a gauge over some steps; `std` of two or more, `mean` of one or more."""

    unit: str
    steps: Count  # at which it showed a value
    missing: Count  # at which it showed none
    mean: NotRequired[float]
    std: NotRequired[float]  # from step to step


def reading_statistics(steps: Iterable[Mapping[str, ReadingRecord]]) -> dict[str, Shown]:
    """Return it by the name of each gauge, from what the journal has of each step."""
    records: dict[str, list[ReadingRecord]] = {}
    for step in steps:
        for name, record in step.items():
            records.setdefault(name, []).append(record)
    return {name: _statistics(of_one) for name, of_one in records.items()}


def _statistics(records: list[ReadingRecord]) -> Shown:
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


def readings_attribute(shown: Mapping[str, Shown], about: str = "") -> dict[str, Any]:
    """Return the attribute of a file of vectors, JSON in plain letters; nothing where no gauge was read.

    Parameters
    ----------
    shown : mapping of str to Shown
        By the name of each gauge.
    about : str
        Of which run, where a file holds several, such as "behind".
    """
    return {f"{about}_{ATTRIBUTE}" if about else ATTRIBUTE: json.dumps(shown)} if shown else {}


def merge_readings(runs: Iterable[Mapping[str, Shown]]) -> dict[str, Shown]:
    """Merge the statistics of several runs, exactly as if their steps were those of one.

    Gauges are the same if name and unit are; where one name has several units, the unit stands behind it.
    """
    found: dict[tuple[str, str], list[Shown]] = {}
    for run in runs:
        for name, shown in run.items():
            found.setdefault((name, shown["unit"]), []).append(shown)
    names = Counter(name for name, _ in found)
    return {
        name if names[name] == 1 else f"{name} [{unit}]": _merge(unit, parts)
        for (name, unit), parts in found.items()
    }


def _merge(unit: str, parts: list[Shown]) -> Shown:
    steps = sum(part["steps"] for part in parts)
    found: Shown = {"unit": unit, "steps": steps, "missing": sum(part["missing"] for part in parts)}
    known = [part for part in parts if part["steps"]]
    if known:
        found["mean"] = mean = fsum(part["steps"] * part["mean"] for part in known) / steps
    if steps > 1:
        within = fsum((part["steps"] - 1) * part["std"] ** 2 for part in known if "std" in part)
        between = fsum(part["steps"] * (part["mean"] - mean) ** 2 for part in known)
        found["std"] = sqrt((within + between) / (steps - 1))
    return found
