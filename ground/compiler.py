"""Where kernels are given to numba; imported when the first one is called.

Numba meets our `Kernel` objects as globals of the functions that it compiles, and takes each for what it is made
of it here.
"""

import glob
import inspect
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
import numba.extending
from numba.core import event, types
from numba.core.runtime import rtsys  # type: ignore[attr-defined]
from numba.extending import overload, typeof_impl

import ground.compile_news as compile_news
import ground.unowned  # noqa: F401 - teaches numba
from ground.compile_news import CompileCount
from ground.jit import Kernel, overloads
from ground.kernel_cache import cache_folder
from ground.signatures import plain


def given_to_numba(function: Callable[..., Any], options: dict[str, Any]) -> Any:  # noqa: ANN401
    """Return numba's object for a function; what is in its folder of the cache is found when it is called."""
    while overloads:
        replaced, writer, how = overloads.pop(0)
        overload(replaced, **how)(writer)
    if not options.get("cache"):
        return numba.njit(**options)(function)
    folder, before = cache_folder(Path(inspect.getfile(function))), numba.config.CACHE_DIR  # type: ignore[attr-defined]
    if folder is None:
        return numba.njit(**options | {"cache": False})(function)
    numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
    try:
        compiled = numba.njit(**options)(function)
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
    _keep_if_possible(compiled)
    _load_at_once(compiled)
    return compiled


def _keep_if_possible(compiled: Any) -> None:  # noqa: ANN401 - numba has no types
    """Let a disk that is full cost the next process its time, not this one its results."""
    kept = compiled._cache.save_overload

    def save(*arguments: object) -> None:
        with suppress(OSError):
            kept(*arguments)

    compiled._cache.save_overload = save


def _load_at_once(compiled: Any) -> None:  # noqa: ANN401 - numba has no types
    """Load machine code without first preparing for compiling, which takes longer than all the loading.

    Before it looks into its cache, numba imports what it knows of NumPy, SciPy's linear algebra included.  Of that
    machine code needs the runtime alone, which counts references; whatever compiles asks for all of it itself.
    """
    cache = compiled._cache
    try:
        found, guarded = cache._load_overload, cache._guard_against_spurious_io_errors
    except AttributeError:  # another version of numba: its own way
        return

    def load(signature: object, target_context: object) -> object:
        rtsys.initialize(target_context)
        with guarded():
            return found(signature, target_context)

    cache.load_overload = load


def files_in_use() -> list[Path]:
    """Files of the cache that hold what this process has called so far; none of a numba with another cache."""
    found: set[Path] = set()
    for module in list(sys.modules.values()):
        for kernel in list(vars(module).values()):
            if not isinstance(kernel, Kernel) or kernel._compiled is None or not kernel.compiled.signatures:
                continue
            cache = kernel.compiled._cache
            if folder := getattr(cache, "cache_path", None):  # None: this one is not kept
                with suppress(AttributeError):
                    found.update(Path(folder).glob(f"{glob.escape(cache._impl.filename_base)}.*"))
    return sorted(file for file in found if file.suffix in (".nbi", ".nbc"))


@typeof_impl.register(Kernel)
def _type_of_kernel(kernel: Kernel, context: object) -> types.Type:
    return types.Dispatcher(kernel.compiled)


class _Compiling(event.Listener):
    """Hears of functions that no cache holds, and counts them; a kernel is compiled with its callees in one go."""

    def __init__(self) -> None:
        self._count = CompileCount()
        self._depth = 0

    def on_start(self, event: Any) -> None:  # noqa: ANN401
        """One is about to be compiled."""
        if self._depth == 0 and compile_news.make_helper is not None:
            with suppress(TypeError):  # called with something that no list of kernels has
                compile_news.missing(_place(event), [plain(each) for each in event.data["args"]])
        self._depth += 1
        self._count.begun()

    def on_end(self, event: Any) -> None:  # noqa: ANN401
        """One is compiled."""
        self._depth -= 1
        if self._depth == 0:
            compile_news.compiled(_place(event))
        self._count.done()


def _place(event: Any) -> str:  # noqa: ANN401
    function = event.data["dispatcher"].py_func
    return f"{function.__module__}:{function.__qualname__}"


event.register("numba:compile", _Compiling())  # type: ignore[no-untyped-call]
