"""The only place where numba options are chosen.

Every kernel of every package is compiled through ``kernel``:

* ``fastmath={"contract"}`` allows a*b + c to become one FMA and nothing else.  NaN keeps its meaning,
  comparisons stay exact, and the same bits come out for any number of threads, blocks and runs.  Which products
  become FMAs is chosen where a function is compiled.  One that is called with constants (``turn`` in
  ``tracer.kernels.chain``) is compiled another way inside its caller than by itself, and the process that compiles
  would use the one, later ones the other: such functions are `kernel_inlined`, and exist once.
* ``error_model="numpy"``: 0/0 is NaN, never an exception inside a loop.
* ``nogil=True``: the row scheduler (ground.rows) runs kernels on all cores from ordinary threads.
* ``cache=True`` with a folder for each file that changes with all it is compiled from, see `ground.kernel_cache`.

What belongs together comes as a named tuple where a function is called once for many rays (`RowScratch`,
`NodeScratch`, `Mirrors`, `World`), unpacked once at its top: measured, it costs nothing there.  What is inlined
for each ray (`land`, `turned_tangent`, `keep_view`) takes its numbers one by one: they stay in registers, while
taking an array out of a tuple within a loop is not free.

``kernel`` functions take scalars and contiguous arrays, write into ``out`` arguments that stand last,
allocate nothing and raise nothing.  Each is also tested as plain Python through ``.py_func``.
"""

import inspect
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import cgutils, event, types
from numba.extending import intrinsic, overload
from numba.np.arrayobj import make_array
from numpy.typing import NDArray

from ground.compile_news import CompileCount
from ground.kernel_cache import cache_folder

Array = NDArray[Any]  # what kernels take; each docstring says shape and dtype
F = TypeVar("F", bound=Callable[..., Any])


class _Compiling(event.Listener):
    """Hears of functions that no cache holds, and counts them."""

    def __init__(self) -> None:
        self._count = CompileCount()

    def on_start(self, event: object) -> None:
        """One is about to be compiled."""
        self._count.begun()

    def on_end(self, event: object) -> None:
        """One is compiled."""
        self._count.done()


event.register("numba:compile", _Compiling())  # type: ignore[no-untyped-call]


_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "fastmath": {"contract"}, "error_model": "numpy"}
OVERLOADED: Any = {name: value for name, value in _OPTIONS.items() if name != "cache"}  # what types choose


def kernel(function: F) -> F:
    """Compile `function` with the house options; ``.py_func`` stays reachable."""
    return _cached(function, **_OPTIONS)


def _cached(function: F, **options: Any) -> F:  # noqa: ANN401
    """Compile on first call; numba reads the folder for the machine code when a function is given to it."""
    folder, before = cache_folder(Path(inspect.getfile(function))), numba.config.CACHE_DIR  # type: ignore[attr-defined]
    if folder is None:
        return cast("F", numba.njit(**options | {"cache": False})(function))
    numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
    try:
        compiled = numba.njit(**options)(function)
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
    _keep_if_possible(compiled)
    return cast("F", compiled)


def _keep_if_possible(compiled: Any) -> None:  # noqa: ANN401 - numba has no types
    """Let a disk that is full cost the next process its time, not this one its results."""
    kept = compiled._cache.save_overload

    def save(*arguments: object) -> None:
        with suppress(OSError):
            kept(*arguments)

    compiled._cache.save_overload = save


def kernel_inlined(function: F) -> F:
    """Compile like `kernel`, but always into its caller: one call left in a loop stops its vectorisation."""
    return _cached(function, forceinline=True, **_OPTIONS)


def kernel_composed(function: F) -> F:
    """Compile like `kernel_inlined` what takes other kernels as arguments: each choice is a function of its own.

    It is part of its caller's file in the cache.  In its own it would never be found again: which function an
    argument was is known within one process only.
    """
    return cast("F", numba.njit(forceinline=True, **OVERLOADED)(function))


def unowned(array: Array) -> Array:
    """Return the same array, whose slices do not count references.

    A compiled function counts the references to an array's memory at each slice, by locked instructions on one
    cache line that all threads share: half the time of a map, and more with more threads.  The caller of a
    kernel holds its arrays until it returns, so nothing needs to be counted.
    """
    return array


@intrinsic  # type: ignore[untyped-decorator, unused-ignore]
def _without_owner(typing_context: object, array: types.Type) -> tuple[Any, Callable[..., Any]]:
    """Copy an array's structure and leave out who owns the memory."""

    def build(context: object, builder: object, signature: Any, arguments: Any) -> object:  # noqa: ANN401
        copy = make_array(signature.return_type)(context, builder, value=arguments[0])  # type: ignore[no-untyped-call]
        copy.meminfo = cgutils.get_null_value(copy.meminfo.type)  # type: ignore[no-untyped-call]
        copy.parent = cgutils.get_null_value(copy.parent.type)  # type: ignore[no-untyped-call]
        return copy._getvalue()

    return array(array), build


@overload(unowned)
def _unowned(array: types.Type) -> Callable[[types.Type], object] | None:
    def compiled(array: types.Type) -> object:
        return _without_owner(array)  # type: ignore[call-arg]

    return compiled if isinstance(array, types.Array) else None
