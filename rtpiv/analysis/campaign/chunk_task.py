"""Work on one chunk of a campaign: what a worker is given, the lease that says who is at it, what it answers.

A worker believes nothing: it compares marker, key and file hash by itself, so that the hashes of 33 GB are taken
by all cores, and a chunk that is sound is kept.  It raises nothing either, for an engine would pass some errors
on, keep others, and lose a third kind; what went wrong comes back as a sentence.

A lease is a file that exists while somebody works on the chunk, touched after each pair.  It saves work and shows
who is there; it protects nothing.  Two workers on one chunk write the same bytes, each under a name of its own
until it is whole, so that a lease taken wrongly costs time alone.

A worker that died leaves its file behind.  No two clocks agree on a cluster, and one may be an hour off, so no
time stamp is compared with a clock: whoever waits looks twice, and a lease is silent if nothing has touched it in
between (`beat_ns` is a mark, not a time).  On its own computer a process that is gone is known to be gone.
"""

import json
import os
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal
from uuid import uuid4

from pydantic import Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict  # that of typing cannot be checked before Python 3.12

from correction.errors import CorrectionError
from daq.errors import DaqError
from daq.runs.records import STRICT, Count
from ground.errors import GroundError
from ground.plain_file import read_plain
from piv.errors import PivError
from rtpiv.analysis.series.chunk import evaluate_chunk
from rtpiv.analysis.series.series_folder import sound_content
from rtpiv.analysis.series.series_plan import ChunkJob
from tracer.errors import TracerError

MOST_BYTES = 10_000


@with_config(STRICT)
class _Said(TypedDict):
    """What the file says."""

    token: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
    host: str
    pid: Count


_SAID: TypeAdapter[_Said] = TypeAdapter(_Said)


@dataclass(frozen=True)
class LeaseInfo:
    """A lease that somebody has.

    Parameters
    ----------
    token : str
        Of the one who took it; empty if the file says nothing, as when its writer died while it wrote.
    beat_ns : int
        Mark of the last touch, to be compared with itself alone.
    host, pid : str, int
        Who that is.
    """

    token: str
    beat_ns: int
    host: str = ""
    pid: int = 0

    @property
    def is_gone(self) -> bool:
        """Whether it was a process of this computer that has ended."""
        if not self.pid or self.host != socket.gethostname():
            return False
        if os.name != "posix":  # there os.kill would end it; a lease that nobody beats runs out
            return False
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return True
        except OSError:  # somebody else's
            return False
        return False


class Lease:
    """A lease of our own, from `take`."""

    def __init__(self, path: Path, token: str) -> None:
        self._path, self._token = path, token

    def beat(self) -> None:
        """Show that the work goes on; a file that is gone or cannot be touched is no reason to end it."""
        with suppress(OSError):
            os.utime(self._path)

    def give_back(self) -> None:
        """Remove it, unless somebody has taken it over."""
        held = read_lease(self._path)
        if held is not None and held.token == self._token:
            with suppress(OSError):
                self._path.unlink()


def take(path: Path, over: str | None = None) -> Lease | LeaseInfo:
    """Take a lease, or say who has it.

    Parameters
    ----------
    path : Path
        Its file.
    over : str, optional
        Token of a holder that has been silent for so long that its lease is void.

    Raises
    ------
    OSError
        The folder cannot be written to.
    """
    token = uuid4().hex
    said: _Said = {"token": token, "host": socket.gethostname(), "pid": os.getpid()}
    path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            held = read_lease(path)
            if held is None:
                continue  # given back meanwhile
            if not held.is_gone and held.token != over:
                return held
            with suppress(FileNotFoundError):
                path.unlink()
            continue
        with os.fdopen(descriptor, "w") as stream:
            json.dump(said, stream)
        return Lease(path, token)


def clear(path: Path) -> None:
    """Remove the lease of a chunk that is whole, whoever had it.

    A worker that died between writing the chunk and giving its lease back has left it.  One that is still there,
    as it makes the same chunk a second time, needs none: its bytes are the same.
    """
    with suppress(OSError):
        path.unlink()


def read_lease(path: Path) -> LeaseInfo | None:
    """Who has a lease; None if it is free."""
    beat_ns = 0
    try:
        beat_ns = path.stat().st_mtime_ns
        said = _SAID.validate_json(read_plain(path, MOST_BYTES))
    except FileNotFoundError:
        return None
    except (OSError, ValidationError):
        return LeaseInfo("", beat_ns)
    return LeaseInfo(said["token"], beat_ns, said["host"], said["pid"])


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
    held : LeaseInfo, optional
        Whose it is, of one that is busy.
    seconds : float
        What it took.
    host, pid : str, int
        Who says so.
    """

    what: Literal["kept", "made", "busy", "failed"]
    reason: str = ""
    held: LeaseInfo | None = None
    seconds: float = 0.0
    host: str = ""
    pid: int = 0


Work = Callable[[ChunkTask], Outcome]  # what a worker calls with each task


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
        if isinstance(lease, LeaseInfo):
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
