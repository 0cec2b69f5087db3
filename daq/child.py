"""Programs of ours that run as processes of their own, started as ``python -m``.

A child looks for modules where its parent does, but not in the folder in which it is started (-P), and by
``rtpiv.child``: a file called sim.py or daq.py, wherever it is, hides nothing.
"""

import os
import sys


def child(module: str, *words: str) -> tuple[list[str], dict[str, str]]:
    """Return the command that runs a module with these arguments, and the environment that it needs."""
    places = os.pathsep.join(place for place in sys.path if place)
    return [sys.executable, "-P", "-m", "rtpiv.child", module, *words], os.environ | {"PYTHONPATH": places}
