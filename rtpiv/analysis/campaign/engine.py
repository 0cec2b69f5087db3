"""Who does the work: whatever gives a `concurrent.futures.Executor` and says how many tasks it takes at once."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from rtpiv.analysis.campaign.chunk_task import ChunkTask, Outcome, carry_out
from rtpiv.analysis.series.workers import worker_processes

Work = Callable[[ChunkTask], Outcome]


class Engine(Protocol):
    """Workers.

    `opened` may be entered again after its executor broke.
    """

    @property
    def slots(self) -> int:
        """Tasks that are worked on at the same time."""
        ...

    @property
    def is_elsewhere(self) -> bool:
        """Whether its workers need compiled code that is brought to them."""
        ...

    def work(self, kernels: Path) -> Work:
        """What its workers call with each task; `kernels` is the file of compiled code that they may need."""
        ...

    def opened(self) -> AbstractContextManager[Executor]:
        """Its executor, and its end."""
        ...


@dataclass(frozen=True)
class LocalProcesses:
    """Processes of one thread each on this computer.

    Parameters
    ----------
    slots : int
        How many.
    """

    slots: int

    @property
    def is_elsewhere(self) -> bool:
        """They are here."""
        return False

    def work(self, kernels: Path) -> Work:
        """Make the chunk: these processes share the compiled code of this computer."""
        return carry_out

    @contextmanager
    def opened(self) -> Iterator[Executor]:
        """Start them; they end with this process, however it ends."""
        with worker_processes(self.slots) as pool:
            yield pool
