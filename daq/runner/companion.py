"""A further camera of a run: the same steps, lit by the same pulses, in a run folder of its own inside the run's.

Its folder (cameras/NAME) is a run like any other, with the camera's own scene, so whatever reads runs reads it.
It has the frame numbers of the run, and frames of one number show the same trigger.  Its lines of a step and its
done.json are on the disk before those of the run: a run that is done has all of its cameras.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from daq.bench.bench_table import CAMERA
from daq.bench.opened import OpenBench
from daq.errors import ResumeRefused
from daq.pipeline.corrections import Corrections, correct_from_disk, uncorrected
from daq.pipeline.lanes import Pipeline
from daq.plans.link_budget import require_link
from daq.plans.pulse_order import pairs_section
from daq.plans.steps import Step
from daq.runner.camera_session import CameraSession
from daq.runner.camera_watch import camera_facts
from daq.runner.flow_side import FlowSide
from daq.runner.pair_source import PairSource
from daq.runner.session_record import (
    begin_session,
    done_record,
    end_session,
    utc_now,
    write_camera_file,
)
from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder, finished_steps
from daq.runs.seal import write_record
from daq.runs.session_books import doubts
from daq.whole_text import sync_folder


class Companion:
    """A further camera of one session.

    Parameters
    ----------
    name : str
        Device of the bench.
    hardware : OpenBench
        The bench of the run, open.
    folder : RunFolder
        The camera's.
    corrections : Corrections, optional
        By the camera's own scene; None to leave frames uncorrected.
    live_queue : int
        See `Pipeline`.
    """

    def __init__(
        self,
        name: str,
        hardware: OpenBench,
        folder: RunFolder,
        corrections: Corrections | None,
        live_queue: int,
    ) -> None:
        self.name = name
        self._hardware = replace(
            hardware,
            bench=hardware.bench.seen_by(name),
            devices={**hardware.devices, CAMERA: hardware.devices[name]},
            sections={**hardware.sections, CAMERA: hardware.sections[name]},
        )
        self._folder = folder
        self._corrections = corrections
        self._live_queue = live_queue
        self._journal = Journal(folder.journal_path)
        self._pipeline: Pipeline | None = None
        latch = self._hardware.stage.latch
        self.exposures = CameraSession(
            self._hardware.camera, self._hardware.camera_section, latch, self._write_doubt
        )

    def begin(self, left: Sequence[Step]) -> FlowSide:
        """Open the books and set the camera up, before anything moves.

        Raises
        ------
        ResumeRefused
            A frame of an earlier session is in doubt.
        CameraError, RunUsageError
            The camera is not there, or cannot do what the steps ask for.
        """
        if said := doubts(self._folder.entries()):
            raise ResumeRefused(f"{self._folder.path}: {said[0]}; begin a new run")
        begin_session(self._journal, self._hardware, len(left))
        if self._corrections is not None:
            self._corrections.prepare(step.view for step in left if step.on_plane)
        settings = self.exposures.set_up()
        self.exposures.check_frame_timeout(settings)
        require_link(self._hardware.bench, left, settings)
        write_camera_file(self._folder, self._hardware, settings)
        raw_queue = max(1, self._hardware.camera_section.buffers // 2)
        self._pipeline = Pipeline(
            self._folder, self._journal, self._corrections, self._live_queue, raw_queue, None
        )
        source = PairSource(self.name, self.exposures, pairs_section(self._hardware.bench))
        return FlowSide(self._folder, self._journal, self._pipeline, source)

    def note_camera(self) -> None:
        """Have on the record what the camera tells of its clock and its temperature."""
        if facts := camera_facts(self._hardware.camera):
            self._journal.append("camera", **facts)

    def finish_step(self, step: Step, record: Mapping[str, Any]) -> None:
        """Say that a step is on the disk, unless an earlier session has."""
        if step.index not in finished_steps(self._folder.entries()):
            self._journal.append("step", sync=True, step=step.index, tag=step.tag, utc=utc_now(), **record)
            sync_folder(self._folder.path / "frames")

    def end(self, why: str, error: str) -> str:
        """Close the books of the session; return what is in doubt."""
        self.exposures.end()
        if self._pipeline is None:
            return ""
        return end_session(self._journal, self.exposures, self._pipeline, why, error)[1]

    def complete(self, steps: Sequence[Step]) -> None:
        """Correct what was left, and write done.json; BadBalance if frames are missing or in doubt."""
        caught_up = 0
        if self._corrections is not None:
            self._corrections.prepare(step.view for step in steps if step.on_plane)
            for step, number in uncorrected(self._folder, self._corrections, steps):
                correct_from_disk(self._folder, self._corrections, step, number)
                caught_up += 1
            self._corrections.write_masks(self._folder.path / "corrected")
        write_record(self._folder.path / "done.json", done_record(self._folder, steps, caught_up))

    def close(self) -> None:
        """Close the journal."""
        with suppress(OSError):
            self._journal.close()

    def _write_doubt(self, said: str) -> None:
        self._journal.append("doubt", sync=True, doubt=said)
