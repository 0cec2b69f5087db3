"""Pictures drawn by Matplotlib's defaults to files, whatever the environment, the home or a script sets for it.

Jupyter names a backend in MPLBACKEND for every command of a notebook, and Matplotlib is not imported where that is
not installed; a matplotlibrc may ask for LaTeX (``text.usetex``), a grid, or another font.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

ENVIRONMENT = {"MPLBACKEND": "agg", "MATPLOTLIBRC": os.devnull}


@contextmanager
def own_style() -> Iterator[None]:
    """Draw in our own style until the end of the block; the settings of a script are as before after it."""
    was_imported = "matplotlib" in sys.modules
    if was_imported:
        import matplotlib as mpl

        with mpl.rc_context():
            mpl.rcdefaults()
            mpl.rcParams["text.parse_math"] = False
            yield
        return
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    os.environ.update(ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
    if "matplotlib" in sys.modules:  # imported meanwhile: now read what the script would have read
        import matplotlib as mpl

        mpl.rcParams.update(mpl.rc_params())
        with suppress(ValueError):
            mpl.rcParams["backend"] = os.environ.get("MPLBACKEND") or mpl.rcParams["backend"]
