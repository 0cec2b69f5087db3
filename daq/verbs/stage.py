"""`rtpiv stage`: where the axes are; home, move or jog them, once or from a prompt that keeps the bench open."""

import math
from pathlib import Path

from rich.table import Table

from daq.acquisition.bench.bench_session import BenchSession, open_session
from daq.errors import RunUsageError
from daq.terminal import console, error_console


def stage(
    action: str = "session",
    axes: list[str] | None = None,
    bench: Path = Path("bench.yaml"),
    simulate: bool = False,
    home: bool = False,
) -> dict[str, float | None]:
    """Look at axes or move them.

    Parameters
    ----------
    action : {"session", "where", "home", "move", "jog"}
        What to do; `session` reads what to do from the terminal, or from a pipe.
    axes : list of str
        ``name=mm`` to move to, ``name=mm`` to jog by, names to home (default all); ignored by `where`.
    bench : Path
        bench.yaml.
    simulate : bool
        Use its simulation.
    home : bool
        Home every axis first, in the configured order: isel and Grbl forget their reference with every program.

    Returns
    -------
    dict
        Where every axis is afterwards [mm]; None where it is not known.

    Raises
    ------
    StageUsageError
        Out of limits, obstructed, or not homed; nothing has moved.
    """
    from daq.verbs.stage_prompt import Prompt

    named, say = axes or [], error_console()
    wanted = numbers(named) if action in ("move", "jog") else {}

    def tell(axis: str) -> None:
        say.print(f"homing {axis}")

    with open_session(bench, simulate) as session:
        if home:
            session.home(tell=tell)
        if action == "session":
            Prompt(session).run()
            return session.where()
        if action == "home":
            session.home(*named, tell=tell)
        elif action == "move":
            session.move(**wanted)
        elif action == "jog":
            session.jog(**wanted)
        shown, where = where_table(session), session.where()
    console().print(shown)
    return where


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
