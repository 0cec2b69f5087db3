"""One line for a value that holds arrays: a notebook shows what it is, not a million numbers."""

from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

C = TypeVar("C", bound=type)
LONGEST = 80
FEW = 6


def short_repr(cls: C) -> C:
    """Give a dataclass a ``repr`` of one line: arrays by type and shape, what is in it by its name."""

    def one_line(self: Any) -> str:  # noqa: ANN401 - any dataclass
        words = [f"{field.name}={short(getattr(self, field.name))}" for field in fields(self) if field.repr]
        return f"{type(self).__name__}({', '.join(words)})"

    cls.__repr__ = one_line  # type: ignore[method-assign, assignment]
    return cls


def short(value: Any) -> str:  # noqa: ANN401 - anything
    """Return a few words for a value."""
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        sides = " x ".join(map(str, value.shape))
        return f"<{value.dtype} {sides}>" if sides else f"{value:.6g}"
    if isinstance(value, float):
        return f"{value:.6g}"
    if is_dataclass(value):
        return f"{type(value).__name__}(...)"
    if isinstance(value, list | tuple | dict) and (len(value) > FEW or len(repr_of(value)) > LONGEST):
        return f"<{type(value).__name__} of {len(value)}>"
    return repr_of(value)


def repr_of(value: Any) -> str:  # noqa: ANN401 - anything
    """Return the value as Python writes it, cut where it is long; its parts are short as well."""
    if isinstance(value, list | tuple):
        begin, end = ("[", "]") if isinstance(value, list) else ("(", ")")
        if len(value) > FEW:
            return f"<{type(value).__name__} of {len(value)}>"
        return begin + ", ".join(short(part) for part in value) + end
    text = f"{type(value).__name__}(...)" if is_dataclass(value) else repr(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
