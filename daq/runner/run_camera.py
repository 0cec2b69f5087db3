"""One camera of a run: its place on the bench, its run folder, and what a session leaves there.

A run has a list of cameras.  The first one is the bench's `camera`, whose folder is the run's own; a further one
sees the same steps, lit by the same pulses, and has a run folder of its own inside the run's (cameras/NAME).  That
is a run like any other, with the camera's own scene, so whatever reads runs reads it; it has the frame numbers of
the run, and frames of one number show the same trigger.

    open -> set_up -> (note_camera, finish_step)* -> end -> complete -> close

The lines of a step and the done.json of further cameras are on the disk before those of the first: a run that is
done has all of its cameras.
"""

import time
from collections.abc import Callable, Collection, Container, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from daq.atomic_write import sync_folder, write_json
from daq.bench.elements import CAMERA
from daq.bench.opened import OpenBench
from daq.cameras.camera import Setting
from daq.errors import BadBalance, ResumeRefused
from daq.pipeline.corrections import Corrections, correct_from_disk, frames_to_correct
from daq.pipeline.job import Show
from daq.pipeline.pipeline import LIVE_QUEUE, Pipeline
from daq.plans.link_budget import require_link
from daq.plans.pulse_order import pairs_section
from daq.plans.steps import Step
from daq.runner.camera_session import CameraSession
from daq.runner.pair_source import PairSource
from daq.runner.pair_writer import PairWriter
from daq.runner.progress import CameraProgress
from daq.runner.step_readings import camera_facts
from daq.runs.displacement import displacements, write_displacements
from daq.runs.done_file import run_hash
from daq.runs.frame_accounting import FrameAccounting, ambiguities, total_accounting
from daq.runs.gaps import gaps_by_step, numbers_in
from daq.runs.journal import Journal, utc_now
from daq.runs.run_folder import RunFolder, frame_entries, steps_on_disk, versions
from daq.runs.seal import write_record


class RunCamera:
    """A camera, and the session that goes on with it.

    Parameters
    ----------
    hardware : OpenBench
        The bench of the run, open.
    folder : RunFolder
        The camera's; run.json is on the disk.
    corrections : Corrections, optional
        By the camera's own scene; None to leave frames frames_to_correct.
    name : str
        Device of the bench.
    live_queue : int
        See `Pipeline`.
    show : callable, optional
        Gets frames as they arrive, for a page.
    """

    def __init__(
        self,
        hardware: OpenBench,
        folder: RunFolder,
        corrections: Corrections | None = None,
        name: str = CAMERA,
        live_queue: int = LIVE_QUEUE,
        show: Show | None = None,
    ) -> None:
        self.name = name
        self.hardware = hardware.as_seen_by(name)
        self.folder = folder
        self._corrections = corrections
        self._live_queue, self._show = live_queue, show
        self._journal: Journal | None = None
        self._pipeline: Pipeline | None = None
        self._finished: frozenset[int] = frozenset()  # steps that were, when the session began
        latch = self.hardware.stage.latch
        self.session = CameraSession(
            self.hardware.camera, self.hardware.camera_section, latch, self._write_ambiguity, hardware.rendering_s
        )

    @property
    def corrects(self) -> bool:
        """True if its frames are corrected."""
        return self._corrections is not None

    @property
    def journal(self) -> Journal:
        """The journal of its folder, from `lock` to `close`."""
        assert self._journal is not None
        return self._journal

    @property
    def pipeline(self) -> Pipeline:
        """Pipeline that brings its frames to the disk, from `set_up` on."""
        assert self._pipeline is not None
        return self._pipeline

    # ---- how a session begins ------------------------------------------------------------------

    def lock(self) -> None:
        """Take the journal for this process.

        Raises
        ------
        RunUnsuitable
            Another process works on this run.
        ResumeRefused
            A frame of an earlier session is ambiguous.
        """
        self._journal = Journal(self.folder.journal_path)
        if said := ambiguities(self.folder.entries()):
            raise ResumeRefused(f"{self.folder.path}: {said[0]}; begin a new run")

    def open(self, left: Sequence[Step], again: Collection[int] = ()) -> None:
        """Begin a session: drop what was cut off, and have maps ready for what is left.

        Parameters
        ----------
        left : sequence of Step
            Steps that are left.
        again : collection of int
            Those of them that are finished and have to be taken again.
        """
        stage = self.hardware.stage
        said_mm = dict(stage.operator_mm)  # of axes whose reference is a person's word
        self.journal.append(
            "session",
            sync=True,
            utc=utc_now(),
            monotonic_ns=time.monotonic_ns(),
            versions=versions(),
            steps_left=len(left),
            controllers={name: box.identity for name, box in stage.controllers.items()},
            **({"said_mm": said_mm} if said_mm else {}),
        )
        discard_unfinished(self.folder, left, self.journal, again)
        self._finished = frozenset(steps_on_disk(self.folder.entries())).difference(again)
        if self._corrections is not None:
            self._corrections.prepare(step.view for step in left if step.on_plane)

    def set_up(self, left: Sequence[Step]) -> None:
        """Set the camera up, before anything moves.

        Raises
        ------
        CameraError, RunUsageError
            The camera is not there, or cannot do what the steps ask for.
        """
        settings = self.session.set_up() if left else {}
        self.session.check_frame_timeout(settings)
        require_link(self.hardware.bench, left, settings)
        self._write_camera_file(settings)
        raw_queue = max(1, self.hardware.camera_section.buffers // 2)
        self._pipeline = Pipeline(
            self.folder, self.journal, self._corrections, self._live_queue, raw_queue, self._show
        )

    def pair_writer(self) -> PairWriter:
        """Return the writer of its pairs in steps that are lit by pulses."""
        source = PairSource(self.name, self.session, pairs_section(self.hardware.bench))
        return PairWriter(self.folder, self.journal, self.pipeline, source)

    # ---- while it goes on ----------------------------------------------------------------------

    def report(self, progress: CameraProgress) -> None:
        """Write what has become of its frames so far into the progress."""
        if self._pipeline is not None:
            progress.stats, progress.waiting = self._pipeline.stats, self._pipeline.waiting
        progress.accounting = self.session.accounting_so_far(progress.stats.written)

    def note_camera(self) -> None:
        """Have on the record what the camera tells of its clock and its temperature."""
        if facts := camera_facts(self.hardware.camera):
            self.journal.append("camera", **facts)

    def finish_step(self, step: Step, record: Mapping[str, Any]) -> None:
        """Say that a step is on the disk, unless an earlier session has, and its frames still count."""
        if step.index in self._finished and step.index in steps_on_disk(self.folder.entries()):
            return
        self.journal.append("step", sync=True, step=step.index, tag=step.tag, utc=utc_now(), **record)
        sync_folder(self.folder.path / "frames")

    # ---- how it ends ---------------------------------------------------------------------------

    def end(self, why: str, error: str) -> tuple[FrameAccounting | None, str]:
        """Close the account of the session, with every frame on the disk.

        Parameters
        ----------
        why, error : str
            How the session ended.

        Returns
        -------
        FrameAccounting or None
            What became of its frames; None if the camera was never set up.
        str
            Ambiguities of the session; "" if there are none.
        """
        self.session.end()
        if self._pipeline is None:
            return None, ""
        self._pipeline.close()
        flow = self._pipeline.stats
        accounting = self.session.conclude(flow.written)
        problem = "; ".join(self.session.ambiguities)
        about: dict[str, Any] = {"doubt": problem} if problem else {}
        rejected = dict(self.session.why_rejected)
        reasons: dict[str, Any] = {"why_rejected": rejected} if rejected else {}
        if problem and why == "finished":
            why, error = BadBalance.__name__, problem
        self.journal.append("counts", books=accounting.to_dict(), flow=flow.summary(), **reasons, **about)
        self.journal.append("end", sync=True, utc=utc_now(), why=why, error=error, **about)
        return accounting, problem

    def complete(self, steps: Sequence[Step], tell: Callable[[str], None]) -> dict[str, Any]:
        """Correct what was left, and write done.json; return its contents.

        Parameters
        ----------
        steps : sequence of Step
            All steps of the run.
        tell : callable
            Called with what is being done.

        Raises
        ------
        BadBalance
            Frames are missing or ambiguous; the run is not done.
        """
        caught_up = self._catch_up(steps, tell)
        if moved := displacements(self.hardware.bench, steps, self.folder.entries()):
            write_displacements(self.folder, moved)
        done = make_done_record(self.folder, steps, caught_up)
        write_record(self.folder.path / "done.json", done)
        return done

    def close(self) -> None:
        """Close the journal."""
        if self._journal is not None:
            self._journal.close()

    def _catch_up(self, steps: Sequence[Step], tell: Callable[[str], None]) -> int:
        """Correct from the disk what was skipped; return how many frames."""
        if self._corrections is None:
            return 0
        self._corrections.prepare(step.view for step in steps if step.on_plane)
        left = frames_to_correct(self.folder, self._corrections, steps)
        whose = "" if self.name == CAMERA else f" of {self.name}"
        for count, (step, number) in enumerate(left, start=1):
            tell(f"correcting what was skipped{whose}, {count} of {len(left)}")
            correct_from_disk(self.folder, self._corrections, step, number)
        self._corrections.write_masks(self.folder.path / "corrected")
        return len(left)

    def _write_camera_file(self, settings: Mapping[str, Setting]) -> None:
        """Keep what the camera says of itself in this session."""
        count = sum(1 for entry in self.folder.entries() if entry["kind"] == "session")
        about = asdict(self.hardware.camera.info)
        write_json(self.folder.path / f"camera_{count}.json", {"info": about, "settings": settings})

    def _write_ambiguity(self, said: str) -> None:
        """Write an ambiguity to the disk before anything else happens; a kill may follow."""
        if self._journal is not None:
            self._journal.append("doubt", sync=True, doubt=said)


def discard_unfinished(
    folder: RunFolder, left: Sequence[Step], journal: Journal, again: Container[int] = ()
) -> int:
    """Drop frames of steps that were cut off or are to be taken `again`, in the journal first.

    A step that may have gaps keeps its frames, unless it is to be taken again.

    Parameters
    ----------
    folder : RunFolder
        Where the frames are.
    left : sequence of Step
        Steps that are left, those to be taken again among them.
    journal : Journal
        Of the folder.
    again : container of int
        Steps that are to be taken again.

    Returns
    -------
    int
        How many frames of the journal were dropped.
    """
    present = frame_entries(folder.entries())
    kept = {
        number
        for step in left
        if step.may_have_gaps and step.index not in again
        for number in step.numbers
        if number in present
    }
    unfinished = [number for step in left for number in step.numbers if number not in kept]
    known = [number for number in unfinished if number in present]
    if known:
        retaken = [step.index for step in left if step.index in again]
        why = f"steps {retaken} are taken again for a damaged frame" if retaken else "the step was cut off"
        journal.append("discard", sync=True, frames=known, why=why)
    for number in unfinished:  # a frame may have been renamed just before the kill, without its line
        for path in (folder.frame_path(number), folder.correction_path(number)):
            path.unlink(missing_ok=True)
    for name in ("frames", "corrected"):
        for leftover in (folder.path / name).glob("*.part"):
            leftover.unlink()
    return len(known)


def make_done_record(folder: RunFolder, steps: Sequence[Step], caught_up: int) -> dict[str, Any]:
    """Contents of done.json.

    Raises
    ------
    BadBalance
        Frames are missing or ambiguous; the run is not done.
    """
    entries = folder.entries()
    total, sessions = total_accounting(entries)
    present = frame_entries(entries)
    absent = folder.absent(entries)
    gaps = gaps_by_step(entries)
    never_came = {number for found in gaps.values() for number in numbers_in(found)}
    if absent or {number for step in steps for number in step.numbers} - never_came != set(present):
        raise BadBalance(f"{len(present)} frames in the journal, {len(absent)} of them without a file")
    if said := ambiguities(entries):
        raise BadBalance(f"{said[0]}; begin a new run")
    about = [{"step": i, "tag": steps[i].tag, "gaps": found} for i, found in sorted(gaps.items())]
    flows = [entry["flow"] for entry in entries if entry["kind"] == "counts"]
    return {
        "utc": utc_now(),
        "steps": len(steps),
        "frames": len(present),
        "conservation": total.to_dict(),
        "sessions": sessions,
        "corrected_after_the_run": caught_up,
        **({"gaps": about} if about else {}),
        "flow": flows,
        "sha256": run_hash(folder.path, {line["file"]: line["crc32"] for line in present.values()}),
    }
