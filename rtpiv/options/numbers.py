"""Numbers of the command line: what cannot be is refused with the number that was written."""

import argparse
import math


def finite(text: str) -> float:
    """Read a number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"should be a number, not {text!r}")
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


def steps(text: str) -> tuple[str, ...]:
    """Read words with commas between them; none for "none"."""
    return () if text == "none" else tuple(word.strip() for word in text.split(","))


def port(text: str) -> int:
    """Read a port of TCP; 0 for any that is free."""
    if not (text.isascii() and text.isdecimal()) or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"should be 0 to 65535, not {text!r}")
    return int(text)


def count(text: str) -> int:
    """Read 1, 2, 3 ..."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"should be 1, 2, 3 ..., not {text!r}")
    return int(text)
