"""Readers of option values, and the types of parameters that select them.

`Positive` is a float for Python, and for the command line a number that `positive` reads and checks.
"""

import argparse
import math
from typing import Annotated, Literal


def finite(text: str) -> float:
    """Read a number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"should be a number, not {text!r}{_with_point(text)}")
    return value


def positive(text: str) -> float:
    """Read a number above 0."""
    if (value := finite(text)) <= 0.0:
        raise argparse.ArgumentTypeError(f"should be above 0, not {text}")
    return value


def length(text: str) -> float:
    """Read a number of 0 or above."""
    if (value := finite(text)) < 0.0:
        raise argparse.ArgumentTypeError(f"should be 0 or above, not {text}")
    return value


def count(text: str) -> int:
    """Read 1, 2, 3 ..."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"should be 1, 2, 3 ..., not {text!r}")
    return int(text)


def whole(text: str) -> int:
    """Read a whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"should be a whole number, not {text!r}") from None


def port(text: str) -> int:
    """Read a port of TCP; 0 for any that is free."""
    if not (text.isascii() and text.isdecimal()) or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"should be 0 to 65535, not {text!r}")
    return int(text)


def steps(text: str) -> tuple[str, ...]:
    """Read words with commas between them; none for "none"."""
    return () if text == "none" else tuple(word.strip() for word in text.split(","))


def _with_point(text: str) -> str:
    """Guess that a comma was meant as a decimal point."""
    pointed = text.strip().replace(",", ".", 1)
    return f"; write a decimal point: {pointed}" if pointed.replace(".", "", 1).lstrip("+-").isdecimal() else ""


Positive = Annotated[float, positive]
Length = Annotated[float, length]  # 0 or above
Count = Annotated[int, count]
Port = Annotated[int, port]
Steps = Annotated[tuple[str, ...], steps]
DewarpOrder = Literal[2, 3, 4, 5]
