"""Numba, imported without coverage, and without what the environment may switch off.

Wherever coverage is installed numba imports it, to ask whether coverage is measured; where it is not loaded yet,
it is not. That was a sixth of what a process waits for numba.

NUMBA_DISABLE_JIT leaves no kernel to compile, and NUMBA_NUM_THREADS of 0 stops numba's import; both are dropped:
numba reads the environment whenever it compiles.  Only a run that measures coverage interprets kernels.
"""

import os
import sys

if "coverage" in sys.modules:
    import numba
else:
    os.environ.pop("NUMBA_DISABLE_JIT", None)
    threads = os.environ.get("NUMBA_NUM_THREADS", "1").strip()
    if not threads.isdecimal() or int(threads) == 0:
        del os.environ["NUMBA_NUM_THREADS"]
    sys.modules["coverage"] = None  # type: ignore[assignment]
    try:
        import numba
    finally:
        del sys.modules["coverage"]
    numba.config.reload_config()  # type: ignore[no-untyped-call]  # it may have been imported before
