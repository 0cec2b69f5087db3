"""What a person at the stage reads and writes: the table of the axes, and ``axis=mm``."""

import math

from rich.table import Table

from daq.bench.bench_session import BenchSession
from daq.errors import RunUsageError


def where_table(session: BenchSession) -> Table:
    """Return where every axis is as a table."""
    table = Table()
    for column in ("axis", "carries", "along", "mm", "state", "limits"):
        table.add_column(column)
    for name, mm in session.where().items():
        about = session.bench.table.stages.axes[name]
        low, high = about.limits_mm
        shown = f"{mm:.4f}" if mm is not None else "unknown"
        state = session.stage.axis(name).state.value
        table.add_row(name, about.carries, about.along, shown, state, f"{low:g} to {high:g}")
    return table


def numbers(named: list[str]) -> dict[str, float]:
    """Return the positions or distances in ``axis=mm`` words.

    Raises
    ------
    RunUsageError
        A word is something else, an axis is named twice, or there is none.
    """
    found: dict[str, float] = {}
    for text in named:
        name, equals, value = text.partition("=")
        try:
            mm = float(value) if equals else math.nan
        except ValueError:
            mm = math.nan
        if not math.isfinite(mm):
            raise RunUsageError(f"{text!r}: say axis=mm, as in target_x=1.5")
        if name in found:
            raise RunUsageError(f"{name} is named twice; say one of the two")
        found[name] = mm
    if not found:
        raise RunUsageError("say at least one axis=mm")
    return found
