"""What a worker of a campaign is given, and what it says when it is done; any executor can carry both.

A worker believes nothing: it compares marker, key and file hash by itself, so that the hashes of 33 GB are taken
by all cores, and a chunk that is sound is kept.  It raises nothing either, for an engine would pass some errors
on, keep others, and lose a third kind; what went wrong comes back as a sentence.
"""

import os
import socket
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from correction.errors import CorrectionError
from daq.errors import DaqError
from ground.errors import GroundError
from piv.errors import PivError
from rtpiv.analysis.campaign.lease import Held, clear, take
from rtpiv.analysis.series.chunk import evaluate_chunk
from rtpiv.analysis.series.series_folder import sound_content
from rtpiv.analysis.series.series_plan import ChunkJob
from tracer.errors import TracerError


@dataclass(frozen=True)
class ChunkTask:
    """A chunk to be made, unless it is there.

    Parameters
    ----------
    run : str
        Name of its run within the campaign.
    job : ChunkJob
        What to do.
    lease : Path
        File that says who does it.
    over : str, optional
        Token of a lease that has been silent for too long.
    beside : bool
        Do it although somebody else does: who is ready first wins, and the bytes are the same.
    """

    run: str
    job: ChunkJob
    lease: Path
    over: str | None = None
    beside: bool = False

    @property
    def name(self) -> tuple[str, int]:
        """Run and number of the chunk."""
        return self.run, self.job.number


@dataclass(frozen=True)
class Outcome:
    """What became of a task.

    Parameters
    ----------
    what : {"kept", "made", "busy", "failed"}
        It was sound; it was made; somebody else is at it; it could not be made.
    reason : str
        Why it failed.
    held : Held, optional
        Whose it is, of one that is busy.
    seconds : float
        What it took.
    host, pid : str, int
        Who says so.
    """

    what: Literal["kept", "made", "busy", "failed"]
    reason: str = ""
    held: Held | None = None
    seconds: float = 0.0
    host: str = ""
    pid: int = 0


def carry_out(task: ChunkTask) -> Outcome:
    """Make a chunk, unless it is there or somebody else makes it."""
    begun_s = time.monotonic()
    outcome = _made(task)
    return replace(outcome, seconds=time.monotonic() - begun_s, host=socket.gethostname(), pid=os.getpid())


def _made(task: ChunkTask) -> Outcome:
    try:
        if sound_content(task.job.path, task.job.key) is not None:
            clear(task.lease)
            return Outcome("kept")
        lease = None if task.beside else take(task.lease, task.over)
        if isinstance(lease, Held):
            return Outcome("busy", held=lease)
        try:
            evaluate_chunk(task.job, each_pair=None if lease is None else lease.beat)
        finally:
            if lease is not None:
                lease.give_back()
    except (DaqError, CorrectionError, PivError, GroundError, TracerError) as error:
        return Outcome("failed", str(error))
    except MemoryError as error:
        return Outcome("failed", f"there is not enough memory ({error}); use fewer workers")
    except OSError as error:
        return Outcome("failed", f"{error.filename}: {(error.strerror or str(error)).lower()}")
    return Outcome("made")
