"""Suggestion of an option for an unknown one, by its letters or by words of the help texts."""

import argparse
import difflib

ALSO_CALLED = {"f": "focal", "resolution": "width", "working": "distance", "index": "glass", "material": "glass"}
UNITS = {"mm", "um", "px", "us", "s", "hz", "nm", "deg"}
NEAR, ALIKE = 0.85, 0.7  # similarity of a certain and of a possible misspelling


def near_option(parser: argparse.ArgumentParser, given: str) -> str:
    """Return "did you mean ..." with the most similar option; "" if none is similar.

    Parameters
    ----------
    parser : ArgumentParser
        Of the verb.
    given : str
        A word of the command line, as ``--f-mm`` or ``--f-mm=50``.
    """
    if not given.startswith("--"):
        return ""
    word = given.partition("=")[0].removeprefix("--").casefold()
    helps = {
        name: (action.help or "").casefold()
        for action in parser._actions
        for name in action.option_strings
        if name.startswith("--")
    }
    slip, alike = (difflib.get_close_matches(f"--{word}", helps, n=1, cutoff=cutoff) for cutoff in (NEAR, ALIKE))
    parts = [ALSO_CALLED.get(part, part) for part in word.split("-") if part not in UNITS]
    parts = [part for part in parts if len(part) > 2]
    by_help = [name for name, text in helps.items() if parts and all(part in f"{name} {text}" for part in parts)]
    found = [*slip, *sorted(by_help, key=lambda name: helps[name].find(parts[0])), *alike]
    return f"; did you mean {found[0]}?" if found else ""
