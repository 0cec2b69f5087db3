"""Options of a benchmark on the command line, and its figures as JSON."""

import json
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from pathlib import Path
from typing import Any

import numpy as np


def options(text: str | None, /, **defaults: Any) -> Namespace:  # noqa: ANN401 - of any option
    """Read the command line.

    Parameters
    ----------
    text : str
        Its help.
    **defaults
        Each option with its default: False for a flag, a list for several words, a type for one without default, a
        tuple for a positional word that is one of these.  ``-o`` (`out`, a path) is always among them.
    """
    parser = ArgumentParser(description=text, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=defaults.pop("out", None))
    for name, value in defaults.items():
        flag = f"--{name.replace('_', '-')}"
        if isinstance(value, tuple):
            parser.add_argument(name, choices=value)
        elif value is False:
            parser.add_argument(flag, action="store_true")
        elif isinstance(value, list):
            parser.add_argument(flag, nargs="*", type=type(value[0]) if value else str, default=value)
        else:
            kind, default = (value, None) if isinstance(value, type) else (type(value), value)
            parser.add_argument(flag, type=kind, default=default)
    return parser.parse_args()


def keep(figures: object, path: Path | None) -> None:
    """Print figures as JSON, and write them to a file if one is named; arrays to 5 digits."""
    text = json.dumps(figures, indent=1, default=lambda array: np.round(array, 5).tolist())
    print(text)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", encoding="utf-8")
