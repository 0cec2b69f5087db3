"""The pairs of one camera in a chunk of light pulses: armed before the first pulse, sure when handed over.

Several cameras are asked in turn by one thread, so a source that has nothing yet says so (None) after a moment.
"""

from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field

from daq.bench.pairs_section import PairsSection
from daq.cameras.frame import Frame
from daq.errors import BadFrame, CameraTimeout, OtherFormat, RunUsageError
from daq.plans.pulse_order import PulseOrder
from daq.runner.camera_session import CameraSession
from daq.runner.clock_calibration import Shot
from daq.runner.pair_finder import BrightnessSign, MarkerPolarity, PairFinder, mean_counts
from daq.runner.step_readings import ask_clock
from daq.runs.frame_accounting import LEFT
from daq.timing.pulses import PairExposures
from ground.plain_words import quantity


@dataclass
class Chunk:
    """Counts of one chunk; frames are dropped by reason, pairs are kept."""

    fired: int
    kept: int = 0
    surplus: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    periods_ns: list[int] = field(default_factory=list)  # of the triggers, by the camera's clock

    @property
    def losses(self) -> int:
        """Pairs that were fired and are neither kept nor surplus."""
        return self.fired - self.kept - self.surplus

    @property
    def never_came(self) -> int:
        """Frames that were triggered and never seen whole; below 0 if the camera sent more than were asked for."""
        return 2 * (self.fired - self.kept) - sum(self.dropped.values())

    def sentence(self) -> str:
        """Describe what became of the pairs that were fired."""
        reasons = ", ".join(f"{quantity(number, 'frame')} {why}" for why, number in sorted(self.dropped.items()))
        never = f"{quantity(self.never_came, 'frame')} never came" if self.never_came > 0 else ""
        losses = "; ".join(filter(None, (reasons, never)))
        return f"{self.kept} of {self.fired} pairs that were fired are sure ({losses or 'nothing else came'})"


ENOUGH_PERIODS, MANY_PERIODS = 4, 24  # to tell a rate at the end of a chunk; and while one goes on
RATE_TOLERANCE = 0.02  # share by which triggers may come at another rate than the plan says


def require_rate_seen(periods_ns: Sequence[int], rate_hz: float) -> None:
    """Refuse a synchroniser that runs at another rate than the plan says, by the camera's clock.

    Frames that are lost without a gap in their ids make periods longer, never shorter: the lower quartile counts.

    Raises
    ------
    RunUsageError
        With the rate at which frames came.
    """
    if len(periods_ns) < ENOUGH_PERIODS:
        return
    seen_hz = 1e9 / max(sorted(periods_ns)[len(periods_ns) // 4], 1)
    if abs(seen_hz / rate_hz - 1.0) > RATE_TOLERANCE:
        raise RunUsageError(
            f"the synchroniser triggers {seen_hz:.4g} pairs/s by the camera's clock, and the plan says rate_hz: "
            f"{rate_hz:g}; make them the same, and begin a new run"
        )


SLICE_S = 0.05
PAIRLESS = "are in no pair"  # the line of the chunk says why
ROUNDED_NS = 2_000_000  # by which a stamp on the computer's clock may be off, and a little more
Pair = tuple[Frame, Frame]


class PairSource:
    """Pairs of one camera.

    Parameters
    ----------
    name : str
        Device of the bench.
    exposures : CameraSession
        The camera, set up.
    section : PairsSection
        How its pairs come.
    """

    def __init__(self, name: str, exposures: CameraSession, section: PairsSection) -> None:
        self.name = name
        self.exposures = exposures
        self.section = section
        self._sense = MarkerPolarity(section)
        self._sign = BrightnessSign()
        self._arm = Shot(None, 0, 0)
        self._clock: tuple[int, int] | None = None  # the computer's, the camera's

    def begin_step(self) -> None:
        """Forget what was learnt of the light of another step."""
        self._sense = MarkerPolarity(self.section)
        self._sign = BrightnessSign()

    def arm(self) -> None:
        """Make the camera wait for triggers, with nothing of before in its queue."""
        self.exposures.begin()
        self._arm = self.exposures.arm()

    def tell_clock(self) -> None:
        """Learn how the camera's clock stands to the computer's.

        Raises
        ------
        RunUsageError
            It cannot be read, so its frames cannot be assigned to those of another camera.
        """
        found = ask_clock(self.exposures.camera)
        if found is None:
            raise RunUsageError(
                f"the clock of {self.name} cannot be read, so its pairs cannot be assigned to those of another "
                "camera; remove it from the plan's cameras, or remove the other one"
            )
        self._clock = (found[0] + found[2]) // 2, found[1]

    def host_ns(self, pair: Pair) -> int:
        """Start of exposure A of a pair on the computer's clock; FrameDoubt if it is impossible."""
        assert self._clock is not None
        meta = pair[0].meta
        at_ns = self._clock[0] + meta.timestamp_ns - self._clock[1]
        if not self._arm.before_ns - ROUNDED_NS <= at_ns <= meta.received_ns + ROUNDED_NS:
            self.exposures.raise_ambiguity(
                f"the time stamps of {self.name} are not those of the clock that it lets us read"
            )
        return at_ns

    def pairs(
        self, order: PulseOrder, is_firing: Callable[[], bool], light: PairExposures, chunk: Chunk
    ) -> Generator[Pair | None, None, None]:
        """Pairs that are sure, None now and then, until the burst has ended and no frame comes."""
        exposures = self.exposures
        finder: PairFinder[Frame] = PairFinder(
            self.section,
            order.rate_hz,
            light.exposure_a_us + light.gap_us,
            lambda f: exposures.reject(f, True, PAIRLESS),
        )
        timeout_s = exposures.section.timeout_s + 1.0 / order.rate_hz
        heard_s, is_first, seen = exposures.now_s(), True, 0
        try:
            while True:
                try:
                    frame = exposures.look(SLICE_S)
                except OtherFormat:
                    raise
                except BadFrame:  # counted by the camera; its partner finds no pair
                    seen, heard_s = seen + 1, exposures.now_s()
                    continue
                if frame is None:
                    is_over = not is_firing()
                    if is_over and (seen >= 2 * chunk.fired or exposures.now_s() - heard_s > timeout_s):
                        break
                    heard_s = heard_s if seen or is_over else exposures.now_s()  # the first light may be far
                    if not is_over and exposures.now_s() - heard_s > timeout_s:
                        raise CameraTimeout(f"no frame within {timeout_s:.1f} s; look at the camera's trigger")
                    yield None
                    continue
                heard_s = exposures.now_s()
                if is_first and not exposures.match.is_of_arm(frame.meta, self._arm):
                    exposures.reject(frame, True, PAIRLESS)  # no trigger of this chunk made it
                    continue
                is_first, seen = False, seen + 1
                found = finder.add(frame.meta, frame)
                if order.laser is None and len(finder.periods_ns) % MANY_PERIODS == MANY_PERIODS - 1:
                    require_rate_seen(finder.periods_ns, order.rate_hz)
                yield found
            self._sense.chunk_ended(finder.last)
            if pair := finder.end():
                yield pair
        finally:
            if pair := finder.end():  # something came between
                self.drop(chunk, LEFT, *pair)
            chunk.dropped.update(finder.rejected)
            chunk.periods_ns = finder.periods_ns

    def is_flipped(self, pair: Pair) -> bool:
        """Return whether the other exposure is the brighter one now."""
        return self._sign.is_flipped(*(mean_counts(frame.pixels) for frame in pair))

    def hand_over(self, chunk: Chunk, pair: Pair) -> Pair:
        """Count a pair as kept; SettingsChanged or OtherFormat if its frames are not what was set."""
        first, second = pair
        try:
            first = self.exposures.hand_over(first)
        except BaseException:
            self.drop(chunk, LEFT, second)
            raise
        second = self.exposures.hand_over(second)
        chunk.kept += 1
        return first, second

    def drop(self, chunk: Chunk, why: str, *frames: Frame) -> None:
        """Give frames back that are in no pair that is kept."""
        chunk.dropped[why] += len(frames)
        for frame in frames:
            self.exposures.reject(frame, True, PAIRLESS)

    def trust_marker(self, is_final: bool) -> None:
        """End the run where the marker calls exposure B an A."""
        if said := self._sense.objection(is_final):
            self.exposures.raise_ambiguity(said)
