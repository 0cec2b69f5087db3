"""The runner: a list of steps, one after the other, with a journal.

    for each step that the journal does not have:
        route to its positions -> settle -> read positions back -> frames -> all on the disk -> journal

A step is finished when every frame of it is on the disk; only then it enters the journal.  Whatever comes between
(Ctrl-C, a lost camera, kill -9) leaves a run that `rtpiv resume` continues: frames of an unfinished step are
discarded, and the step is taken again from the start, so that the frames of a pair always belong together.  A step
that may have gaps keeps every frame instead and goes on behind the last one (runner.step_frames).

A session in which a frame may have been filed under the wrong stop says so in its lines; its run is never done.
"""

from collections.abc import Collection, Container, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from daq.bench.bench_table import CAMERA
from daq.bench.opened import OpenBench, known_positions
from daq.errors import BadBalance, PlanError, ResumeRefused, RunInterrupted
from daq.pipeline.corrections import Corrections, correct_from_disk, uncorrected
from daq.pipeline.job import Show
from daq.pipeline.lanes import LIVE_QUEUE, Pipeline
from daq.pipeline.live_pairs import warm_up
from daq.plans.link_budget import require_link
from daq.plans.pulse_order import PulseOrder, pairs_section
from daq.plans.steps import Step
from daq.runner.arrival import go_to, require_arrived, rest
from daq.runner.camera_session import CameraSession
from daq.runner.camera_watch import camera_facts
from daq.runner.companion import Companion
from daq.runner.flow_side import FlowSide
from daq.runner.flow_step import FlowStep
from daq.runner.interrupts import Interrupts
from daq.runner.light import Light, NoOperator, Operator
from daq.runner.pair_source import PairSource
from daq.runner.progress import Progress, Watcher
from daq.runner.session_record import (
    begin_session,
    done_record,
    end_session,
    utc_now,
    write_camera_file,
)
from daq.runner.step_frames import StepFrames
from daq.runs.conservation import Ledger
from daq.runs.displacement import displacements, write_displacements
from daq.runs.gaps import Gaps
from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder, frame_entries, remaining
from daq.runs.seal import write_record
from daq.runs.session_books import doubts
from daq.timing.errors import LaserStopped
from daq.whole_text import sync_folder
from stages.errors import DeviceLost, NotInPosition, StageError

if TYPE_CHECKING:
    from daq.runner.aiming import Aiming


def discard_unfinished(
    folder: RunFolder, steps: Sequence[Step], journal: Journal, again: Container[int] = ()
) -> int:
    """Drop frames of steps that were cut off or are to be taken `again`, in the journal first; return how many.

    A step that may have gaps keeps its frames, unless it is to be taken again.
    """
    entries = folder.entries()
    left = remaining(steps, entries, again)
    present = frame_entries(entries)
    kept = {
        number
        for step in left
        if step.may_have_gaps and step.index not in again
        for number in step.numbers
        if number in present
    }
    doubtful = [number for step in left for number in step.numbers if number not in kept]
    known = [number for number in doubtful if number in present]
    if known:
        retaken = [step.index for step in left if step.index in again]
        why = f"steps {retaken} are taken again for a damaged frame" if retaken else "the step was cut off"
        journal.append("discard", sync=True, frames=known, why=why)
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
    again : collection of int
        Finished steps that are to be taken again: a frame of theirs is damaged, see runner.retake.
    operator : Operator, optional
        The person at the bench, whom a laser asks for its word.
    aiming : Aiming, optional
        Decides where the next step of an alignment is.
    companions : sequence of Companion
        Further cameras, of steps that are lit by pulses.
    """

    def __init__(
        self,
        hardware: OpenBench,
        folder: RunFolder,
        steps: Sequence[Step],
        corrections: Corrections | None = None,
        watcher: Watcher | None = None,
        live_queue: int = LIVE_QUEUE,
        again: Collection[int] = (),
        operator: Operator | None = None,
        show: Show | None = None,
        aiming: "Aiming | None" = None,
        companions: Sequence[Companion] = (),
    ) -> None:
        self._hardware = hardware
        self._folder = folder
        self._steps = list(steps)
        self._corrections = corrections
        self._watcher = watcher or (lambda progress: None)
        self._live_queue, self._show = live_queue, show
        self._again = again
        self._journal: Journal | None = None
        self._exposures = CameraSession(
            hardware.camera, hardware.camera_section, hardware.stage.latch, self._write_doubt
        )
        self._rests_at_mm: dict[str, float] = {}
        self._found_mm: dict[str, float] | None = None  # at the end of the step before
        self._caught_up = 0
        self.progress = Progress(steps=len(self._steps))
        self.interrupts = Interrupts(hardware.stage.stop_quietly)
        self._aiming = aiming
        self._companions = companions
        self._operator = operator or NoOperator()
        self._light = Light(hardware, folder, self._operator, self.interrupts)

    def run(self) -> dict[str, Any]:
        """Do what is left; return the contents of done.json.

        Raises
        ------
        RunInterrupted
            Asked for; the run can be resumed.
        StageError, CameraError, DiskError, FramesLost
            What came between; the run can be resumed.
        ResumeRefused, FrameDoubt, BadBalance
            A frame of an earlier session, or of this one, is in doubt; the run cannot be resumed.
        """
        journal = self._journal = Journal(self._folder.journal_path)
        try:
            entries = self._folder.entries()
            if said := doubts(entries):
                raise ResumeRefused(f"{self._folder.path}: {said[0]}; begin a new run")
            left = remaining(self._steps, entries, self._again)
            begin_session(journal, self._hardware, len(left))
            discard_unfinished(self._folder, self._steps, journal, self._again)
            present = frame_entries(self._folder.entries())
            self.progress.planned = sum(number not in present for step in left for number in step.numbers)
            if self._corrections is not None:
                self._corrections.prepare(step.view for step in left if step.on_plane)
                if any(step.group == 2 and step.on_plane for step in left):
                    warm_up()
            with self.interrupts:
                self._session(journal, left)
            self._catch_up()
            if moved := displacements(self._hardware.bench, self._steps, self._folder.entries()):
                write_displacements(self._folder, moved)
            for companion in self._companions:
                self._tell(f"correcting what was skipped of {companion.name}")
                companion.complete(self._steps)
            done = done_record(self._folder, self._steps, self._caught_up)
            write_record(self._folder.path / "done.json", done)
            return done
        finally:
            journal.close()
            for companion in self._companions:
                companion.close()

    # ---- a session -----------------------------------------------------------------------------

    def _session(self, journal: Journal, left: list[Step]) -> None:
        settings = self._exposures.set_up() if left else {}
        self._exposures.check_frame_timeout(settings)
        require_link(self._hardware.bench, left, settings)
        write_camera_file(self._folder, self._hardware, settings)
        raw_queue = max(1, self._hardware.camera_section.buffers // 2)
        pipeline = Pipeline(self._folder, journal, self._corrections, self._live_queue, raw_queue, self._show)
        self.progress.flow = pipeline.flow
        frames = StepFrames(
            self._folder, journal, pipeline, self._exposures, self._hardware, self.interrupts, self.progress,
            self._tell,
        )  # fmt: skip
        why, error_text = "finished", ""
        try:
            flow = self._flow_step(journal, pipeline, left)
            self._note_camera(journal)
            for step in left:
                self._between_steps(len(self._steps) - step.index)
                aimed = step if self._aiming is None else self._aiming.before(step)
                self._step(journal, frames, aimed, flow)
                self._note_camera(journal)
                if self._aiming is not None:
                    self._aiming.after(aimed, journal)
                    if self._aiming.is_settled:  # the looks that are left would show the same
                        self._steps = self._steps[: step.index + 1]
                        break
        except BaseException as error:
            why, error_text = type(error).__name__, str(error)
            raise
        finally:
            try:
                self._light.off()
                self._exposures.end()
            finally:
                doubts_beside = [companion.end(why, error_text) for companion in self._companions]
                ledger, doubt = end_session(journal, self._exposures, pipeline, why, error_text)
                doubt = "; ".join(filter(None, [doubt, *doubts_beside]))
                self._tell("closing", ledger)
        if doubt:
            raise BadBalance(f"{doubt}; look at {self._folder.journal_path}, and begin a new run")

    def _flow_step(self, journal: Journal, pipeline: Pipeline, left: Sequence[Step]) -> FlowStep | None:
        """Who takes steps that are lit by pulses, with every camera set up; None if there are none."""
        if not any(step.pulses is not None for step in left):
            return None
        source = PairSource(CAMERA, self._exposures, pairs_section(self._hardware.bench))
        beside = [companion.begin(left) for companion in self._companions]
        sides = [FlowSide(self._folder, journal, pipeline, source), *beside]
        return FlowStep(sides, self.interrupts, self.progress, self._tell, self._light)

    def _note_camera(self, journal: Journal) -> None:
        """Have on the record what the camera tells of its clock and its temperature."""
        if facts := camera_facts(self._hardware.camera):
            journal.append("camera", **facts)
        for companion in self._companions:
            companion.note_camera()

    def _write_doubt(self, said: str) -> None:
        """Have a doubt on the disk before anything else happens; a kill may follow."""
        if self._journal is not None:
            self._journal.append("doubt", sync=True, doubt=said)

    def _between_steps(self, left: int) -> None:
        if self.interrupts.paused:
            self._tell("paused")
            self.interrupts.wait()
        if self.interrupts.wanted:
            raise RunInterrupted(f"ended on request with {left} of {len(self._steps)} steps left")

    def _step(self, journal: Journal, frames: StepFrames, step: Step, flow: FlowStep | None) -> None:
        self.progress.step, self.progress.tag = step.index, step.tag
        place = "on the way to"
        try:
            record = self._arrive(journal, step)
            place = "at"
            self._tell("exposing")
            if flow is not None and step.pulses is not None:
                self._see_to_seeding(step, step.pulses)
                gaps: Gaps | None = [] if flow.take(step, record) else None
            else:
                gaps = frames.take(step, record)
            self._require_still_there(journal, frames, step, record)
        except StageError as error:
            if self.interrupts.wanted and not isinstance(error, DeviceLost):
                raise RunInterrupted(f"stopped {place} step {step.index} ({step.tag}): {error}") from error
            raise
        except LaserStopped as error:
            if self.interrupts.wanted:
                raise RunInterrupted(f"stopped at step {step.index} ({step.tag}): {error}") from error
            raise
        if gaps is None:
            raise RunInterrupted(f"ended on request within step {step.index} ({step.tag}), which keeps its frames")
        record |= {"gaps": gaps} if gaps else {}
        for companion in self._companions:
            companion.finish_step(step, record)
        journal.append("step", sync=True, step=step.index, tag=step.tag, utc=utc_now(), **record)
        sync_folder(self._folder.path / "frames")

    def _see_to_seeding(self, step: Step, pulses: PulseOrder) -> None:
        """Have the seeding opened between the background and the flow."""
        before = self._steps[step.index - 1].pulses if step.index else None
        if not pulses.is_background and before is not None and before.is_background:
            self._tell("waiting for the seeding to be opened, then Enter")
            self._operator.open_seeding()
        if self._hardware.simulation is not None:
            self._hardware.simulation.seed(not pulses.is_background)

    def _arrive(self, journal: Journal, step: Step) -> dict[str, Any]:
        """Bring everything to a step's place; return what its frames and its line will say about positions."""
        self._tell("moving")
        planned, token = step.targets_mm, self._hardware.stage.latch.begin()
        before, found, self._rests_at_mm, self._found_mm = self._rests_at_mm, self._found_mm, {}, None
        go_to(self._hardware, planned, before, found)
        self._rests_at_mm = planned
        rest(self._hardware, step.settle_s, token)
        measured = known_positions(self._hardware.stage.where_mm())
        self.progress.positions_mm = measured
        record: dict[str, Any] = {"planned_mm": planned, "measured_mm": measured}
        if self._hardware.simulation is not None:
            record["true_mm"] = self._hardware.simulation.true_mm()
        self._require_arrived(journal, step, record, measured)
        return record

    def _require_still_there(
        self, journal: Journal, frames: StepFrames, step: Step, record: Mapping[str, Any]
    ) -> None:
        """Ask once more when the frames are in: what was exposed elsewhere must not stay under this step."""
        try:
            measured = known_positions(self._hardware.stage.where_mm())
            self._require_arrived(journal, step, record, measured)
        except (StageError, PlanError):
            frames.discard(step)
            raise
        self._found_mm = measured

    def _require_arrived(
        self, journal: Journal, step: Step, record: Mapping[str, Any], measured_mm: Mapping[str, float]
    ) -> None:
        try:
            require_arrived(self._hardware, record["planned_mm"], measured_mm)
        except NotInPosition:
            self._rests_at_mm = {}
            about = {"planned_mm": record["planned_mm"], "measured_mm": dict(measured_mm)}
            journal.append("miss", sync=True, step=step.index, tag=step.tag, utc=utc_now(), **about)
            raise

    def _tell(self, doing: str, ledger: Ledger | None = None) -> None:
        self.progress.doing, self.progress.laser = doing, self._light.state
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
