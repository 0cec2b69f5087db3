"""Files of one camera of a flow, in its own run folder: pairs under their numbers, and counts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from daq.errors import ResumeRefused
from daq.pipeline.job import Job
from daq.pipeline.pipeline import Pipeline
from daq.plans.steps import Step
from daq.runner.laser_session import exposure_of
from daq.runner.pair_source import Chunk, Pair, PairSource
from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder, frame_entries


@dataclass(frozen=True)
class PairWriter:
    """One camera of a flow step.

    Parameters
    ----------
    folder, journal, pipeline
        Its run folder, and who writes there.
    source : PairSource
        The camera.
    """

    folder: RunFolder
    journal: Journal
    pipeline: Pipeline
    source: PairSource

    def whole_pairs(self, step: Step) -> int:
        """Place behind the last whole pair that is on the disk."""
        present = set(frame_entries(self.folder.entries()))
        place = 0
        while {step.first_frame + place, step.first_frame + place + 1} <= present and place < step.frames:
            place += 2
        return place

    def cut_to(self, step: Step, place: int) -> None:
        """Drop what lies behind a place: frames without their partners, or pairs that another camera has not."""
        present = set(frame_entries(self.folder.entries()))
        loose = [number for number in step.numbers[place:] if number in present]
        if loose:
            self.journal.append("discard", sync=True, frames=loose, why="their pairs are not whole")
        for number in loose:
            self.folder.frame_path(number).unlink(missing_ok=True)
            self.folder.correction_path(number).unlink(missing_ok=True)

    def chunks_so_far(self, step: Step) -> int:
        """Number of the next chunk."""
        entries = self.folder.entries()
        numbers = [entry["chunk"] for entry in entries if entry["kind"] == "chunk" and entry["step"] == step.index]
        numbers += [
            entry["pair"]["chunk"]
            for entry in entries
            if entry["kind"] == "frame" and entry["step"] == step.index and "pair" in entry
        ]
        return max(numbers, default=-1) + 1

    def require_same_exposure(self) -> None:
        """Refuse to go on, before anything is fired, if the camera exposes otherwise than so far."""
        now_us = exposure_of(self.source.exposures.settings)
        for number, entry in frame_entries(self.folder.entries()).items():
            if "pair" not in entry or entry["pair"]["exposure"] == "B" or entry["exposure_us"] is None:
                continue
            if not math.isclose(entry["exposure_us"], now_us, rel_tol=1e-6):
                what = "background was" if entry["pair"].get("background") else "pairs were"
                raise ResumeRefused(
                    f"{self.folder.path}: its {what} exposed for {entry['exposure_us']:g} us "
                    f"(frame {number}) and the camera is at {now_us:g} us now; set it back, or begin a new run"
                )

    def keep(self, step: Step, record: Mapping[str, Any], place: int, number: int, pair: Pair) -> None:
        """Give a pair to the threads."""
        order, section = step.pulses, self.source.section
        assert order is not None
        about: dict[str, Any] = {"chunk": number, "dt_us": order.dt_us, "marker": section.effective_marker}
        if order.dt_measured_us is not None:
            about["dt_measured_us"] = order.dt_measured_us
        if order.dt_measured_us is not None and order.dt_sigma_us is not None:
            about["dt_sigma_us"] = order.dt_sigma_us
        if order.is_background:
            about["background"] = True
        for half, (letter, frame) in enumerate(zip("AB", pair, strict=True)):
            placed = frame.with_positions_mm(record["measured_mm"])
            chunks = self.source.exposures.facts(placed)
            facts = {**record, "pair": {"exposure": letter, **about}, **chunks}
            if letter == "B" and section.second_exposure_us is not None:  # the camera tells that of A alone
                facts["exposure_us"] = section.second_exposure_us
            self.pipeline.submit(Job(step, step.first_frame + place + half, placed, facts))

    def close(self, step: Step, chunk: Chunk, number: int, utc: str, synchroniser: str = "") -> None:
        """Write the counts of a chunk, once its pairs are on the disk."""
        self.pipeline.flush()
        self.journal.append(
            "chunk",
            sync=True,
            step=step.index,
            tag=step.tag,
            utc=utc,
            chunk=number,
            fired=chunk.fired,
            triggers=chunk.fired,
            pairs=chunk.kept,
            surplus=chunk.surplus,
            lost=chunk.losses,
            dropped=dict(sorted(chunk.dropped.items())),
            never_came=chunk.never_came,
            **({"synchroniser": synchroniser} if synchroniser else {}),
        )
