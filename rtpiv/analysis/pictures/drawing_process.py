"""Pictures drawn by a process of their own, which gets ready while the verb computes.

Importing matplotlib takes longer than tracing ten maps, on one core, while a verb that loads its kernels leaves
the other idle.  So the command forks once it has imported the verb, which both need (`drawing_apart`); the
child imports what the verb draws with, and waits.  What is then to be drawn is sent to it: the name of a function,
as "module:name", and arguments, which are data.  Errors come back and are raised where the verb waits.

Nothing depends on the child: where there is none (one core, no fork, another thread already, a verb called from
Python), or where it was killed, pictures are drawn by the caller.  It ends when the other end is closed.
"""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any, Protocol

from ground.forking import ENDINGS, begin_child
from ground.rows import thread_count

Job = tuple[str, tuple[Any, ...]]


class Draw(Protocol):
    """Draws, here or apart."""

    def __call__(self, place: str, *arguments: object) -> None:
        """Call a function, "module:name", that draws."""


class DrawingProcess:
    """A process that draws.

    Parameters
    ----------
    modules : sequence of str
        What it imports at once.
    """

    def __init__(self, modules: Sequence[str]) -> None:
        context = multiprocessing.get_context("fork")
        self._end, other = context.Pipe()
        self._waiting: list[Job] = []
        target: Callable[..., None] = _draw_what_comes
        self._process = context.Process(target=target, args=(other, self._end, tuple(modules)), daemon=True)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDINGS)  # a handler may not raise in a child half made
        self._process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        other.close()

    def send(self, job: Job) -> None:
        """Let it draw; nothing is waited for but that it takes the arguments, which it does one job ahead."""
        while self._waiting and self._end.poll() and self._heard():
            pass
        self._waiting.append(job)
        with suppress(OSError):  # it is gone: `wait` finds out
            self._end.send(job)

    def wait(self) -> None:
        """Wait until all is drawn; what a child that is gone has left undone is drawn here."""
        while self._waiting and self._heard():
            pass
        while self._waiting:
            _carry_out(self._waiting.pop(0))

    def _heard(self) -> bool:
        """Take the answer to the first job that waits for one; False if the child is gone."""
        try:
            error = self._end.recv()
        except (EOFError, OSError):
            return False
        self._waiting.pop(0)
        if error is not None:
            raise error
        return True

    def end(self) -> None:
        """Let it go; what it still draws is not waited for."""
        self._end.close()
        self._process.terminate()
        self._process.join()


_process: DrawingProcess | None = None


@contextmanager
def drawing_apart(modules: Sequence[str]) -> Iterator[None]:
    """Within the block pictures are drawn apart, where that can be."""
    global _process
    if not modules or _process is not None or not _worth_it():
        yield
        return
    _process = DrawingProcess(modules)
    try:
        yield
    finally:
        _process.end()
        _process = None


def _worth_it() -> bool:
    """Return whether a second core is free, and this process can be forked: on Linux, without other threads."""
    alone = threading.active_count() == 1 and threading.current_thread() is threading.main_thread()
    return sys.platform == "linux" and alone and thread_count() > 1


@contextmanager
def drawing(patient: bool = False) -> Iterator[Draw]:
    """Give what draws; at the end of the block all is drawn.

    Parameters
    ----------
    patient : bool
        Without a drawing process, draw at the end of the block: computing and printing come first.

    Raises
    ------
    Exception
        What drawing raises, such as DiskError.
    """
    waiting: list[Job] = []

    def draw(place: str, *arguments: object) -> None:
        job = (place, arguments)
        if _process is not None:
            _process.send(job)
        elif patient:
            waiting.append(job)
        else:
            _carry_out(job)

    yield draw
    for job in waiting:
        _carry_out(job)
    if _process is not None:
        _process.wait()


def _carry_out(job: Job) -> None:
    place, arguments = job
    module, _, name = place.partition(":")
    getattr(import_module(module), name)(*arguments)


def _no_description(artist: object) -> str:
    """Return no description of a class of Matplotlib, as it is not shown here."""
    return ""


def _draw_what_comes(jobs: Connection, others: Connection, modules: Sequence[str]) -> None:
    """Be the child."""
    others.close()  # else it would never see the other end closed
    begin_child()
    with suppress(ImportError, AttributeError):  # said by what needs it
        artist: Any = import_module("matplotlib.artist")
        artist.kwdoc = _no_description  # else a third of the time goes into docstrings of ``set``, of every class
        for module in modules:
            import_module(module)
    while True:
        try:
            job = jobs.recv()
        except (EOFError, OSError):
            os._exit(0)
        error: Exception | None = None
        try:
            _carry_out(job)
        except Exception as raised:
            error = raised
        try:
            jobs.send(error)
        except OSError:
            os._exit(0)
        except Exception:  # an error that cannot be sent as it is
            jobs.send(RuntimeError(str(error)))
