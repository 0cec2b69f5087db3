"""SciPy for a command: without the texts of its help, and without what NumPy brings to test and to wrap Fortran.

As it is imported, SciPy reads the docstring of each function that takes arrays of other libraries as well, to add
a table to it, and copies all names of NumPy, for which NumPy imports every part that it has: a third of what a
command waits for SciPy.  Nobody asks a command for that help.  Programs that import us keep SciPy as it is.
"""

import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

WHERE = "scipy._lib._array_api"
LEFT_OUT = ("f2py", "testing")  # of NumPy


class Undescribed:
    """In place of SciPy's reading of a docstring: takes notes, and gives the docstring back as it was."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._text = function.__doc__ or ""

    def __getitem__(self, section: str) -> list[str]:
        return []

    def __str__(self) -> str:
        return f"\n{self._text}"


class _Loader:
    """Runs the module with fewer names of NumPy, and leaves `Undescribed` in it."""

    def __init__(self, spec: ModuleSpec) -> None:
        assert spec.loader is not None
        self._loader = spec.loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Return what its own loader makes."""
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Run it."""
        import numpy

        names = numpy.__all__
        parts: set[str] = getattr(numpy, "__numpy_submodules__", set())
        left_out = parts.intersection(LEFT_OUT)
        numpy.__all__ = [name for name in names if name not in LEFT_OUT]
        parts -= left_out
        try:
            self._loader.exec_module(module)
        finally:
            numpy.__all__ = names
            parts |= left_out
        if hasattr(module, "FunctionDoc"):  # another SciPy may have none
            module.FunctionDoc = Undescribed  # type: ignore[attr-defined]


class _Finder:
    """Finds that one module; all others are left to Python."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return where it is."""
        spec = PathFinder.find_spec(name, path) if name == WHERE else None
        if spec is not None and spec.loader is not None:
            spec.loader = _Loader(spec)  # type: ignore[assignment]
        return spec


def leave_help_out() -> None:
    """Do so from now on in this process, and in those that are forked from it."""
    if WHERE not in sys.modules and not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
