"""Messages of every protocol as vendors and others have documented them; the grammars are judged by these."""

from importlib import import_module
from typing import Any, NamedTuple


class Example(NamedTuple):
    """A documented message: its bytes, what they mean, and where that is written."""

    raw: bytes
    message: Any
    source: str


def examples_of(cls: type) -> tuple[Example, ...]:
    """Return the documented messages of a class."""
    table = import_module(f"tests.documented.{cls.__module__.rpartition('.')[2]}").EXAMPLES
    return tuple(example for example in table if type(example.message) is cls)
