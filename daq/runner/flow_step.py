"""The pairs of a step that is lit by pulses, chunk by chunk, of one camera or of several at once.

    cameras armed and empty -> laser armed -> n pairs fired -> frames to pairs (pair_finder) -> account -> next

A pair is kept when it is sure, and gets the next two places of the step; what was lost is counted in the line of
its chunk and fired again, so a step has no gaps.  A flow goes on meanwhile: the time of each pair stands in its
record.  Several cameras keep
only what all of them have of one trigger (synchronise_pairs), so frames of one number show the same light.

    frames:  2 triggers = 2 pairs + dropped by reason + those that never came
    pairs:   fired = kept + lost + surplus

**Pairs of one trigger** (`synchronise_pairs`).  Every camera loses pairs of its own, and one lost pair would shift
all behind it, so pairs are never put together by counting.  All cameras hang on one trigger line; on the
computer's clock their exposures A of one trigger begin together, within what is known of their clocks (a
millisecond), and those of neighbouring triggers a whole period apart.  So two pairs are of one trigger if they are
nearer than a quarter of the period, and of different ones if they are farther than three quarters.  What lies
between cannot be, if the clocks are right: then nothing is kept.

A pair that another camera has not is dropped as soon as that camera has gone past it.
"""

from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import Any

from daq.errors import FramesLost
from daq.plans.pulse_order import PulseOrder
from daq.plans.steps import Step
from daq.runner.external_light import ExternalLight
from daq.runner.interrupts import Interrupts
from daq.runner.laser_session import LaserSession, require_rate
from daq.runner.pair_source import Chunk, Pair, PairSource, require_rate_seen
from daq.runner.pair_writer import PairWriter
from daq.runner.progress import Progress
from daq.runs.frame_accounting import ELSEWHERE, EXTERNAL, LEFT, SURPLUS
from daq.runs.journal import utc_now

SPARE = 2  # pairs fired beyond those that are still wanted: the first ones are lost most easily
MAX_EMPTY_BURSTS, MANY = 2, 10  # chunks in a row without a pair; one is enough if so many were fired
FREE_LOSSES = 2  # pairs that may be lost, however few were fired


@dataclass(frozen=True, eq=False)
class FlowStep:
    """Takes the pairs of one step after the other.

    Parameters
    ----------
    sides : sequence of PairWriter
        The cameras; light pulses are placed by the first.
    interrupts : Interrupts
        What was asked for meanwhile.
    progress : Progress
        Gets the number of frames of the first camera.
    tell : callable
        Called with what is being done, after every pair.
    light : LaserSession or ExternalLight
        The laser of the session, or an external one.
    """

    sides: Sequence[PairWriter]
    interrupts: Interrupts
    progress: Progress
    tell: Callable[[str], None]
    light: LaserSession | ExternalLight

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
            A and B have changed places, the marker calls B an A, or clocks do not say what belongs together.
        CameraError, TimingError, MotionStopped
            What came between; the laser is off, and the run can be resumed.
        """
        order = step.pulses
        assert order is not None
        place = min(side.whole_pairs(step) for side in self.sides)
        number = max(side.chunks_so_far(step) for side in self.sides)
        for side in self.sides:
            side.cut_to(step, place)
            side.require_same_exposure()
            side.source.begin_step()
        laser: Any = self.light.prepare(order, self.sides[0].source.exposures.settings, self.tell)
        for side in self.sides[1:]:
            exposures = side.source.exposures
            require_rate(exposures.settings, side.source.section.frames, order.rate_hz)
        # As many pairs more are fired as the worst chunk so far has lost.
        spare, empty_bursts, fired, lost = 0, 0, 0, 0
        while place < step.frames:
            if self.interrupts.is_end_wanted:
                return False
            wanted = (step.frames - place) // 2
            pairs = min(order.chunk, wanted + max(spare, SPARE), laser.most_pairs)
            chunks = [Chunk(pairs) for _ in self.sides]
            utc = utc_now()
            try:
                with closing(self._chunk(order, laser, chunks, min(wanted, pairs))) as found:
                    for each in found:
                        self._keep(step, record, place, number, each)
                        place += 2
            finally:
                for side, chunk in zip(self.sides, chunks, strict=True):
                    self.light.account(chunk)
                    side.close(step, chunk, number, utc, self.light.synchroniser)
            if self.light.synchroniser == EXTERNAL:
                if self.interrupts.is_end_wanted:
                    return place >= step.frames
                require_rate_seen(chunks[0].periods_ns, order.rate_hz)
            # The last frame of a chunk is a B: a marker that calls it an A is found here.
            for side in self.sides:
                side.source.trust_marker(is_final=False)
            number, chunk = number + 1, chunks[0]
            fired, lost, spare = fired + pairs, lost + chunk.losses, max(spare, chunk.losses)
            empty_bursts = 0 if chunk.kept else empty_bursts + 1
            too_many = lost > max(FREE_LOSSES, order.lost_at_most * fired)
            if empty_bursts == MAX_EMPTY_BURSTS or (empty_bursts and pairs >= MANY) or too_many:
                raise FramesLost(
                    f"{lost} of {fired} pairs are lost, in the last chunk {self._sentence(chunks)}; look at the "
                    "marker, the camera's trigger and the rate, then resume the run"
                )
        for side in self.sides:
            side.source.trust_marker(is_final=True)
            side.pipeline.flush()
            side.source.exposures.verify()
        return True

    def _sentence(self, chunks: Sequence[Chunk]) -> str:
        if len(chunks) == 1:
            return chunks[0].sentence()
        by_camera = zip(self.sides, chunks, strict=True)
        return "; ".join(f"of {side.source.name} {chunk.sentence()}" for side, chunk in by_camera)

    def _chunk(
        self,
        order: PulseOrder,
        laser: Any,  # noqa: ANN401 - what the light has prepared
        chunks: Sequence[Chunk],
        wanted: int,
    ) -> Generator[tuple[Pair, ...], None, None]:
        """Fire, and yield the pairs that are sure, one a camera, as many as are wanted."""
        light = self.light.exposures
        assert light is not None
        sources = [side.source for side in self.sides]
        try:
            # Cameras before the laser, which is armed only while all of them wait for triggers.
            for source in sources:
                source.arm()
                if len(sources) > 1:
                    source.tell_clock()
            fired = chunks[0].fired
            watch = self.light.fire(laser, fired, lambda: all(source.exposures.is_armed for source in sources))
            with watch, ExitStack() as streams:
                self.tell(self.light.doing)
                found = []
                for source, chunk in zip(sources, chunks, strict=True):
                    stream = source.pairs(order, lambda: self.light.is_firing, light, chunk)
                    found.append(streams.enter_context(closing(stream)))
                for pairs in streams.enter_context(
                    closing(synchronise_pairs(sources, found, chunks, order.rate_hz))
                ):
                    if chunks[0].kept == wanted:
                        if self.light.synchroniser == EXTERNAL:  # it goes on, whatever was wanted
                            self._drop(chunks, LEFT, pairs)
                            break
                        self._drop(chunks, SURPLUS, pairs)
                        continue
                    flipped = [source.is_flipped(pair) for source, pair in zip(sources, pairs, strict=True)]
                    if any(flipped):
                        self._drop(chunks, LEFT, pairs)
                        sources[flipped.index(True)].exposures.raise_ambiguity(
                            "exposures A and B have changed places: the other one is brighter now"
                        )
                    each = zip(sources, chunks, pairs, strict=True)
                    yield tuple(source.hand_over(chunk, pair) for source, chunk, pair in each)
                watch.wait()
        finally:
            for source in sources:
                source.exposures.end()

    def _drop(self, chunks: Sequence[Chunk], why: str, pairs: tuple[Pair, ...]) -> None:
        """Give a pair of every camera back."""
        for side, chunk, pair in zip(self.sides, chunks, pairs, strict=True):
            chunk.surplus += why == SURPLUS
            side.source.drop(chunk, why, *pair)

    def _keep(
        self, step: Step, record: Mapping[str, Any], place: int, number: int, pairs: tuple[Pair, ...]
    ) -> None:
        """Give the pairs of one trigger to the threads."""
        for side, pair in zip(self.sides, pairs, strict=True):
            side.keep(step, record, place, number, pair)
        self.progress.took(2, step.index)
        self.tell("exposing")


SAME, OTHER = 0.25, 0.75  # of the period

Stream = Generator[Pair | None, None, None]


def synchronise_pairs(
    sources: Sequence[PairSource], streams: Sequence[Stream], chunks: Sequence[Chunk], rate_hz: float
) -> Generator[tuple[Pair, ...], None, None]:
    """Yield pairs of one trigger, a pair a camera, in order.

    Parameters
    ----------
    sources, streams, chunks : sequence
        Of each camera: itself, what its `pairs` returned, and its counts.
    rate_hz : float
        Triggers a second.

    Raises
    ------
    FrameDoubt
        The cameras' clocks do not say which frames belong together.
    """
    if len(sources) == 1:
        for pair in streams[0]:
            if pair is not None:
                yield (pair,)
        return
    waiting: list[deque[tuple[int, Pair]]] = [deque() for _ in sources]
    is_over = [False] * len(sources)
    try:
        while not all(is_over):
            for number, (source, stream) in enumerate(zip(sources, streams, strict=True)):
                if is_over[number]:
                    continue
                try:
                    pair = next(stream)
                except StopIteration:
                    is_over[number] = True
                    continue
                if pair is not None:
                    waiting[number].append((0, pair))  # given back below, whatever its clock says
                    waiting[number][-1] = (source.host_ns(pair), pair)
            while all(waiting):
                if (found := _first_of_all(sources, waiting, chunks, 1e9 / rate_hz)) is not None:
                    yield found
    finally:
        for source, chunk, left in zip(sources, chunks, waiting, strict=True):
            why = ELSEWHERE if all(is_over) else LEFT
            for _, pair in left:
                source.drop(chunk, why, *pair)


def _first_of_all(
    sources: Sequence[PairSource],
    waiting: Sequence[deque[tuple[int, Pair]]],
    chunks: Sequence[Chunk],
    period_ns: float,
) -> tuple[Pair, ...] | None:
    """Take the earliest pairs: those of one trigger, or None and the ones that another camera has not are gone."""
    latest_ns = max(queue[0][0] for queue in waiting)
    apart = [(latest_ns - queue[0][0]) / period_ns for queue in waiting]
    unclear = [source.name for source, share in zip(sources, apart, strict=True) if SAME < share < OTHER]
    if unclear:
        beside_ms = 1e-6 * period_ns * max(apart)
        sources[0].exposures.raise_ambiguity(
            f"frames of {unclear[0]} lie {beside_ms:.1f} ms beside those of another camera, which "
            "is neither the same trigger nor another one: a clock is not what it says, or a trigger line is loose"
        )
    if max(apart) <= SAME:
        return tuple(queue.popleft()[1] for queue in waiting)
    for source, chunk, queue, share in zip(sources, chunks, waiting, apart, strict=True):
        if share >= OTHER:
            source.drop(chunk, ELSEWHERE, *queue.popleft()[1])
    return None
