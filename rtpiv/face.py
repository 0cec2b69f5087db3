"""What functions at the top of rtpiv do otherwise than the verbs of the command line that they are.

Saving and printing belong to the command line.  From Python values come in and values go out: nothing is printed,
and without a folder (`out`) nothing is left on the disk either; what the work itself writes on its way, such as
chunks of a series that its processes share, lies in a folder of the system for as long as the call lasts.
"""

from collections.abc import Callable
from dataclasses import fields, replace
from functools import wraps
from inspect import signature
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ParamSpec, TypeVar

from ground.terminal import silence
from rtpiv.analysis.pictures.own_style import own_style

P = ParamSpec("P")
R = TypeVar("R")
FOR_PEOPLE = ("pictures", "files")  # whether pages and the like are written, of a verb or of its `output`


def in_own_style(verb: Callable[P, R]) -> Callable[P, R]:
    """Return the same function, whose pictures do not depend on the settings of a script."""

    @wraps(verb)
    def called(*args: P.args, **named: P.kwargs) -> R:
        with own_style():
            return verb(*args, **named)

    return called


def quiet(verb: Callable[P, R]) -> Callable[P, R]:
    """The same function, that prints nothing."""

    @wraps(verb)
    def called(*args: P.args, **named: P.kwargs) -> R:
        with silence(), own_style():
            return verb(*args, **named)

    return called


def value_of(verb: Callable[P, R]) -> Callable[P, R]:
    """The same function, that prints nothing and writes only into a folder that is named."""
    takes = signature(verb)

    @wraps(verb)
    def called(*args: P.args, **named: P.kwargs) -> R:
        given = takes.bind(*args, **named)
        with silence(), own_style():
            if given.arguments.get("out") is not None:
                return verb(*args, **named)
            with TemporaryDirectory(prefix="rtpiv-", ignore_cleanup_errors=True) as folder:
                given.arguments["out"] = Path(folder) / "out"
                given.arguments |= dict.fromkeys((name for name in FOR_PEOPLE if name in takes.parameters), False)
                if "output" in takes.parameters:
                    asked = given.arguments.get("output", takes.parameters["output"].default)
                    names = {field.name for field in fields(asked)}.intersection(FOR_PEOPLE)
                    given.arguments["output"] = replace(asked, **dict.fromkeys(names, False))
                found = verb(*given.args, **given.kwargs)
                _ = getattr(found, "vectors", None)  # read as long as the files are there
                return found

    return called
