"""Progress of a run on the page, in the words of the terminal, with problems marked."""

import math
import shutil
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.bench.elements import CAMERA
from daq.live.live_page import LivePage
from daq.live.scene_lines import LIT
from daq.pipeline.job import Job
from daq.plans.steps import CLEAR
from daq.runner.progress import Progress, Watcher
from daq.runs.run_folder import RunFolder
from daq.timing.states import LaserState

RECENT = 50
SLOW_MS = 500.0  # from frame to corrected, beyond which it is too slow to adjust by looking
MANY_WAIT = 6  # raw frames, of the eight that may
DISK_S = 2.0  # between two looks at the disk
LITTLE_S = 600.0  # of frames at this rate, for which it has room
DARK = (LaserState.SAFE, LaserState.WARM, LaserState.READY)


class RunShown:
    """Shows frames of a run; called by its threads.

    Parameters
    ----------
    page : LivePage
        Where.
    folder : RunFolder
        Of the run.
    recovered : str
        How much of what the balls hide is seen through them, said with every frame behind glass.
    camera : str
        Camera whose frames are shown.
    """

    def __init__(self, page: LivePage, folder: RunFolder, recovered: str = "", camera: str = CAMERA) -> None:
        self.page, self._folder, self._recovered, self._camera = page, folder, recovered, camera
        self._title = folder.path.name if camera == CAMERA else f"{folder.path.name}, {camera}"
        self._progress = Progress()
        self._free_bytes, self._looked_s = 0, -math.inf

    def watching(self, watcher: Watcher) -> Watcher:
        """Return a watcher that keeps the progress for the page, and tells the other one."""

        def both(progress: Progress) -> None:
            self._progress = progress
            waits = progress.doing == "exposing" and not progress.frames
            self.page.say("waiting for the camera's first frame" if waits else progress.doing)
            watcher(progress)

        return both

    def show(self, job: Job, corrected: NDArray[np.float32] | None) -> None:
        """Show a frame, and its correction if it has one; costs nothing if none is due."""
        stats, rate_limiter = self._progress.of(self._camera).stats, self.page.rate_limiter
        rate_limiter.see(time.monotonic(), stats.corrected, len(stats.skipped))
        if not self.page.is_due:
            return
        words = words_of(self._progress, self._camera) | {
            "run": f"{self._title}: {job.step.tag}",
            "bits": job.frame.meta.significant_bits,
            "shows": job.step.shows,
            "view": LIT if job.step.shows_light_sheet else job.step.view,
            "rims": job.step.on_plane and job.step.view != CLEAR,
            "pulse": (job.number - job.step.first_frame) % job.step.group,
        }
        if self._recovered and job.step.view != CLEAR:
            words["run"] += f"; {self._recovered}"
        words["counters"] |= self._disk()
        if rate_limiter.sentence:
            words["counters"]["shown here"] = [rate_limiter.sentence, False]
        pictures: dict[str, NDArray[Any]] = {"raw": job.frame.pixels}
        if corrected is not None:
            pictures["corrected"] = corrected
        self.page.show(words, pictures)

    def _disk(self) -> dict[str, list[Any]]:
        """For how long the disk has room, at the rate of the run so far."""
        now_s = time.monotonic()
        if now_s - self._looked_s > DISK_S:
            self._looked_s, self._free_bytes = now_s, shutil.disk_usage(self._folder.path).free
        cameras = self._progress, *self._progress.further.values()
        rate = sum(each.stats.written_bytes for each in cameras) / self._progress.run_time_s
        text, little = f"{self._free_bytes / 1e9:.0f} GB", False
        if rate > 0.0:
            left_s = self._free_bytes / rate
            text += f", {left_s / 60.0:.0f} min" if left_s < 36000.0 else f", {left_s / 3600.0:.0f} h"
            little = left_s < LITTLE_S
        return {"room on the disk": [text, little]}


def words_of(progress: Progress, camera: str = CAMERA) -> dict[str, Any]:
    """Progress for the page of a camera: a sentence, and counters as name -> (text, whether that is wrong)."""
    own = progress.of(camera)
    stats, frames = own.stats, own.accounting
    raw, live = own.waiting
    latency = stats.latency_ms[-RECENT:]
    middle_ms = float(np.median(latency)) if latency else 0.0
    lost = frames.losses + frames.incomplete
    counters = {
        "step": [f"{progress.step + 1} of {progress.steps}", False],
        "frames": [f"{progress.frames} of {progress.planned}", False],
        "time left": [progress.time_left() or "-", False],
        "waiting for the disk": [str(raw), raw >= MANY_WAIT],
        "waiting to be corrected": [str(live), False],
        "frame to corrected": [f"{middle_ms:.0f} ms", middle_ms > SLOW_MS],
        "lost or incomplete": [str(lost), lost > 0],
        "not corrected live": [str(len(stats.skipped)), False],
    }
    said: dict[str, Any] = {"counters": counters}
    if stats.vectors is not None:
        counters["vectors"] = [stats.vectors.sentence(), bool(stats.vectors.remark)]
        said["arrows"] = stats.vectors.arrows
    if progress.laser is not None:
        said["laser"] = [progress.laser.value, progress.laser not in DARK]
    counters |= {name: [f"{mm:.3f} mm", False] for name, mm in progress.positions_mm.items()}
    return said
