"""The runner: a list of steps, one after the other, with a journal.

    for each step that the journal does not have:
        route to its positions -> settle -> read positions back -> frames -> all on the disk -> journal

A step is finished when every frame of it is on the disk; only then it enters the journal.  Whatever comes between
(Ctrl-C, a lost camera, kill -9) leaves a run that `rtpiv resume` continues: frames of an unfinished step are
discarded, and the step is taken again from the start, so that the frames of a pair always belong together.
"""

import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from daq.bench.opened import OpenBench, known_positions
from daq.errors import BadBalance, CameraError, CameraLost, RunInterrupted, SettingsChanged
from daq.pipeline.catch_up import correct_from_disk, uncorrected
from daq.pipeline.corrections import Corrections
from daq.pipeline.lanes import LIVE_QUEUE, Job, Pipeline
from daq.plans.steps import Step, frame_count, route
from daq.runner.exposures import Exposures
from daq.runner.interrupts import Interrupts
from daq.runner.progress import Progress, Watcher
from daq.runs.conservation import Ledger
from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder, frame_entries, remaining, versions
from daq.runs.session_books import total_ledger
from daq.runs.whole_text import sync_folder, write_json
from stages.errors import DeviceLost, StageError

REPEATS = 3  # of a step that the camera has spoiled
RETRY_S = 0.5


def discard_unfinished(folder: RunFolder, steps: Sequence[Step], journal: Journal) -> int:
    """Drop frames of steps that were cut off, in the journal first; return how many."""
    entries = folder.entries()
    left = remaining(steps, entries)
    present = frame_entries(entries)
    doubtful = [number for step in left for number in step.numbers]
    known = [number for number in doubtful if number in present]
    if known:
        journal.append("discard", sync=True, frames=known)
    for number in doubtful:  # a frame may have been renamed just before the kill, without its line
        for path in (folder.frame_path(number), folder.corrected_path(number)):
            path.unlink(missing_ok=True)
    for name in ("frames", "corrected"):
        for leftover in (folder.path / name).glob("*.part"):
            leftover.unlink()
    return len(known)


class Runner:
    """Carries out the steps of a run that are left.

    Parameters
    ----------
    hardware : OpenBench
        Open, homed.
    folder : RunFolder
        Made before; run.json is on the disk.
    steps : sequence of Step
        All steps of the plan.
    corrections : Corrections, optional
        None to leave frames uncorrected.
    watcher : callable, optional
        Called with the progress, often.
    live_queue : int
        See `Pipeline`.
    """

    def __init__(
        self,
        hardware: OpenBench,
        folder: RunFolder,
        steps: Sequence[Step],
        corrections: Corrections | None = None,
        watcher: Watcher | None = None,
        live_queue: int = LIVE_QUEUE,
    ) -> None:
        self._hardware = hardware
        self._folder = folder
        self._steps = list(steps)
        self._corrections = corrections
        self._watcher = watcher or (lambda progress: None)
        self._live_queue = live_queue
        self._exposures = Exposures(hardware.camera, hardware.camera_section)
        self._rests_at_mm: dict[str, float] = {}
        self._caught_up = 0
        self.progress = Progress(steps=len(self._steps))
        self.interrupts = Interrupts(hardware.stage.stop_quietly)

    def run(self) -> dict[str, Any]:
        """Do what is left; return the contents of done.json.

        Raises
        ------
        RunInterrupted
            Asked for; the run can be resumed.
        StageError, CameraError, DiskError, FramesLost
            What came between; the run can be resumed.
        """
        journal = Journal(self._folder.journal_path)
        try:
            left = remaining(self._steps, self._folder.entries())
            self.progress.planned = frame_count(left)
            journal.append("session", sync=True, utc=_utc(), versions=versions(), steps_left=len(left))
            discard_unfinished(self._folder, self._steps, journal)
            if self._corrections is not None:
                self._corrections.prepare(step.view for step in left if step.on_plane)
            with self.interrupts:
                self._session(journal, left)
            self._catch_up()
            done = self._done()
            write_json(self._folder.path / "done.json", done)
            return done
        finally:
            journal.close()

    # ---- a session -----------------------------------------------------------------------------

    def _session(self, journal: Journal, left: list[Step]) -> None:
        settings = self._exposures.set_up() if left else {}
        count = sum(1 for entry in self._folder.entries() if entry["kind"] == "session")
        write_json(
            self._folder.path / f"camera_{count}.json", {"info": _info(self._hardware), "settings": settings}
        )
        raw_queue = max(1, self._hardware.camera_section.buffers // 2)
        pipeline = Pipeline(self._folder, journal, self._corrections, self._live_queue, raw_queue)
        self.progress.flow = pipeline.flow
        why, error_text = "finished", ""
        try:
            for step in left:
                self._between_steps(len(self._steps) - step.index)
                self._step(journal, pipeline, step)
        except BaseException as error:
            why, error_text = type(error).__name__, str(error)
            raise
        finally:
            try:
                self._exposures.end()
            finally:
                pipeline.close()
                ledger = self._exposures.books(pipeline.flow.written)
                journal.append("counts", books=ledger.to_dict(), flow=pipeline.flow.summary())
                journal.append("end", sync=True, utc=_utc(), why=why, error=error_text)
                self._tell("closing", ledger)
        if ledger.imbalance:
            raise BadBalance(f"{ledger.sentence()}; look at {self._folder.journal_path}")

    def _between_steps(self, left: int) -> None:
        if self.interrupts.paused:
            self._tell("paused")
            self.interrupts.wait()
        if self.interrupts.wanted:
            raise RunInterrupted(f"ended on request with {left} of {len(self._steps)} steps left")

    def _step(self, journal: Journal, pipeline: Pipeline, step: Step) -> None:
        self.progress.step, self.progress.tag = step.index, step.tag
        self._tell("moving")
        planned = step.targets_mm
        try:
            before, self._rests_at_mm = self._rests_at_mm, {}
            go_to(self._hardware, planned, before)
            self._rests_at_mm = planned
        except StageError as error:
            if self.interrupts.wanted and not isinstance(error, DeviceLost):
                raise RunInterrupted(f"stopped on the way to step {step.index} ({step.tag}): {error}") from error
            raise
        self._hardware.clock.sleep_s(step.settle_s)
        measured = known_positions(self._hardware.stage.where_mm())
        self.progress.positions_mm = measured
        record: dict[str, Any] = {"planned_mm": planned, "measured_mm": measured}
        if self._hardware.simulation is not None:
            record["true_mm"] = self._hardware.simulation.true_mm()
        self._tell("exposing")
        for attempt in range(1, REPEATS + 1):
            try:
                self._expose(pipeline, step, record)
                break
            except (CameraLost, SettingsChanged) as error:
                pipeline.flush()
                self._discard(journal, step)
                if attempt == REPEATS:
                    raise
                self._bring_back(error)
        journal.append("step", sync=True, step=step.index, tag=step.tag, utc=_utc(), **record)
        sync_folder(self._folder.path / "frames")

    def _expose(self, pipeline: Pipeline, step: Step, record: Mapping[str, Any]) -> None:
        for place, frame in self._exposures.frames(step.frames):
            job = Job(step, step.first_frame + place, frame.with_positions_mm(record["measured_mm"]), dict(record))
            pipeline.submit(job)
            self.progress.frames += 1
            self.progress.waiting = pipeline.waiting
            self._tell("exposing")
        pipeline.flush()
        self._exposures.verify()

    def _discard(self, journal: Journal, step: Step) -> None:
        present = frame_entries(self._folder.entries())
        numbers = [number for number in step.numbers if number in present]
        if numbers:
            journal.append("discard", sync=True, frames=numbers)
            self._exposures.discarded += len(numbers)
            self.progress.frames -= len(numbers)
        for number in numbers:
            self._folder.frame_path(number).unlink(missing_ok=True)
            self._folder.corrected_path(number).unlink(missing_ok=True)

    def _bring_back(self, why: CameraError) -> None:
        """Try to get a lost camera back for a while."""
        end_s = time.monotonic() + self._hardware.camera_section.back_within_s
        while True:
            self._tell(f"waiting for the camera: {why}")
            try:
                self._exposures.reopen()
                return
            except CameraError:
                if time.monotonic() > end_s or self.interrupts.wanted:
                    raise why from None
            time.sleep(RETRY_S)

    def _tell(self, doing: str, ledger: Ledger | None = None) -> None:
        self.progress.doing = doing
        self.progress.ledger = ledger or self._exposures.books_so_far(self.progress.flow.written)
        self._watcher(self.progress)

    # ---- the end -------------------------------------------------------------------------------

    def _catch_up(self) -> None:
        if self._corrections is None:
            return
        self._corrections.prepare(step.view for step in self._steps if step.on_plane)
        left = uncorrected(self._folder, self._corrections, self._steps)
        for self._caught_up, (step, number) in enumerate(left, start=1):
            self._tell(f"correcting what was skipped, {self._caught_up} of {len(left)}")
            correct_from_disk(self._folder, self._corrections, step, number)
        self._corrections.write_masks(self._folder.path / "corrected")

    def _done(self) -> dict[str, Any]:
        entries = self._folder.entries()
        total, sessions = total_ledger(entries)
        present = frame_entries(entries)
        absent = self._folder.absent(entries)
        if absent or len(present) != frame_count(self._steps):
            raise BadBalance(f"{len(present)} frames in the journal, {len(absent)} of them without a file")
        flows = [entry["flow"] for entry in entries if entry["kind"] == "counts"]
        return {
            "utc": _utc(),
            "steps": len(self._steps),
            "frames": len(present),
            "conservation": total.to_dict(),
            "sessions": sessions,
            "corrected_after_the_run": self._caught_up,
            "flow": flows,
        }


def go_to(hardware: OpenBench, targets_mm: Mapping[str, float], rests_at_mm: Mapping[str, float]) -> None:
    """Bring every axis to its position along the safe route.

    Parameters
    ----------
    hardware : OpenBench
        Open.
    targets_mm : mapping
        Position of every axis.
    rests_at_mm : mapping
        Where this run has sent axes before; what is there already is not moved by the micrometre it reads off.

    Raises
    ------
    StageError
        A move was refused, or something came between; everything has been stopped.
    """
    here_mm = known_positions(hardware.stage.where_mm()) | dict(rests_at_mm)
    for move in route(hardware.bench, here_mm, targets_mm):
        hardware.stage.move(move)


def _info(hardware: OpenBench) -> dict[str, str]:
    info = hardware.camera.info
    return {
        "backend": info.backend,
        "vendor": info.vendor,
        "model": info.model,
        "serial": info.serial,
        "address": info.address,
    }


def _utc() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
