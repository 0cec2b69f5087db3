"""The runner: a list of steps, one after the other, with a journal.

    for each step that the journal does not have:
        route to its positions -> settle -> read positions back -> gauges -> frames -> read positions again
        -> all on the disk -> journal

A step is finished when all of its frames are on disk; only then it enters the journal.  Any interruption (Ctrl-C,
a lost camera, kill -9) leaves a run that `rtpiv acquire --resume` continues: frames of an unfinished step are
discarded, and the step is repeated from the start, so that the frames of a pair always belong together.  A step
that may have gaps keeps its frames instead and continues behind the last one (runner.step_frames).  A session is
the part of a run from one start to its end or interruption.

If a frame may have been stored with the wrong position, the journal says so, and the run never counts as done.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from daq.bench.opened import OpenBench, require_positions
from daq.errors import BadBalance, PlanError, RunInterrupted
from daq.pipeline.preview_vectors import warm_up
from daq.plans.forecast import forecast, simulation_s
from daq.plans.pulse_order import PulseOrder
from daq.plans.steps import Step
from daq.runner.arrival import go_to, require_arrived, rest
from daq.runner.external_light import ExternalLight
from daq.runner.flow_step import FlowStep
from daq.runner.interrupts import Interrupts
from daq.runner.laser_session import LaserSession, NoOperator, Operator
from daq.runner.progress import Progress, Watcher
from daq.runner.run_camera import RunCamera
from daq.runner.step_frames import StepFrames
from daq.runner.step_readings import Gauges
from daq.runs.frame_accounting import FrameAccounting
from daq.runs.gaps import Gaps
from daq.runs.journal import utc_now
from daq.runs.run_folder import frame_entries, remaining
from daq.timing.errors import LaserStopped
from stages.errors import DeviceLost, NotInPosition, StageError
from stages.scale_question import ScaleQuestion

if TYPE_CHECKING:
    from daq.runner.alignment_loop import AlignmentLoop


class Runner:
    """Executes the steps of a run that are not finished yet.

    Parameters
    ----------
    hardware : OpenBench
        Open, homed.
    cameras : sequence of RunCamera
        Cameras of the run: the first one takes frames in every step, further ones only in steps lit by pulses.
    steps : sequence of Step
        All steps of the plan.
    watcher : callable, optional
        Called with the progress after every change.
    again : collection of int
        Finished steps to repeat because one of their frames is damaged, see session.steps_to_retake.
    operator : Operator, optional
        Person at the bench, who types the confirmation code of a laser.
    alignment : AlignmentLoop, optional
        Computes the positions of the next step of an alignment.
    needed : collection of str
        Readings without which no step is executed.
    """

    def __init__(
        self,
        hardware: OpenBench,
        cameras: Sequence[RunCamera],
        steps: Sequence[Step],
        watcher: Watcher | None = None,
        again: Collection[int] = (),
        operator: Operator | None = None,
        alignment: "AlignmentLoop | None" = None,
        needed: Collection[str] = (),
    ) -> None:
        self._hardware = hardware
        self._cameras = list(cameras)
        self._first = cameras[0]
        self._steps = list(steps)
        self._watcher = watcher or (lambda progress: None)
        self._again = again
        self._rests_at_mm: dict[str, float] = {}
        self._found_mm: dict[str, float] | None = None  # at the end of the step before
        self.progress = Progress(steps=len(self._steps))
        self.interrupts = Interrupts(hardware.stage.stop_quietly)
        self._alignment = alignment
        self._gauges = Gauges(hardware.devices, needed)
        if hardware.simulation is None:
            hardware.stage.set_operator(self._ask_operator)
        self._operator = operator or NoOperator()
        self._laser_session = LaserSession(hardware, self._first.folder, self._operator, self.interrupts)

    def run(self) -> dict[str, Any]:
        """Execute the steps that are left, in one session.

        Returns
        -------
        dict
            Contents of done.json.

        Raises
        ------
        RunInterrupted
            Ended on request; the run can be resumed.
        StageError, CameraError, DiskError, FramesLost
            A device or the disk failed; the run can be resumed.
        ResumeRefused, FrameDoubt, BadBalance
            A frame of an earlier session, or of this one, is ambiguous; the run cannot be resumed.
        """
        with ExitStack() as stack:
            for camera in self._cameras:
                stack.callback(camera.close)
                camera.lock()
            left = remaining(self._steps, self._first.folder.entries(), self._again)
            pulsed = any(step.pulses is not None for step in left)
            # Further ones see pulsed steps alone
            used = self._cameras if pulsed else self._cameras[:1]
            for camera in used:
                camera.open(left, self._again)
            present = frame_entries(self._first.folder.entries())
            missing = [sum(number not in present for number in step.numbers) for step in left]
            self.progress.expect(left, missing, self._forecast_s(left))
            # Live vectors need corrected pairs (group: frames that belong together, 2 of a pair); their kernels
            # are compiled before the first frame.
            if self._first.corrects and any(step.group == 2 and step.on_plane for step in left):
                warm_up()
            with self.interrupts:
                self._session(used, left)
            for camera in self._closing_order:
                done = camera.complete(self._steps, self._tell)
            return done

    def _forecast_s(self, left: Sequence[Step]) -> Sequence[float]:
        """Expected duration [s] of each step, before any step has been timed."""
        bench = self._hardware.bench
        if self._hardware.simulation is not None and (rendering_s := simulation_s(bench, left)):
            return rendering_s
        return forecast(bench, self._hardware.stage, left).steps_s

    @property
    def _closing_order(self) -> list[RunCamera]:
        """Cameras in the order in which they complete a step: the first one last, since its journal decides."""
        return [*self._cameras[1:], self._first]

    # ---- a session -----------------------------------------------------------------------------

    def _session(self, used: Sequence[RunCamera], left: Sequence[Step]) -> None:
        why, error_text = "finished", ""
        try:
            # Settings that a camera refuses are found before anything moves.
            for camera in used:
                camera.set_up(left)
            first = self._first
            frames = StepFrames(first, self.interrupts, self.progress, self._tell)
            flow = None
            if any(step.pulses is not None for step in left):
                writers = [camera.pair_writer() for camera in used]
                external = any(step.is_lit_from_outside for step in left)
                light = ExternalLight(self._hardware.bench, self.interrupts) if external else self._laser_session
                flow = FlowStep(writers, self.interrupts, self.progress, self._tell, light)
            self._note_cameras(used)
            for step in left:
                self._between_steps(len(self._steps) - step.index)
                aimed = step if self._alignment is None else self._alignment.before(step)
                self._step(frames, aimed, flow)
                self._note_cameras(used)
                if self._alignment is not None:
                    self._alignment.after(aimed, first.journal)
                    if self._alignment.is_settled:  # further steps would show the same
                        self._steps = self._steps[: step.index + 1]
                        break
        except BaseException as error:
            why, error_text = type(error).__name__, str(error)
            raise
        finally:
            # Light off first: no frame may arrive after its camera has closed its count of frames.
            try:
                self._laser_session.off()
                self._first.session.end()
            finally:
                # (frame count, ambiguities or "") of each camera; the first camera is last, and its text comes
                # first.
                ended = [camera.end(why, error_text) for camera in self._closing_order]
                problem = "; ".join(text for _, text in (ended[-1], *ended[:-1]) if text)
                self._tell("closing", ended[-1][0])
        if problem:
            raise BadBalance(f"{problem}; look at {self._first.folder.journal_path}, and begin a new run")

    def _note_cameras(self, used: Sequence[RunCamera]) -> None:
        for camera in used:
            camera.note_camera()

    def _between_steps(self, left: int) -> None:
        if self.interrupts.is_paused:
            self._tell("paused")
            with self.progress.aside():
                self.interrupts.wait()
        if self.interrupts.is_end_wanted:
            raise RunInterrupted(f"ended on request with {left} of {len(self._steps)} steps left")

    def _step(self, frames: StepFrames, step: Step, flow: FlowStep | None) -> None:
        self.progress.step, self.progress.tag = step.index, step.tag
        if self._hardware.simulation is not None:
            self._hardware.simulation.step_begins(step.index + 1)
        place = "on the way to"
        try:
            record = self._arrive(step)
            place = "at"
            # Gauges are read at rest, before the first frame: a slow one must not delay the frames after their
            # position was read.
            readings = self._gauges.read(self.progress)
            self._tell("exposing")
            if flow is not None and step.pulses is not None:
                self._see_to_seeding(step, step.pulses)
                # None: ended on request
                gaps: Gaps | None = [] if flow.take(step, record) else None
            else:
                gaps = frames.take(step, record)
            self._require_still_there(frames, step, record)
        except StageError as error:
            # A stop by the operator ends the run on request; a lost device is reported as lost even then.
            if self.interrupts.is_end_wanted and not isinstance(error, DeviceLost):
                raise RunInterrupted(f"stopped {place} step {step.index + 1} ({step.tag}): {error}") from error
            raise
        except LaserStopped as error:
            if self.interrupts.is_end_wanted:
                raise RunInterrupted(f"stopped at step {step.index + 1} ({step.tag}): {error}") from error
            raise
        if gaps is None:
            raise RunInterrupted(
                f"ended on request within step {step.index + 1} ({step.tag}), which keeps its frames"
            )
        record |= {"gaps": gaps} if gaps else {}
        record |= {"readings": readings} if readings else {}
        # Standard deviation of one reading [um] of each scale that a person reads.
        by_hand = self._hardware.bench.table.stages.by_hand
        record |= {"reading_um": by_hand} if by_hand else {}
        for camera in self._closing_order:
            camera.finish_step(step, record)

    def _see_to_seeding(self, step: Step, pulses: PulseOrder) -> None:
        """Ask the operator to open the seeding between background and flow; the simulation opens its own."""
        before = self._steps[step.index - 1].pulses if step.index else None
        if not pulses.is_background and before is not None and before.is_background:
            self._tell("waiting for the seeding to be opened, then Enter")
            with self.progress.aside():
                self._operator.open_seeding()
        if self._hardware.simulation is not None:
            self._hardware.simulation.seed(not pulses.is_background)

    def _arrive(self, step: Step) -> dict[str, Any]:
        """Move to the positions of a step; return those for the records of its frames and its journal line."""
        self._tell("moving")
        # The token of the stop latch is taken before the motion: a stop during the motion also ends the waiting
        # after it.
        planned, token = step.targets_mm, self._hardware.stage.latch.begin()
        # Cleared first: after a failed move no position is assumed.
        before, found, self._rests_at_mm, self._found_mm = self._rests_at_mm, self._found_mm, {}, None
        go_to(self._hardware, planned, before, found)
        self._rests_at_mm = planned
        rest(self._hardware, step.settle_s, token)
        measured = require_positions(self._hardware.stage.where_mm())
        self.progress.positions_mm = measured
        record: dict[str, Any] = {"planned_mm": planned, "measured_mm": measured}
        if self._hardware.simulation is not None:
            record["true_mm"] = self._hardware.simulation.true_mm()
        self._require_arrived(step, record, measured)
        return record

    def _require_still_there(self, frames: StepFrames, step: Step, record: Mapping[str, Any]) -> None:
        """Read the positions again after the frames; discard the frames if an axis has moved meanwhile."""
        try:
            measured = require_positions(self._hardware.stage.where_mm())
            self._require_arrived(step, record, measured)
        except (StageError, PlanError):
            frames.discard(step)
            raise
        self._found_mm = measured

    def _require_arrived(self, step: Step, record: Mapping[str, Any], measured_mm: Mapping[str, float]) -> None:
        try:
            require_arrived(self._hardware, record["planned_mm"], measured_mm)
        except NotInPosition:
            self._rests_at_mm = {}
            about = {"planned_mm": record["planned_mm"], "measured_mm": dict(measured_mm)}
            # Journal kind `miss`: the axes stopped outside the tolerance of the planned position.
            self._first.journal.append("miss", sync=True, step=step.index, tag=step.tag, utc=utc_now(), **about)
            raise

    def _ask_operator(self, question: ScaleQuestion, given_up: Callable[[], bool]) -> str | None:
        """Ask the operator to move an axis by hand; a request to end the run also ends the question."""
        self._tell(f"waiting for {question.axis}, which is moved by hand")
        with self.progress.aside():
            return self._operator.reads(question, lambda: given_up() or self.interrupts.is_end_wanted)

    def _tell(self, doing: str, accounting: FrameAccounting | None = None) -> None:
        self.progress.doing, self.progress.laser = doing, self._laser_session.state
        for camera in self._cameras:
            camera.report(self.progress.of(camera.name))
        self.progress.accounting = accounting or self.progress.accounting
        self._watcher(self.progress)
