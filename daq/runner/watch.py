"""What a person sees while a run goes on: one panel that is drawn anew, or a line now and then in a log."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from daq.runner.progress import Progress, Watcher

DRAW_S = 0.25
LOG_S = 15.0
RECENT = 50


def panel(progress: Progress) -> Table:
    """Return the state of a run as a table."""
    latency = progress.flow.latency_ms[-RECENT:]
    raw, live = progress.waiting
    rows = [
        ("step", f"{progress.step + 1} of {progress.steps}  {progress.tag}"),
        ("doing", progress.doing),
        ("frames", f"{progress.frames} of {progress.planned}  ({progress.frames / progress.elapsed_s:.1f} /s)"),
        ("time", progress.left() or "-"),
        ("waiting", f"{raw} to be written, {live} to be corrected"),
        ("latency", f"{np.median(latency):.0f} ms frame to corrected" if latency else "-"),
        ("skipped", f"{len(progress.flow.skipped)} not corrected live (done after the run)"),
        ("vectors", progress.flow.vectors.sentence() if progress.flow.vectors else "-"),
        ("positions", "  ".join(f"{name} {mm:.3f}" for name, mm in progress.positions_mm.items()) or "-"),
        ("books", progress.ledger.sentence()),
    ]
    table = Table(show_header=False, box=None)
    for name, value in rows:
        table.add_row(Text(name, "bold"), value)
    return table


def line(progress: Progress) -> str:
    """Return the state of a run as one line of a log."""
    words = [f"step {progress.step + 1}/{progress.steps} {progress.tag}", progress.doing, progress.left()]
    if progress.flow.vectors is not None:
        words.append(f"vectors {progress.flow.vectors.sentence()}")
    return "; ".join([*filter(None, words), progress.ledger.sentence()])


@contextmanager
def watch(screen: Console) -> Iterator[Watcher]:
    """Yield a watcher that shows the progress on a terminal, or writes a line every `LOG_S` elsewhere."""
    last_s = time.monotonic()
    if not screen.is_terminal:

        def log(progress: Progress) -> None:
            nonlocal last_s
            if time.monotonic() - last_s >= LOG_S:
                last_s = time.monotonic()
                screen.print(line(progress), soft_wrap=True)

        yield log
        return
    with Live(console=screen, refresh_per_second=1.0 / DRAW_S, transient=True) as live:

        def draw(progress: Progress) -> None:
            nonlocal last_s
            if time.monotonic() - last_s >= DRAW_S:
                last_s = time.monotonic()
                live.update(panel(progress))

        yield draw
