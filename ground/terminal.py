"""Terminal output while a verb works: tables wide enough to read, progress with time left.

Names of files and what stands in them may hold anything, also bytes that a terminal takes for commands: it would
clear its screen, rename its window, or answer.  All that is said goes through `printable`.
"""

import multiprocessing
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

from rich.console import Console
from rich.live import Live
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from ground.printable import printable as printable  # who prints without a console needs it

Item = TypeVar("Item")
LONG_S = 1.0
_silent: ContextVar[bool] = ContextVar("silent", default=False)
_said: set[str] = set()
_drawn: list[Live] = []  # what this process draws on its terminal now
LEAST_WIDTH = 110  # of tables in a log or a pipe, where no terminal says how wide it is


class _Screen(Console):
    """Prints text as it is: neither markup nor commands to the terminal."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401
        super().__init__(markup=False, emoji=False, quiet=_silent.get(), **options)

    def render_str(self, text: str, **options: Any) -> Text:  # noqa: ANN401
        """Every text and cell comes through here."""
        return super().render_str(printable(text), **options)


@contextmanager
def silence() -> Iterator[None]:
    """Let consoles that are made in the meantime print nothing: a program asks, and no person reads."""
    before = _silent.set(True)
    try:
        yield
    finally:
        _silent.reset(before)


def console() -> Console:
    """Return the console for results, on standard output.

    Text is printed as it is: `[px]` is a unit and `[a]` may be part of a path, never markup.
    """
    found = _Screen()
    return found if found.is_terminal else _Screen(width=LEAST_WIDTH)


def error_console() -> Console:
    """Return the console for what is said while a verb works, on standard error."""
    return _Screen(stderr=True)


@contextmanager
def show_live(live: Live) -> Iterator[Live]:
    """Show what is drawn anew again and again, until the end of the block."""
    _drawn.append(live)
    try:
        with live:
            yield live
    finally:
        _drawn.remove(live)


@contextmanager
def pause_drawing() -> Iterator[None]:
    """Let nothing be drawn anew while a person reads a question and types: it would wipe both out."""
    stopped = [live for live in _drawn if live.is_started]
    for live in stopped:
        live.stop()
    try:
        yield
    finally:
        for live in stopped:
            live.start(refresh=True)


def say_once(text: str) -> None:
    """Print on standard error what a person should know, once however often it happens.

    Processes that were started for a part of the work are silent: the one that a person started reads as well.
    """
    if text not in _said and not _silent.get() and multiprocessing.parent_process() is None:
        _said.add(text)
        error_console().print(text)


def progress(items: Iterable[Item], total: int, what: str, after_s: float = 0.0) -> Iterator[Item]:
    """Yield `items` while a bar shows how many of `total` are done and how long the rest will take.

    Parameters
    ----------
    items : iterable
        The work.
    total : int
        How many there are.
    what : str
        Said beside the bar.
    after_s : float
        How long nothing is shown: what is through by then needs no bar.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    bar, begun_s = Progress(*columns, *times, console=error_console()), time.monotonic()
    task = bar.add_task(what, total=total)
    try:
        for item in items:
            if not bar.live.is_started and time.monotonic() - begun_s >= after_s:
                bar.start()
            yield item
            bar.advance(task)
    finally:
        if bar.live.is_started:
            bar.stop()


def progress_if_long(items: Iterable[Item], total: int, what: str) -> Iterator[Item]:
    """Yield `items` as `progress` does, with a bar only if they take longer than a second."""
    return progress(items, total, what, LONG_S)
