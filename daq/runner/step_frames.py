"""The frames of a step, on the disk, whatever the camera does meanwhile.

Two kinds of steps, chosen by the experiment (`Step.gaps_at_most`):

* **whole**: every frame, or none.  What the camera spoils is discarded and taken again, a few times.
* **keeps what it has**: a flow cannot be had again.  Frames stay where they are; what is lost is a gap; after a
  camera that was lost, an end of the stream before its time, or a session that ended in the middle, the camera is
  armed once more and goes on behind the last frame, at the next place that begins a group.  The journal says so
  (`arm`).  Only if the camera has forgotten its settings are frames discarded, those of that arm: they may be
  other pictures.

The end of such a step may be asked for: it stops after the present frame and can be resumed.
"""

import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from daq.errors import CameraError, CameraLost, CameraTimeout, FramesLost, SettingsChanged
from daq.pipeline.job import Job
from daq.plans.steps import Step
from daq.runner.interrupts import Interrupts
from daq.runner.progress import Progress
from daq.runner.run_camera import RunCamera
from daq.runs.gaps import Gaps, gaps_of, next_place
from daq.runs.journal import utc_now
from daq.runs.run_folder import frame_entries

DISCARDED = "the camera or an axis was not as it should be"
REPEATS = 3  # in a row, without a single frame
RETRY_S = 0.5
REHEARSED_BACK_S = 2.0  # a simulated camera comes back soon, or not before the bench is opened again


@dataclass(eq=False)
class StepFrames:
    """Takes the frames of one step after the other.

    Parameters
    ----------
    camera : RunCamera
        Set up.
    interrupts : Interrupts
        What was asked for meanwhile.
    progress : Progress
        Gets the number of frames.
    tell : callable
        Called with what is being done, after every frame.
    """

    camera: RunCamera
    interrupts: Interrupts
    progress: Progress
    tell: Callable[[str], None]
    _begun_at: int = 0  # place of this step at which this session began

    def take(self, step: Step, record: Mapping[str, Any]) -> Gaps | None:
        """Have every frame of a step on the disk, and make sure that the camera has kept its settings.

        Parameters
        ----------
        step : Step
            The step; every axis stands where it shall.
        record : mapping
            What its frames say about positions.

        Returns
        -------
        list of [int, int] or None
            Gaps of a step that may have some; None if the end was asked for before the last frame.

        Raises
        ------
        FramesLost, CameraLost, SettingsChanged
            It cannot be had; what was kept stays, and the run can be resumed.
        """
        begin = self._begun_at = self._next_place(step)
        why, barren, is_whole = "the session before ended within the step", 0, True
        while begin < step.frames:
            if begin:
                self._note_arm(step, begin, why)
            try:
                is_whole = self._expose(step, record, begin)
                break
            except (CameraLost, SettingsChanged, CameraTimeout) as error:
                self.camera.pipeline.flush()
                if not step.may_have_gaps or isinstance(error, SettingsChanged):
                    self.discard(step, begin)
                before, begin = begin, self._next_place(step)
                barren = 0 if begin > before else barren + 1
                if isinstance(error, CameraTimeout):
                    if barren or not step.may_have_gaps:
                        raise FramesLost(str(error)) from error
                elif barren == REPEATS:
                    raise
                else:
                    self._bring_back(error)
                why = str(error)
        if not is_whole:
            return None
        return gaps_of(step.numbers, self._present()) if step.may_have_gaps else []

    def discard(self, step: Step, begin: int | None = None) -> None:
        """Drop the frames that this session has taken of a step, from a place on; in the journal first."""
        present = self._present()
        numbers = [n for n in step.numbers[self._begun_at if begin is None else begin :] if n in present]
        if numbers:
            self.camera.journal.append("discard", sync=True, frames=numbers, why=DISCARDED)
            self.camera.session.discarded += len(numbers)
            self.progress.took(-len(numbers), step.index)
        for number in numbers:
            self.camera.folder.frame_path(number).unlink(missing_ok=True)
            self.camera.folder.correction_path(number).unlink(missing_ok=True)

    def _expose(self, step: Step, record: Mapping[str, Any], begin: int) -> bool:
        """One arm; False if the end was asked for before the last place."""
        places = step.frames - begin
        may_lose = max(1, int(step.gaps_at_most * places)) if step.may_have_gaps else 0
        place = begin
        with closing(self.camera.session.frames(step.frames, begin, may_lose)) as frames:
            for place, frame in frames:
                placed = frame.with_positions_mm(record["measured_mm"])
                self.camera.pipeline.submit(
                    Job(step, step.first_frame + place, placed, {**record, **self.camera.session.facts(frame)})
                )
                self.progress.took(1, step.index)
                self.tell("exposing")
                if step.may_have_gaps and self.interrupts.is_end_wanted:
                    break
        self.camera.pipeline.flush()
        self.camera.session.verify()
        return place + 1 >= step.frames or not self.interrupts.is_end_wanted

    def _note_arm(self, step: Step, begin: int, why: str) -> None:
        utc = utc_now()
        number = step.first_frame + begin
        self.camera.journal.append("arm", sync=True, step=step.index, tag=step.tag, frame=number, utc=utc, why=why)

    def _bring_back(self, why: CameraError) -> None:
        """Try to get a lost camera back for a while."""
        hardware = self.camera.hardware
        within_s = hardware.camera_section.back_within_s
        if hardware.simulation is not None:  # there is no cable to check
            within_s = min(within_s, REHEARSED_BACK_S)
        end_s = time.monotonic() + within_s
        while True:
            self.tell(f"waiting for the camera: {why}")
            try:
                self.camera.session.reopen()
                return
            except CameraError:
                if time.monotonic() > end_s or self.interrupts.is_end_wanted:
                    raise why from None
            time.sleep(RETRY_S)

    def _next_place(self, step: Step) -> int:
        return next_place(step, self._present()) if step.may_have_gaps else 0

    def _present(self) -> set[int]:
        """Frames that the journal has; it is read anew, so not for every step."""
        return set(frame_entries(self.camera.folder.entries()))
