"""What the page says of a run: its progress in the words of the terminal, with what is wrong marked."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.pipeline.lanes import Job
from daq.acquisition.runner.progress import Progress, Watcher
from daq.live.live_page import LivePage

RECENT = 50
SLOW_MS = 500.0  # from frame to corrected, beyond which nobody adjusts by looking
MANY_WAIT = 6  # raw frames, of the eight that may


class RunShown:
    """Shows frames of a run; called by its lanes.

    Parameters
    ----------
    page : LivePage
        Where.
    name : str
        Of the run.
    """

    def __init__(self, page: LivePage, name: str) -> None:
        self._page, self._name = page, name
        self._progress = Progress()

    def watching(self, watcher: Watcher) -> Watcher:
        """Return a watcher that keeps the progress for the page, and tells the other one."""

        def both(progress: Progress) -> None:
            self._progress = progress
            watcher(progress)

        return both

    def show(self, job: Job, corrected: NDArray[np.float32]) -> None:
        """Show a frame and its correction."""
        words = words_of(self._progress) | {
            "run": f"{self._name}: {job.step.tag}",
            "bits": job.frame.meta.significant_bits,
            "shows": job.step.shows,
        }
        self._page.show(words, {"raw": job.frame.pixels, "corrected": corrected})


def words_of(progress: Progress) -> dict[str, Any]:
    """Progress for the page: a sentence, and counters as name -> (text, whether that is wrong)."""
    flow, books = progress.flow, progress.ledger
    raw, live = progress.waiting
    latency = flow.latency_ms[-RECENT:]
    middle_ms = float(np.median(latency)) if latency else 0.0
    lost = books.lost + books.incomplete
    counters = {
        "step": [f"{progress.step + 1} of {progress.steps}", False],
        "frames": [f"{progress.frames} of {progress.planned}", False],
        "time left": [progress.left() or "-", False],
        "waiting for the disk": [str(raw), raw >= MANY_WAIT],
        "waiting to be corrected": [str(live), False],
        "frame to corrected": [f"{middle_ms:.0f} ms", middle_ms > SLOW_MS],
        "lost or incomplete": [str(lost), lost > 0],
        "not corrected live": [str(len(flow.skipped)), False],
    }
    if flow.vectors is not None:
        counters["vectors"] = [flow.vectors.sentence(), bool(flow.vectors.remark)]
    counters |= {name: [f"{mm:.3f} mm", False] for name, mm in progress.positions_mm.items()}
    return {"doing": progress.doing, "counters": counters}
