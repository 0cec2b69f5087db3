"""Compiling of kernels; the only place where numba options are chosen.

    compiler       where kernels are given to numba, as late as that can be
    kernel_cache   where compiled kernels are kept
    compile_news   that kernels are being compiled
    signatures     types of a kernel's arguments, to be compiled for ahead of any call

Every kernel of every package is compiled through ``kernel``:

* ``fastmath={"contract"}`` allows a*b + c to become one FMA and nothing else.  NaN keeps its meaning,
  comparisons stay exact, and the same bits come out for any number of threads, blocks and runs.  Which products
  become FMAs is chosen where a function is compiled.  One that is called with constants (``turn`` in
  ``tracer.kernels.chain``) is compiled another way inside its caller than by itself, and the process that compiles
  would use the one, later ones the other: such functions are `kernel_inlined`, and exist once.
* ``error_model="numpy"``: 0/0 is NaN, never an exception inside a loop.
* An integer written in a call is an int64 as any other, so that a kernel is compiled once for both (`compiler`).
* No runtime of numba's own (``_nrt``): a kernel that allocates does not compile, and a slice counts no references.
  Counting them, by locked instructions on one cache line that all threads share, took half of the time of a map,
  and more with more threads.  The caller of a kernel holds its arrays until it returns.
* ``nogil=True``: the row scheduler (ground.rows) runs kernels on all cores from ordinary threads.
* ``cache=True`` with a folder for each file that changes with all it is compiled from, see `kernel_cache`.

What belongs together comes as a named tuple where a function is called once for many rays (`RowScratch`,
`NodeScratch`, `Mirrors`, `World`), unpacked once at its top: measured, it costs nothing there.  What is inlined
for each ray takes vectors as tuples of three numbers (``tracer.kernels.vectors``), which stay in registers.

``kernel`` functions take scalars and contiguous arrays, write into ``out`` arguments that stand last,
allocate nothing and raise nothing.  Each is also tested as plain Python through ``.py_func``.

A kernel is given to numba when it is first called, with those that it calls, and numba is imported no earlier: a
command that traces nothing waits for neither, one that does finds the machine code of what it calls, in which its
callees already are.  What numba itself is taught (`overload`) waits as well; see `compiler`.
"""

from collections.abc import Callable
from functools import update_wrapper
from threading import RLock
from typing import TYPE_CHECKING, Any, TypeVar, cast

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[Any]  # what kernels take; each docstring says shape and dtype
else:  # a command asks for news of compiling before anything needs NumPy
    Array = Any
F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "_nrt": False,
    "nogil": True,
    "fastmath": {"contract"},
    "error_model": "numpy",
}
OVERLOADED: Any = {name: value for name, value in _OPTIONS.items() if name != "cache"}  # what types choose
overloads: list[tuple[Any, Callable[..., Any], dict[str, Any]]] = []  # not yet given to numba
_one_at_a_time = RLock()  # kernels are called from many threads


class Kernel:
    """A function that is given to numba when it is first called; numba takes it for what it then is.

    Parameters
    ----------
    py_func : callable
        The function as plain Python.
    options : dict
        Of `numba.njit`.
    """

    def __init__(self, py_func: Callable[..., Any], options: dict[str, Any]) -> None:
        update_wrapper(self, py_func)
        self.py_func = py_func
        self._options = options
        self._compiled: Any = None

    @property
    def dispatcher(self) -> Any:  # noqa: ANN401 - numba has no types
        """Numba's own object for it."""
        if self._compiled is None:
            from ground.jit.compiler import register_with_numba

            with _one_at_a_time:
                if self._compiled is None:
                    self._compiled = register_with_numba(self.py_func, self._options)
        return self._compiled

    def __call__(self, *arguments: Any) -> Any:  # noqa: ANN401
        """Run the compiled function."""
        return (self._compiled or self.dispatcher)(*arguments)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - signatures, stats and what else numba knows of it
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)


def kernel(function: F) -> F:
    """Compile `function` with the house options; ``.py_func`` stays reachable."""
    return cast("F", Kernel(function, _OPTIONS))


def kernel_inlined(function: F) -> F:
    """Compile like `kernel`, but always into its caller: one call left in a loop stops its vectorisation."""
    return cast("F", Kernel(function, {"forceinline": True, **_OPTIONS}))


def kernel_composed(function: F) -> F:
    """Compile like `kernel_inlined` what takes other kernels as arguments: each choice is a function of its own.

    It is part of its caller's file in the cache.  In its own it would never be found again: which function an
    argument was is known within one process only.
    """
    return cast("F", Kernel(function, {"forceinline": True, **OVERLOADED}))


def overload(function: Callable[..., Any], **options: Any) -> Callable[[F], F]:  # noqa: ANN401
    """Let compiled code take what the function below writes for its types instead of `function`, as numba does."""

    def register(writer: F) -> F:
        overloads.append((function, writer, options))
        return writer

    return register
