"""What a person sees while a verb works: tables wide enough to read, progress with time left."""

from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

Item = TypeVar("Item")
LEAST_WIDTH = 110  # of tables in a log or a pipe, where no terminal says how wide it is


def console() -> Console:
    """Return the console for results, on standard output.

    Text is printed as it is: `[px]` is a unit and `[a]` may be part of a path, never markup.
    """
    found = Console(markup=False, emoji=False)
    return found if found.is_terminal else Console(markup=False, emoji=False, width=LEAST_WIDTH)


def error_console() -> Console:
    """Return the console for what is said while a verb works, on standard error."""
    return Console(markup=False, emoji=False, stderr=True)


def progress(items: Iterable[Item], total: int, what: str) -> Iterator[Item]:
    """Yield `items` while a bar shows how many of `total` are done and how long the rest will take.

    Parameters
    ----------
    items : iterable
        The work.
    total : int
        How many there are.
    what : str
        Said beside the bar.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, *times, console=error_console()) as bar:
        task = bar.add_task(what, total=total)
        for item in items:
            yield item
            bar.advance(task)
