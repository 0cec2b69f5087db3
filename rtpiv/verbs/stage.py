"""`rtpiv stage`: where the axes are; home, move or jog them, once or from a prompt that keeps the bench open."""

from collections.abc import Sequence
from typing import Literal

from daq.bench.bench_session import open_session
from ground.terminal import console, error_console
from rtpiv.verbs.operator import operator_of
from rtpiv.verbs.paths import Named
from rtpiv.verbs.stage_prompt import numbers, where_table


def stage(
    action: Literal["session", "where", "home", "move", "jog"] = "session",
    axes: Sequence[str] = (),
    /,
    bench: Named = "bench.yaml",
    simulate: bool = False,
    home: bool = False,
) -> dict[str, float | None]:
    """Look at axes or move them.

    Parameters
    ----------
    action : {"session", "where", "home", "move", "jog"}
        What to do; `session` reads what to do from the terminal, or from a pipe.
    axes : sequence of str
        ``name=mm`` to move to, ``name=mm`` to jog by, names to home (default all); ignored by `where`.
    bench : path
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
    from rtpiv.verbs.stage_prompt import Prompt

    named, say = list(axes), error_console()
    wanted = numbers(named) if action in ("move", "jog") else {}

    def tell(axis: str) -> None:
        say.print(f"homing {axis}")

    with open_session(bench, simulate) as session:
        if not simulate:
            session.stage.turned_by(operator_of(None, simulate).reads)
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
