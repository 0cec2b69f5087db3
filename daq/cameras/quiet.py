"""Keep a library's complaints that mean nothing away from the terminal.

The genicam library writes a line for every GenTL function of the newest standard that a vendor's producer does not
have.  None of them is used here; what else is written to standard error is passed on.
"""

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

COMPLAINT = b"GenTL producer does not implement"


@contextmanager
def without_complaints() -> Iterator[None]:
    """Hold standard error (the file descriptor, for C libraries) back, and pass on what is no such complaint."""
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            held.seek(0)
            for line in held:
                if not line.startswith(COMPLAINT):
                    os.write(2, line)
