"""Workers of a Dask cluster: a scheduler somewhere, and `dask worker` processes that see the campaign's folder.

Started with ``--nthreads 1``: a worker that runs two chunks in two threads holds both in its memory.
"""

import logging
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daq.errors import RunInterrupted, RunUsageError
from rtpiv.analysis.campaign.engine import Work
from rtpiv.analysis.campaign.kernels_at_hand import work_elsewhere

CONNECT_S = 10
COUNT_S = 5.0  # between two looks at how many workers there are


@dataclass
class DaskWorkers:
    """Workers of a scheduler.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.
    """

    address: str
    _client: Any = field(default=None, repr=False)
    _counted: tuple[float, int] = field(default=(-1e9, 1), repr=False)

    @property
    def slots(self) -> int:
        """Threads of all workers that are there now; 1 while there are none, so that tasks wait for the first."""
        at_s, count = self._counted
        if self._client is not None and time.monotonic() - at_s > COUNT_S:
            try:
                count = max(1, sum(self._client.nthreads().values()))
            except (OSError, TimeoutError) as error:
                raise _lost(self.address) from error
            self._counted = time.monotonic(), count
        return count

    @property
    def is_elsewhere(self) -> bool:
        """They may be."""
        return True

    def work(self, kernels: Path) -> Work:
        """Make the chunk, with kernels and threads of its own."""
        return work_elsewhere(kernels)

    @contextmanager
    def opened(self) -> Iterator[Executor]:
        """Connect.

        Raises
        ------
        RunUsageError
            Dask is not installed, or nobody answers at this address.
        """
        try:
            from distributed import Client
        except ImportError:
            raise RunUsageError("--scheduler needs Dask; install rtpiv[cluster]") from None
        for name in [
            name for name in logging.root.manager.loggerDict if name.startswith(("distributed", "tornado"))
        ]:
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what they meet comes back in our one sentence
        try:
            client = Client(self.address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            text = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise RunUsageError(f"{self.address}: no Dask scheduler answers there ({text})") from None
        try:
            self._client = client
            with client.get_executor(pure=False, retries=0) as executor:
                yield executor
        finally:
            self._client = None
            client.close(timeout=CONNECT_S)


def _lost(address: str) -> RunInterrupted:
    return RunInterrupted(f"the scheduler at {address} is gone; start it, then give the same command again")
