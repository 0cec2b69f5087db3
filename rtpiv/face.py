"""Python functions of the package, made from the verbs of the command line.

They print nothing, and without a folder (`out`) they leave nothing on the disk: intermediate files, such as chunks
of a series that its processes share, are in a temporary folder until the call returns.
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
FOR_PEOPLE = ("pictures", "files")  # options for pages and pictures, of a verb or of its `output`


def in_own_style(verb: Callable[P, R]) -> Callable[P, R]:
    """Return the function with pictures that do not depend on matplotlib settings of a script."""

    @wraps(verb)
    def call(*args: P.args, **named: P.kwargs) -> R:
        with own_style():
            return verb(*args, **named)

    return call


def quiet(verb: Callable[P, R]) -> Callable[P, R]:
    """Return the function without its printing."""

    @wraps(verb)
    def call(*args: P.args, **named: P.kwargs) -> R:
        with silence(), own_style():
            return verb(*args, **named)

    return call


def value_of(verb: Callable[P, R]) -> Callable[P, R]:
    """Return the function without its printing, that writes only into a folder given as `out`."""
    takes = signature(verb)

    @wraps(verb)
    def call(*args: P.args, **named: P.kwargs) -> R:
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

    return call
