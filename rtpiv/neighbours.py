"""Import of our packages beside modules of a user with the same names.

Our packages are called ground, piv, tracer, correction, stages, daq and sim.  A lab may have a sim.py or daq.py of
its own, beside its script or in PYTHONPATH, where Python looks first.  Neither may break the other (docs/adr/0020
compares solutions).  So a name that both use becomes one module that serves both:

* below it are our modules: ``sim.bench`` is ours,
* at its top are the user's names: ``sim.my_flow`` is theirs, and ``from sim import my_flow`` finds it.

Nothing of ours takes a name from the top of a package (tests/faces hold that), so nothing is missed.  The user's
file runs when one of its names is first asked for, and not at all if only we use the package.

Finder and loader are what Python asks of either and no subclasses of `importlib.abc`: importing that would take
longer than all that ``--help`` does.
"""

import sys
import threading
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.abc import Loader
else:
    Loader = object

PACKAGES = ("ground", "piv", "tracer", "correction", "stages", "daq", "sim", "benchmarks")
HOME = Path(__file__).resolve().parents[1]


class SharedModule(ModuleType):
    """A name that a user's module and a package of ours both have."""

    def __init__(self, theirs: ModuleSpec) -> None:
        super().__init__(theirs.name)
        self.__dict__["_waiting"] = (theirs, threading.RLock())

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever the user's file holds
        theirs, lock = self.__dict__["_waiting"]
        if theirs is not None and not name.startswith("__"):
            with lock:
                if self.__dict__["_waiting"][0] is not None:
                    self.__dict__["_waiting"] = (None, lock)  # a file that imports itself is not run twice
                    try:
                        theirs.loader.exec_module(self)
                    except BaseException:
                        self.__dict__["_waiting"] = (theirs, lock)
                        raise
            if name in self.__dict__:
                return self.__dict__[name]
        place = self.__dict__.get("__file__")
        raise AttributeError(f"module {self.__name__!r} ({place}) has no {name!r}")


class SharedLoader(Loader):
    """Makes the module of both; the user's file runs when one of its names is first asked for."""

    def __init__(self, theirs: ModuleSpec) -> None:
        self._theirs = theirs

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module."""
        return SharedModule(self._theirs)

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing yet."""


class NeighbourFinder:
    """Finds our packages by their names whatever else has these names; all others are left to Python."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return where a package of ours is; None for any other module."""
        if name not in PACKAGES or not (HOME / name).is_dir():
            return None
        found = PathFinder.find_spec(name)
        if found is None or found.loader is None or found.origin is None:  # nothing, or a folder of the same name
            return PathFinder.find_spec(name, [str(HOME)])
        if Path(found.origin).resolve().parent == HOME / name:
            return found
        shared = ModuleSpec(name, SharedLoader(found), origin=found.origin, is_package=True)
        shared.submodule_search_locations = [str(HOME / name), *(found.submodule_search_locations or ())]
        shared.has_location = True
        return shared


def install_import_hook() -> None:
    """Let our packages be found from now on, and below modules of a user that are imported already."""
    if any(isinstance(finder, NeighbourFinder) for finder in sys.meta_path):
        return
    sys.meta_path.insert(0, NeighbourFinder())
    for name in PACKAGES:
        module, own = sys.modules.get(name), str(HOME / name)
        if module is None or not (HOME / name).is_dir() or own in getattr(module, "__path__", ()):
            continue
        module.__path__ = [own, *getattr(module, "__path__", ())]
        if module.__spec__ is not None:
            module.__spec__.submodule_search_locations = module.__path__
