"""What a worker elsewhere needs before its first chunk: compiled kernels, and memory that it keeps.

Kernels take half a minute to compile, and the folder in which numba keeps them is made for one computer: on a disk
that many nodes share, two that write at once may leave an index that names code which is not there.  So the client
compiles, packs what it has into one file on the shared disk, and each worker process unpacks it into a temporary
folder of its node, which no other process reads or writes and which goes with it.  A worker with another processor
finds that nothing fits and compiles for itself, into its own folder.

glibc hands large blocks back to the system as soon as they are freed unless a program shows that it wants them
again, and the system clears every page that it gives out anew.  In a process of its own the program shows it by
itself.  Dask's workers it does not: they are started with a fixed threshold (``MALLOC_TRIM_THRESHOLD_``), which
ends that adaptation, and call tasks in a second thread, whose memory lies in small pieces that are unmapped when
they are empty.  A chunk took twice as long there.  So once a process says what it wants (mallopt(3)).
"""

import atexit
import ctypes
import io
import os
import shutil
import stat
import sys
import tempfile
import zipfile
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from ground.whole_file import whole_file
from rtpiv.analysis.campaign.chunk_task import ChunkTask, Outcome, carry_out
from rtpiv.analysis.series.workers import ONE_THREAD

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8  # malloc.h of glibc
KEPT_BYTES = 1 << 30  # free at the top of the memory before any of it is given back
MAPPED_BYTES = 32 << 20  # what is larger is asked of the system alone; glibc takes no more than this


def keep_memory() -> bool:
    """Ask the C library of this process to keep what is freed; whether it does."""
    if sys.platform != "linux":
        return False
    with suppress(OSError, AttributeError):  # another C library than glibc may have no such function
        wishes = (M_TRIM_THRESHOLD, KEPT_BYTES), (M_MMAP_THRESHOLD, MAPPED_BYTES), (M_ARENA_MAX, 1)
        granted = [ctypes.CDLL(None).mallopt(*wish) == 1 for wish in wishes]
        return all(granted)
    return False


def pack_kernels(path: Path) -> int:
    """Pack the compiled code of what this process has called so far; return how many files that is.

    Raises
    ------
    OSError
        It cannot be written.
    """
    from ground.jit.compiler import files_in_use  # by now numba is imported

    buffer, count = io.BytesIO(), 0
    with zipfile.ZipFile(buffer, "w") as archive:
        for file in files_in_use():
            archive.write(file, file.relative_to(_base_of(file)))
            count += 1
    with whole_file(path) as stream:
        stream.write(buffer.getvalue())
    path.chmod(0o644)  # workers run what it holds: no other user may write it
    return count


def _base_of(file: Path) -> Path:
    """Folder of all compiled code, in which a file lies below ``rtpiv``."""
    return next(folder.parent for folder in file.parents if folder.name == "rtpiv")


def carry_out_elsewhere(kernels: Path, task: ChunkTask) -> Outcome:
    """Carry a task out in a process that is not a child of the client: threads and kernels are seen to first."""
    _made_ready(kernels)
    return carry_out(task)


@lru_cache(maxsize=1)
def _made_ready(kernels: Path) -> None:
    """Once in a process: one thread, its memory kept, and a folder of its own with what was packed."""
    keep_memory()
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    place = Path(tempfile.mkdtemp(prefix="rtpiv-kernels-"))
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    os.environ["RTPIV_CACHE"] = str(place)
    try:
        if not is_only_mine(kernels):
            return  # somebody else could have put code there: compiled here
        with zipfile.ZipFile(kernels) as archive:
            archive.extractall(place)
    except (OSError, zipfile.BadZipFile):
        return  # none, or damaged: compiled here


def is_only_mine(path: Path) -> bool:
    """Whether only this user (and root) can have written a file whose content is run as code.

    Raises
    ------
    OSError
        It is not there.
    """
    if not hasattr(os, "getuid"):  # Windows: as the folder is shared
        return True
    about = path.lstat()
    return about.st_uid in (os.getuid(), 0) and stat.S_ISREG(about.st_mode) and not about.st_mode & 0o022
