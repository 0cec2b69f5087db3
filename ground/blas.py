"""One thread for the linear algebra of NumPy and SciPy, while matrices are narrow.

OpenBLAS shares every product and solution among all cores.  Ours are narrow: it takes no less time and twice the
CPU time, other processes wait, and the last bits depend on the computer.  Its environment variable is read when
NumPy is imported, which a script has done long before it calls us.
"""

import ctypes
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from threading import Lock

NAMES = ("scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads", "openblas_{}_num_threads64_",
         "openblas_{}_num_threads")  # fmt: skip
_lock = Lock()
_inside = 0  # calls that have asked for it, from any thread
_before: dict[str, int] = {}


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let OpenBLAS use one thread until the end of the block, and of all blocks of other threads."""
    global _inside
    with _lock:
        if _inside == 0:
            _before.update({path: both[0]() for path in _libraries() if (both := _get_and_set(path)) is not None})
            _set(dict.fromkeys(_before, 1))
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                _set(_before)
                _before.clear()


def _set(threads: dict[str, int]) -> None:
    for path, count in threads.items():
        found = _get_and_set(path)
        assert found is not None
        found[1](count)


def _libraries() -> set[str]:
    """Libraries of OpenBLAS in this process; where the system does not list them, those beside NumPy and SciPy."""
    try:
        lines = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines()
        return {line[line.index("/") :] for line in lines if "openblas" in line and "/" in line}
    except OSError:
        known = [module for name in ("numpy", "scipy.linalg") if (module := sys.modules.get(name)) is not None]
        homes = [
            next(p for p in Path(str(each.__file__)).parents if p.name in ("numpy", "scipy")) for each in known
        ]
        folders = [folder for home in homes for folder in (home.with_name(f"{home.name}.libs"), home / ".dylibs")]
        return {str(file) for folder in folders for file in folder.glob("*openblas*")}


@cache
def _get_and_set(path: str) -> tuple[Callable[[], int], Callable[[int], object]] | None:
    """Functions that read and set the number of threads of a library; None if it has other names for them."""
    try:
        library = ctypes.CDLL(path)
    except OSError:
        return None
    for name in NAMES:
        if hasattr(library, name.format("set")) and hasattr(library, name.format("get")):
            return getattr(library, name.format("get")), getattr(library, name.format("set"))
    return None
