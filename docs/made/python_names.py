"""The page of Python names: what each package shows at its top, and the values that these functions give."""

import inspect
import re
from importlib import import_module
from types import UnionType
from typing import Any, get_args, get_type_hints

PACKAGES = (
    "rtpiv",
    "piv",
    "tracer",
    "correction",
    "stages",
    "daq",
    "sim",
)  # whom people need first
OURS = (*PACKAGES, "ground")


def text() -> str:
    """Write Markdown: one part a package; names as Sphinx reads their docstrings."""
    parts = list[str]()
    for package, (shown, given) in names().items():
        parts += [f"## {package}", (inspect.getdoc(import_module(package)) or "").split("\n")[0]]
        parts += [_entry(name, thing) for name, thing in shown.items()]
        parts += [f"### What functions of {package} give"] * bool(given)
        parts += [_entry(name, thing) for name, thing in given.items()]
    return "\n\n".join(parts) + "\n"


def names() -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Of each package what it shows at its top, and what its functions give beside, by full names."""
    faces = {package: import_module(package) for package in PACKAGES}
    there = {id(getattr(face, name)) for face in faces.values() for name in face.__all__}
    found = {}
    for package, face in faces.items():
        shown = {f"{package}.{name}": getattr(face, name) for name in face.__all__}
        given = [value for thing in shown.values() for value in values_of(thing) if id(value) not in there]
        there |= set(map(id, given))
        found[package] = shown, {f"{value.__module__}.{value.__name__}": value for value in given}
    return found


def values_of(thing: Any) -> list[type]:  # noqa: ANN401 - whatever a package shows
    """Classes of ours that a function returns."""
    if not inspect.isfunction(thing):
        return []
    gives = get_type_hints(inspect.unwrap(thing)).get("return")
    either = get_args(gives) if isinstance(gives, UnionType) else (gives,)
    return [value for value in either if inspect.isclass(value) and value.__module__.partition(".")[0] in OURS]


def _entry(name: str, thing: Any) -> str:  # noqa: ANN401 - whatever a package shows
    """What Sphinx is told of a name; of what has no docstring, the sentence that its package has."""
    if callable(thing):
        kind, members = ("class", "   :members:\n") if inspect.isclass(thing) else ("function", "")
        return f"```{{eval-rst}}\n.. auto{kind}:: {name}\n{members}```"
    package, _, short = name.rpartition(".")
    sentences = re.split(r"(?<=\.)\s+", inspect.getdoc(import_module(package)) or "")
    said = [" ".join(sentence.split()) for sentence in sentences if sentence.startswith(f"{short} ")]
    if not said:
        raise LookupError(f"the docstring of {package} has no sentence that begins with {short}")
    return f"```{{eval-rst}}\n.. py:data:: {name}\n\n   {said[0]}\n```"
