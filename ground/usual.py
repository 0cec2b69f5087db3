"""Numbers that a file may hold and that few labs have: they are asked about, never refused.

A table says beside a key what is usual, as in ``f_mm: Annotated[Positive | None, Usual(4.0, 1200.0)]``.  A number
outside is most often the right one in another unit, so the question names the slip: 0.025 as `f_mm` is 25 mm in
metres.  What nothing can be is refused by the bounds of the field itself, with the same hint.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from ground.config import Document, Place, Table
from ground.errors import Problem
from ground.plain_words import place_words, slip


@dataclass(frozen=True)
class Usual:
    """Usual range of a number: `low` to `high`, both included."""

    low: float
    high: float


def plausibility_questions(document: Document, table: Table) -> list[Problem]:
    """Return a question, with its line, for every number of a checked file that is not usual."""
    return [
        Problem(document.line(place), f"{place_words(document.tree, place)}: {asked}")
        for place, asked in _questions_of(table, ())
    ]


def question(key: str, number: float, usual: Usual) -> str:
    """Ask about a number of a key with its unit, such as ``f_mm``; "" if it is usual."""
    if usual.low <= number <= usual.high:
        return ""
    hint = slip(key, number, usual.low, usual.high)
    return f"is {number:.6g} right? Usual are {usual.low:g} to {usual.high:g}{hint}"


def _questions_of(value: object, place: Place) -> Iterator[tuple[Place, str]]:
    """Questions about a value and all that is in it."""
    if isinstance(value, Table):
        for name in value.model_fields_set:
            inner, at = getattr(value, name), (*place, name)
            for usual in type(value).model_fields[name].metadata:
                if isinstance(usual, Usual):
                    yield from _about(inner, at, name, usual)
            yield from _questions_of(inner, at)
    elif isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _questions_of(inner, (*place, name))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _questions_of(inner, (*place, index))


def _about(value: object, place: Place, key: str, usual: Usual) -> Iterator[tuple[Place, str]]:
    """The question about the number of a key, or about the first unusual one of its list or table."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    numbers = [(place, value)] if inner is None else [((*place, part), number) for part, number in inner]
    for at, number in numbers:
        if isinstance(number, int | float) and (asked := question(key, number, usual)):
            yield at, asked
            return
