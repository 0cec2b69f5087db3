"""Numba, imported without coverage.

Wherever coverage is installed numba imports it, to ask whether anybody measures; where it is not loaded yet,
nobody does. That was a sixth of what a process waits for numba.
"""

import sys

if "coverage" in sys.modules:
    import numba
else:
    sys.modules["coverage"] = None  # type: ignore[assignment]
    try:
        import numba  # noqa: F401
    finally:
        del sys.modules["coverage"]
