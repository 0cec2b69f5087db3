"""Messages about a wrong value of a file, in the words of the person who wrote it.

The library that checks files has a code for each kind of problem, and sentences for programmers ("Unable to
extract tag using discriminator").  Here each code becomes what stands in the file, what should stand there, and,
where it is known, the cure.  Of a value that may be one of several things ("a name or a table") the library
reports each that it is not; that becomes one sentence.
"""

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

LONGEST_SHOWN = 60
NUMBERS = {2: "two", 3: "three"}
NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9_]{0,31}$"  # of benches, axes, controllers
NAME_WORDS = "a name of letters, digits and underscores that begins with a letter, 32 at most"

_KINDS = {
    "string_type": "text",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "list_type": "a list, as in [1.0, 2.0]",
    "tuple_type": "a list, as in [1.0, 2.0]",
    "dict_type": "a table, as in {key: value}",
    "model_type": "a table, as in {key: value}",
    "model_attributes_type": "a table, as in {key: value}",
    "finite_number": "a finite number",
    "none_required": "left out",
}
_SLIPS = {  # by the unit of a key: what a number in another unit has to be multiplied with
    "nm": {"um for nm": 1e3},
    "um": {"mm for um": 1e3, "nm for um": 1e-3},
    "mm": {"m for mm": 1e3, "um for mm": 1e-3, "cm for mm": 10.0},
    "deg": {"rad for deg": 57.29577951308232},
    "ns": {"us for ns": 1e3},
    "us": {"ms for us": 1e3, "s for us": 1e6, "ns for us": 1e-3},
    "s": {"ms for s": 1e-3, "us for s": 1e-6},
    "hz": {"kHz for Hz": 1e3},
}
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
MEDIA_KEYS = ("material", "ambient", "filled", "behind")  # a name, or a table with the index
_TENFOLD = {"ten times too small": 10.0, "ten times too large": 0.1}
_BOUNDS = {
    "greater_than": "greater than {gt}",
    "greater_than_equal": "{ge} or more",
    "less_than": "less than {lt}",
    "less_than_equal": "{le} or less",
}


def quantity(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun, in the plural where it is not one: "1 chunk", "0 chunks", "9 axes"."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def key_of(name: str) -> str:
    """Return the last part of a place."""
    return name.rpartition(".")[2]


def exactly(count: int) -> BeforeValidator:
    """Return what refuses lists of another length, before it is asked what they hold."""

    def holds(value: Any) -> Any:  # noqa: ANN401 - YAML holds anything
        if isinstance(value, list) and len(value) != count:
            words = f"{NUMBERS[count]} entries"
            comma = "; a decimal comma? write points" if len(value) == 2 * count else ""
            raise PydanticCustomError(
                "entries",
                "should have {words}, not {got}{comma}",
                {"words": words, "got": len(value), "comma": comma},
            )
        return value

    return BeforeValidator(holds)


def slip(key: str, number: float, low: float, high: float) -> str:
    """Return the slip that takes a number out of a range, as a question; empty if no common one does.

    Parameters
    ----------
    key : str
        It ends with the unit, as in ``f_mm``.
    number : float
        Outside of the range.
    low, high : float
        The range.
    """
    for words, factor in (_SLIPS.get(key.rpartition("_")[2].casefold(), {}) | _TENFOLD).items():
        if low <= number * factor <= high:
            return f"; {words}?"
    return ""


def is_of_a_kind(details: Mapping[str, Any]) -> bool:
    """Return whether a problem says only that a value is of another kind than wanted."""
    return details["type"] in _KINDS


def place_words(tree: Any, place: Sequence[str | int]) -> str:  # noqa: ANN401 - YAML holds anything
    """Return a place as text: entries of lists by their name, or counted from 1."""
    words: list[str] = []
    for part in place:
        tree = _child(tree, part)
        if isinstance(part, int):
            name = tree.get("name") if isinstance(tree, dict) else None
            words.append(name if isinstance(name, str) else str(part + 1))
        else:
            words.append(part)
    return ".".join(words)


def sentence(name: str, several: Sequence[Mapping[str, Any]], known_keys: Callable[[], Sequence[str]]) -> str:
    """Say what is wrong at one place.

    Parameters
    ----------
    name : str
        The place as text, empty for the file itself.
    several : sequence of mapping
        What the library found there: one problem, or one for each thing that the value might have been.
    known_keys : callable
        Returns all keys that a file of this kind may have.
    """
    wanted = list(dict.fromkeys(_KINDS[details["type"]] for details in several if is_of_a_kind(details)))
    if wanted:
        given = several[0].get("input")
        index = key_of(name) in MEDIA_KEYS and isinstance(given, int | float) and not isinstance(given, bool)
        hint = f"; an index is written {{n: {given}}}" if index else ""
        return f"{name or 'the file'}: should be {' or '.join(wanted)}{_but(given)}{hint}"
    details = several[0]
    kind, context, key = details["type"], details.get("ctx", {}), key_of(name)
    if kind == "extra_forbidden":
        known, half = known_keys(), key.replace("diameter", "radius")
        if half != key and half in known:
            return f"unknown key {name!r}; give {half}, which is half of it"
        return f"unknown key {name!r}{near(key, [other for other in known if other != key])}"
    if kind == "missing":
        return f"key {name!r} is missing"
    if kind == "union_tag_not_found":
        choices = context.get("discriminator", "'kind'")
        return f"{name}: key {choices} is missing; it says what this is"
    if kind == "union_tag_invalid":
        expected = str(context.get("expected_tags", ""))
        tag, key = str(context.get("tag", "")), str(context.get("discriminator", "")).strip("'")
        hint = near(tag, [word.strip("' ") for word in expected.split(",")])
        return f"{name}.{key}: should be one of {expected}, not {tag!r}{hint}"
    said = _sentence(kind, str(details["msg"]), context, details.get("input"))
    return f"{name or 'the file'}: {said}{_bound_slip(key, kind, context, details.get('input'))}"


def _sentence(kind: str, message: str, context: Mapping[str, Any], given: Any) -> str:  # noqa: ANN401
    if kind == "value_error":
        return message.removeprefix("Value error, ")
    if kind == "entries":
        return message
    if kind in _BOUNDS:
        bound = _BOUNDS[kind].format(**{name: f"{limit:.9g}" for name, limit in context.items()})
        return f"should be {bound}, not {_quote(given)}"
    if kind in ("literal_error", "enum"):
        expected = str(context.get("expected", ""))
        hint = near(str(given), [word.strip("' ") for word in expected.replace(" or ", ",").split(",")])
        return f"should be {expected}, not {_quote(given)}{hint}"
    if kind == "string_pattern_mismatch":
        pattern = str(context.get("pattern", ""))
        return f"should be {NAME_WORDS if pattern == NAME_PATTERN else 'like ' + pattern}, not {_quote(given)}"
    if kind == "string_too_short":
        return "should not be empty"
    if kind == "too_short":
        least = context.get("min_length", 1)
        entries = "entry" if least == 1 else "entries"
        return f"should have at least {least} {entries}, not {context.get('actual_length')}"
    if kind == "too_long":
        return f"should have {context.get('max_length')} entries or fewer, not {context.get('actual_length')}"
    return message[:1].lower() + message[1:]


def _bound_slip(key: str, kind: str, context: Mapping[str, Any], given: Any) -> str:  # noqa: ANN401
    """The slip behind a number out of bounds: of a unit, since the bounds are far from all that is usual."""
    unit = key.rpartition("_")[2].casefold()
    if kind not in _BOUNDS or unit not in _SLIPS or not isinstance(given, int | float) or not given:
        return ""
    limit = next(iter(context.values()))
    low, high = (limit, math.inf) if kind.startswith("greater") else (-math.inf, limit)
    return "" if given * limit < 0.0 else slip(key, given, low, high)


def _but(given: Any) -> str:  # noqa: ANN401 - YAML holds anything
    """Value that stands there instead."""
    if given is None:
        return "; nothing is given"
    if isinstance(given, dict):
        return ", not a table"
    if isinstance(given, list):
        return ", not a list"
    quoted = isinstance(given, str) and _is_number(given)
    if isinstance(given, str) and _DECIMAL_COMMA.fullmatch(given):
        return f", not {_quote(given)}; write a decimal point: {given.replace(',', '.')}"
    return f", not {_quote(given)}" + ("; leave the quotes out" if quoted else "")


def _quote(given: Any) -> str:  # noqa: ANN401 - YAML holds anything
    text = {True: "true", False: "false"}[given] if isinstance(given, bool) else repr(given)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


def in_words(seconds: float) -> str:
    """Return a time as a person says it: 8 s, 3 min 20 s, 25 min, 2 h 10 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 10:
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    minutes = round(whole / 60)
    if minutes < 60:
        return f"{minutes} min"
    hours, rest = divmod(minutes, 60)
    return f"{hours} h {rest} min" if rest else f"{hours} h"


def near(word: str, others: Sequence[str]) -> str:
    """Return a question after the nearest of some words; empty if none is near."""
    same = [other for other in others if other.casefold() == word.casefold() and other != word]
    found = same or difflib.get_close_matches(word, others, n=1, cutoff=0.6)
    return f"; did you mean {found[0]!r}?" if found else ""


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _child(tree: Any, part: str | int) -> Any:  # noqa: ANN401 - YAML holds anything
    try:
        return tree[part]
    except (KeyError, IndexError, TypeError):
        return None
