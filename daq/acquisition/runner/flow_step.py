"""The pairs of a step that is lit by pulses, chunk by chunk.

    camera armed and empty -> laser armed -> n pairs fired -> frames to pairs (pair_finder) -> books -> next chunk

A pair is kept when it is sure, and gets the next two places of the step; what was lost is counted in the line of
its chunk and fired again, so a step has no gaps.  A flow goes on meanwhile: the time of each pair stands in its
record.  Frames of pairs before the first light and behind the last are dropped (brightness).

    frames:  2 triggers = 2 pairs + dropped by reason + those that never came
    pairs:   fired = kept + lost + surplus
"""

import math
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from datetime import UTC, datetime
from typing import Any

from daq.acquisition.bench.opened import OpenBench
from daq.acquisition.cameras.frame import Frame
from daq.acquisition.pipeline.job import Job
from daq.acquisition.pipeline.lanes import Pipeline
from daq.acquisition.plans.pulse_order import PulseOrder, pairs_section
from daq.acquisition.plans.steps import Step
from daq.acquisition.runner.brightness import BrightnessSign, LightWatch, mean_counts
from daq.acquisition.runner.chunk import Chunk
from daq.acquisition.runner.exposures import Exposures
from daq.acquisition.runner.interrupts import Interrupts
from daq.acquisition.runner.light import Light, exposure_of
from daq.acquisition.runner.marker_sense import MarkerSense
from daq.acquisition.runner.pair_finder import PairFinder
from daq.acquisition.runner.progress import Progress
from daq.acquisition.runner.shot import Shot
from daq.acquisition.runs.chunk_books import DARK, HALF, LEFT, SURPLUS
from daq.acquisition.runs.journal import Journal
from daq.acquisition.runs.run_folder import RunFolder, frame_entries
from daq.errors import BadFrame, CameraTimeout, FramesLost, OtherFormat, ResumeRefused
from daq.timing.laser import Laser
from daq.timing.states import EMITS

SLICE_S = 0.05
SPARE = 2  # pairs fired beyond those that are still wanted: the first ones are lost most easily
BARREN, MANY = 2, 10  # chunks in a row without a pair; one is enough if so many were fired
LOST_ANYHOW = 2  # pairs that may be lost, however few were fired
Pair = tuple[Frame, Frame]


class FlowStep:
    """Takes the pairs of one step after the other.

    Parameters
    ----------
    folder, journal, pipeline, exposures, hardware, interrupts, progress, tell
        As for `StepFrames`.
    light : Light
        The laser of the session.
    """

    def __init__(
        self,
        folder: RunFolder,
        journal: Journal,
        pipeline: Pipeline,
        exposures: Exposures,
        hardware: OpenBench,
        interrupts: Interrupts,
        progress: Progress,
        tell: Callable[[str], None],
        light: Light,
    ) -> None:
        self._folder = folder
        self._journal = journal
        self._pipeline = pipeline
        self._exposures = exposures
        self._hardware = hardware
        self._interrupts = interrupts
        self._progress = progress
        self._tell = tell
        self._light = light
        self._section = pairs_section(hardware.bench)
        self._watches = (LightWatch(), LightWatch())
        self._sense = MarkerSense(self._section)

    def take(self, step: Step, record: Mapping[str, Any]) -> bool:
        """Have every pair of a step on the disk; False if the end was asked for before the last one.

        Parameters
        ----------
        step : Step
            The step; every axis stands where it shall.
        record : mapping
            What its frames say about positions.

        Raises
        ------
        FramesLost
            Too many pairs that were fired are not sure; what was kept stays, and the run can be resumed.
        FrameDoubt
            A and B have changed places, or the marker calls B an A.
        CameraError, TimingError, MotionStopped
            What came between; the laser is off, and the run can be resumed.
        """
        order = step.pulses
        assert order is not None
        place = self._whole_pairs(step)
        number = self._chunks_so_far(step)
        self._require_same_exposure()
        laser = self._light.prepare(order, self._exposures.settings, self._tell)
        self._watches, self._sense = (LightWatch(), LightWatch()), MarkerSense(self._section)
        sign, spare, barren, fired, lost, edges = BrightnessSign(), 0, 0, 0, 0, 0
        while place < step.frames:
            if self._interrupts.wanted:
                return False
            wanted = (step.frames - place) // 2
            pairs = min(order.chunk, wanted + max(spare, SPARE), laser.most_pairs)
            chunk = Chunk(pairs, pairs)
            utc = _utc()
            try:
                with closing(self._chunk(order, laser, chunk, min(wanted, pairs), sign)) as found:
                    for first, second in found:
                        self._keep(step, record, place, number, first, second)
                        place += 2
            finally:
                self._close(step, chunk, number, utc)
            self._trust_marker(is_final=False)
            number += 1
            fired, lost, spare = fired + pairs, lost + chunk.lost, max(spare, chunk.lost)
            barren = 0 if chunk.kept else barren + 1
            edges += chunk.triggers > chunk.fired  # where lamps run, a chunk may begin or end with half a pair
            too_many = lost > max(LOST_ANYHOW, order.lost_at_most * fired) + edges
            if barren == BARREN or (barren and pairs >= MANY) or too_many:
                raise FramesLost(
                    f"{lost} of {fired} pairs are lost, in the last chunk {chunk.sentence()}; look at the marker, "
                    "the camera's trigger and the rate, then resume the run"
                )
        self._trust_marker(is_final=True)
        self._pipeline.flush()
        self._exposures.verify()
        return True

    def _trust_marker(self, is_final: bool) -> None:
        """End the run in doubt where the marker calls exposure B an A."""
        if said := self._sense.doubt(is_final):
            self._exposures.doubt(said)

    def _chunk(
        self, order: PulseOrder, laser: Laser, chunk: Chunk, wanted: int, sign: BrightnessSign
    ) -> Generator[Pair, None, None]:
        """Fire, and yield the pairs that are sure and had light, as many as are wanted."""
        exposures = self._exposures
        exposures.begin()
        before_ns, clock_ns = time.monotonic_ns(), exposures.clock_ns()
        exposures.make_ready()
        arm = Shot(clock_ns, before_ns, time.monotonic_ns())
        try:
            watch = self._light.fire(laser, chunk.fired, lambda: exposures.is_armed)
            with watch:
                chunk.triggers = laser.camera_triggers
                self._tell("firing")
                sure = self._sure_pairs(order, laser, chunk, arm)
                with closing(sure), closing(self._lit_pairs(order, chunk, sure)) as pairs:
                    for pair in pairs:
                        if chunk.kept == wanted:
                            chunk.surplus += 1
                            self._drop(chunk, SURPLUS, *pair)
                            continue
                        if sign.is_flipped(*(mean_counts(frame.pixels) for frame in pair)):
                            self._drop(chunk, LEFT, *pair)
                            exposures.doubt("exposures A and B have changed places: the other one is brighter now")
                        yield self._handed_over(chunk, pair)
                watch.wait()
        finally:
            exposures.end()

    def _handed_over(self, chunk: Chunk, pair: Pair) -> Pair:
        """Count a pair as kept; SettingsChanged or OtherFormat if its frames are not what was set."""
        first, second = pair
        try:
            first = self._exposures.hand_over(first)
        except BaseException:
            self._drop(chunk, LEFT, second)
            raise
        second = self._exposures.hand_over(second)
        chunk.kept += 1
        return first, second

    def _sure_pairs(self, order: PulseOrder, laser: Laser, chunk: Chunk, arm: Shot) -> Generator[Pair, None, None]:
        """Pairs as the finder lets them go, until the burst has ended and no frame comes any more."""
        light, exposures = self._light.exposures, self._exposures
        assert light is not None
        gap_us = light.exposure_a_us + light.gap_us
        finder: PairFinder[Frame] = PairFinder(
            self._section, order.rate_hz, gap_us, lambda frame: exposures.reject(frame, True)
        )
        patience_s = exposures.section.timeout_s + 1.0 / order.rate_hz
        heard_s, is_first, seen = time.monotonic(), True, 0
        try:
            while True:
                try:
                    frame = exposures.look(SLICE_S)
                except OtherFormat:
                    raise
                except BadFrame:  # counted by the camera; its partner finds no pair
                    seen, heard_s = seen + 1, time.monotonic()
                    continue
                if frame is None:
                    is_over = laser.state not in EMITS
                    if is_over and (seen >= 2 * chunk.triggers or time.monotonic() - heard_s > patience_s):
                        break
                    heard_s = heard_s if seen or is_over else time.monotonic()  # the first light may be far
                    if not is_over and time.monotonic() - heard_s > patience_s:
                        raise CameraTimeout(f"no frame within {patience_s:.1f} s; look at the camera's trigger")
                    continue
                heard_s = time.monotonic()
                if is_first and not exposures.match.is_of_arm(frame.meta, arm):
                    exposures.reject(frame, True)  # no trigger of this chunk made it
                    continue
                is_first, seen = False, seen + 1
                if pair := finder.add(frame.meta, frame):
                    yield pair
            self._sense.chunk_ended(finder.last)
            if pair := finder.end():
                yield pair
        finally:
            if pair := finder.end():  # something came between
                self._drop(chunk, LEFT, *pair)
            chunk.dropped.update(finder.rejected)

    def _lit_pairs(
        self, order: PulseOrder, chunk: Chunk, pairs: Generator[Pair, None, None]
    ) -> Generator[Pair, None, None]:
        """Leave out what came before the first light and behind the last; see `brightness`."""
        extra = chunk.triggers - chunk.fired
        if extra <= 0:
            yield from pairs
            return
        held: list[Pair] = []
        is_begin, period_ns = True, 1e9 / order.rate_hz
        try:
            for pair in pairs:
                held.append(pair)
                since_ns = pair[0].meta.timestamp_ns - held[0][0].meta.timestamp_ns
                if is_begin and since_ns < (extra - 0.5) * period_ns:
                    continue
                yield from self._with_light(chunk, held, is_begin)
                is_begin = False
            yield from self._with_light(chunk, held, is_begin)
        finally:
            for pair in held:
                self._drop(chunk, LEFT, *pair)

    def _with_light(self, chunk: Chunk, held: list[Pair], is_begin: bool) -> Generator[Pair, None, None]:
        """Take pairs out of `held`; yield those of which both exposures had light."""
        counts = [(mean_counts(first.pixels), mean_counts(second.pixels)) for first, second in held]
        both = [
            watch.are_lit(one) if is_begin else [watch.is_lit(each) for each in one]
            for watch, one in zip(self._watches, zip(*counts, strict=True), strict=False)
        ]
        for lit in list(zip(*both, strict=True)):
            pair = held.pop(0)
            if all(lit) and chunk.kept + chunk.surplus < chunk.fired:
                yield pair
            else:
                self._drop(chunk, HALF if any(lit) and not all(lit) else DARK, *pair)

    def _keep(
        self, step: Step, record: Mapping[str, Any], place: int, number: int, first: Frame, second: Frame
    ) -> None:
        """Give a pair to the lanes."""
        order = step.pulses
        assert order is not None
        about: dict[str, Any] = {"chunk": number, "dt_us": order.dt_us, "marker": self._section.told_by}
        if order.dt_measured_us is not None:
            about["dt_measured_us"] = order.dt_measured_us
        if order.dt_measured_us is not None and order.dt_sigma_us is not None:
            about["dt_sigma_us"] = order.dt_sigma_us
        if order.is_background:
            about["background"] = True
        for half, (letter, frame) in enumerate(zip("AB", (first, second), strict=True)):
            placed = frame.with_positions_mm(record["measured_mm"])
            facts = {**record, "pair": {"exposure": letter, **about}}
            if letter == "B" and self._section.second_exposure_us is not None:  # the camera tells that of A alone
                facts["exposure_us"] = self._section.second_exposure_us
            self._pipeline.submit(Job(step, step.first_frame + place + half, placed, facts))
            self._progress.frames += 1
        self._progress.waiting = self._pipeline.waiting
        self._tell("exposing")

    def _drop(self, chunk: Chunk, why: str, *frames: Frame) -> None:
        chunk.dropped[why] += len(frames)
        for frame in frames:
            self._exposures.reject(frame, True)

    def _close(self, step: Step, chunk: Chunk, number: int, utc: str) -> None:
        """Books of a chunk, once its pairs are on the disk."""
        self._pipeline.flush()
        self._journal.append(
            "chunk",
            sync=True,
            step=step.index,
            tag=step.tag,
            utc=utc,
            chunk=number,
            fired=chunk.fired,
            triggers=chunk.triggers,
            pairs=chunk.kept,
            surplus=chunk.surplus,
            lost=chunk.lost,
            dropped=dict(sorted(chunk.dropped.items())),
            never_came=chunk.never_came,
        )

    def _require_same_exposure(self) -> None:
        """Refuse to go on, before anything is fired, if the camera exposes otherwise than so far."""
        now_us = exposure_of(self._exposures.settings)
        for number, entry in frame_entries(self._folder.entries()).items():
            if "pair" not in entry or entry["pair"]["exposure"] == "B" or entry["exposure_us"] is None:
                continue
            if not math.isclose(entry["exposure_us"], now_us, rel_tol=1e-6):
                what = "background was" if entry["pair"].get("background") else "pairs were"
                raise ResumeRefused(
                    f"{self._folder.path}: its {what} exposed for {entry['exposure_us']:g} us "
                    f"(frame {number}) and the camera is at {now_us:g} us now; set it back, or begin a new run"
                )

    def _whole_pairs(self, step: Step) -> int:
        """First place that is to be filled: behind the last whole pair; a frame behind it without partner goes."""
        present = set(frame_entries(self._folder.entries()))
        place = 0
        while {step.first_frame + place, step.first_frame + place + 1} <= present and place < step.frames:
            place += 2
        loose = [number for number in step.numbers[place:] if number in present]
        if loose:
            self._journal.append("discard", sync=True, frames=loose, why="their pairs are not whole")
        for number in loose:
            self._folder.frame_path(number).unlink(missing_ok=True)
            self._folder.corrected_path(number).unlink(missing_ok=True)
        return place

    def _chunks_so_far(self, step: Step) -> int:
        entries = self._folder.entries()
        told = [entry["chunk"] for entry in entries if entry["kind"] == "chunk" and entry["step"] == step.index]
        told += [
            entry["pair"]["chunk"]
            for entry in entries
            if entry["kind"] == "frame" and entry["step"] == step.index and "pair" in entry
        ]
        return max(told, default=-1) + 1


def _utc() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
