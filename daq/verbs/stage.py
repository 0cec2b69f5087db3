"""`rtpiv stage`: where the axes are; home, move or jog them."""

import math
from pathlib import Path

from rich.table import Table

from daq.bench.bench_file import load_bench
from daq.bench.opened import open_stage
from daq.errors import RunUsageError
from daq.terminal import console, error_console


def stage(
    action: str, axes: list[str] | None = None, bench: Path = Path("bench.yaml"), simulate: bool = False
) -> dict[str, float | None]:
    """Look at axes or move them.

    Parameters
    ----------
    action : {"where", "home", "move", "jog"}
        What to do.
    axes : list of str
        ``name=mm`` to move to, ``name=mm`` to jog by, names to home (default all); ignored by `where`.
    bench : Path
        bench.yaml.
    simulate : bool
        Use its simulation.

    Returns
    -------
    dict
        Where every axis is afterwards [mm]; None where it is not known.

    Raises
    ------
    StageUsageError
        Out of limits, obstructed, or not homed; nothing has moved.
    """
    named = axes or []
    loaded = load_bench(bench)
    with open_stage(loaded, simulate) as opened:
        if action == "home":
            say = error_console()
            opened.home(named or None, tell=lambda axis: say.print(f"homing {axis}"))
        elif action == "move":
            opened.move(_numbers(named))
        elif action == "jog":
            by_mm = _numbers(named)
            opened.move({name: opened.axis(name).position_mm + mm for name, mm in by_mm.items()})
        where = opened.where_mm()
        table = Table()
        for column in ("axis", "carries", "along", "mm", "state", "limits"):
            table.add_column(column)
        for name, mm in where.items():
            about = loaded.table.stages.axes[name]
            low, high = about.limits_mm
            shown = f"{mm:.4f}" if mm is not None else "unknown"
            state = opened.axis(name).state.value
            table.add_row(name, about.carries, about.along, shown, state, f"{low:g} to {high:g}")
    console().print(table)
    return where


def _numbers(named: list[str]) -> dict[str, float]:
    numbers = {}
    for text in named:
        name, equals, value = text.partition("=")
        try:
            mm = float(value) if equals else math.nan
        except ValueError:
            mm = math.nan
        if not math.isfinite(mm):
            raise RunUsageError(f"{text!r}: say axis=mm, as in target_x=1.5")
        numbers[name] = mm
    if not numbers:
        raise RunUsageError("say at least one axis=mm")
    return numbers
