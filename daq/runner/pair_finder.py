"""Frames in the order of their arrival to pairs that are sure; a pair that is not sure is none, and is counted.

The camera shows A, B, A, B ... at a known rate, and anything may happen on the way: first frames are skipped,
later ones too, with or without an id; frames come twice, too late or not at all; a trigger bounces and exposes
once more.  Two frames are a pair only if everything that is known says so:

* the marker calls the first one A and the second one B, and no frame came between them, by their ids;
* they are as far apart as the camera is set to take A and B, and nearer than two exposures of different pulses can
  be: B of the next pulse comes a whole period later;
* no other frame was exposed within their period, so the frame behind them is waited for.

What is ambiguous is dropped with all that it touches.  A frame is identified by its own marker and time, so
nothing has to be learnt by counting, and no fault can swap the pairs behind it.  What no stream of frames can show
is a marker that is wired to exposure B of evenly spaced frames.

**A marker that is wired wrongly** (`MarkerPolarity`).  Frames that come evenly spaced look the same whichever way
they are paired.  A marker that is high during exposure B, because it is connected to the second trigger or its
input is inverted, makes pairs of B and the NEXT A: light 2 of one pulse and light 1 of the next, a period less dt
apart, and brightness and spacing say nothing against it.

What gives it away is that a chunk ends: the timing unit triggers A, B, A, B ... A, B and no more, so the last
frame of all is a B.  A marker that calls it an A is wired wrongly, or the very last frame was lost.  Frames are
lost one by one and chunks are many, so a majority decides; where there is none in the end, the order is unknown,
and the run ends with an error.  First frames say less: cameras skip them.

**A marker that is inverted during a run** (`BrightnessSign`).  A and B differ a little in their mean brightness,
by the other cavity or a longer exposure.  The sign of that difference is decided over `BLOCK` pairs and must never
change.
"""

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.bench.pairs_section import SPACING_RATIO, PairsSection
from daq.cameras.frame import FrameMeta

T = TypeVar("T")
Exposure = Literal["A", "B"]
OTHER_PULSE = 0.9  # of a period: what is farther apart than that shows another pulse
STRADDLING = 0.6  # evenly spaced frames are half a period apart
# by which the gap of a pair may differ from the settings, and a share of it
GAP_OFF_NS, GAP_OFF = 100_000, 0.01
# Chunks that end with an A, more than those that end with a B, before a run is ended because of it
ENOUGH = 3
BLOCK = 20  # pairs
SIGN_STANDARD_ERRORS = 8.0  # standard errors from which on a difference has a sign
EVERY = 8  # row and column of a frame that its mean is taken of
QUIET_COUNTS = 0.03  # by which means of dark frames differ

LATE, DOUBLED, UNMARKED = "came late", "came twice", "not marked"
ALONE, UNSURE, NO_CLOCK = "without its partner", "in doubt", "without a time stamp"


@dataclass(slots=True)
class _Held(Generic[T]):
    meta: FrameMeta
    item: T
    is_ambiguous: bool = False


class PairFinder(Generic[T]):
    """Finds the pairs among the frames of one arm.

    Parameters
    ----------
    section : PairsSection
        How pairs come and are marked.
    rate_hz : float
        Pairs a second.
    gap_us : float
        From the start of exposure A to the start of exposure B.
    reject : callable
        Gets every item that is in no pair, once.
    """

    def __init__(self, section: PairsSection, rate_hz: float, gap_us: float, reject: Callable[[T], None]) -> None:
        self._section = section
        self._period_ns, self._gap_ns = 1e9 / rate_hz, 1e3 * gap_us
        self._longest_ns = longest_gap(section) * self._period_ns
        self._off_ns = GAP_OFF_NS + GAP_OFF * self._gap_ns
        self._reject_item = reject
        self._first: _Held[T] | None = None  # an A that waits for its B
        self._pair: tuple[_Held[T], _Held[T]] | None = None  # waits for the frame behind it
        self._last: FrameMeta | None = None
        self._before: deque[FrameMeta] = deque(maxlen=2)
        self.rejected: Counter[str] = Counter()  # frames, by reason
        # of triggers, over two frames that follow each other, whatever they show
        self.periods_ns: list[int] = []
        self.pairs = 0

    def add(self, meta: FrameMeta, item: T) -> tuple[T, T] | None:
        """Take the next frame; return the pair before it if that is sure now."""
        held, last = _Held(meta, item), self._last
        # Without a time stamp nothing else can be asked; ids tell late frames and copies, which change no state.
        if self._section.effective_marker != "halves" and meta.timestamp_ns == 0:
            self._reject(held, NO_CLOCK)
            return None
        if last is not None and meta.sequence <= last.sequence:
            self._reject(held, DOUBLED if meta.timestamp_ns == last.timestamp_ns else LATE)
            return None
        if last is not None and self._is_copy(meta, last):  # the same exposure with an id of its own
            self._reject(held, DOUBLED)
            self._last = meta
            return None
        # Only a frame that is new counts for the period, and is asked for its marker.
        self._measure_period(meta)
        exposure, self._last = self._exposure(meta), meta
        if last is not None and meta.timestamp_ns < last.timestamp_ns:
            exposure = None
        if exposure == "A":
            return self._begin(held)
        if exposure == "B":
            return self._complete(held, last)
        self._distrust(meta)
        self._reject(held, UNMARKED)
        return None

    def end(self) -> tuple[T, T] | None:
        """No frame comes any more; return the pair that waits, if there is one."""
        if self._first is not None:
            self._reject(self._first, ALONE)
            self._first = None
        return self._release()

    @property
    def last(self) -> Exposure | None:
        """Exposure of the last frame by its marker; None if the marker does not say, or is `spacing`."""
        return (
            None
            if self._last is None or self._section.effective_marker == "spacing"
            else self._exposure(self._last)
        )

    def _measure_period(self, meta: FrameMeta) -> None:
        """Note the time from the frame before the last one: of two frames a pulse one period, if none is lost."""
        first = self._before[0] if len(self._before) == 2 else meta
        if first.sequence + 2 == meta.sequence and first.timestamp_ns:
            self.periods_ns.append(meta.timestamp_ns - first.timestamp_ns)
        self._before.append(meta)

    def _exposure(self, meta: FrameMeta) -> Exposure | None:
        """Exposure by the marker; of `spacing`, B is a frame that comes soon after another."""
        section = self._section
        if section.effective_marker == "halves":
            return "B" if meta.sequence % 2 else "A"
        if section.effective_marker == "spacing":
            last = self._last
            return "B" if last and meta.timestamp_ns - last.timestamp_ns <= self._longest_ns else "A"
        value = meta.chunks.get(section.chunks[0])
        if value is None:
            return None
        if section.effective_marker == "line_status":
            return "A" if int(value) >> (section.line or 0) & 1 else "B"
        return {section.first: "A", section.first + 1: "B"}.get(int(value))  # type: ignore[return-value]

    def _begin(self, held: _Held[T]) -> tuple[T, T] | None:
        if self._is_of_last_pulse(held.meta):
            self._distrust(held.meta)
            held.is_ambiguous = True
        if self._first is not None:
            # by its spacing alone a B without its A looks like another A
            is_spaced = self._section.effective_marker == "spacing"
            held.is_ambiguous |= not is_spaced and self._is_near(self._first.meta, held.meta)
            self._reject(self._first, UNSURE if self._first.is_ambiguous else ALONE)
        self._first = held
        return self._release()

    def _complete(self, held: _Held[T], last: FrameMeta | None) -> tuple[T, T] | None:
        if self._is_of_last_pulse(held.meta):
            self._distrust(held.meta)
            self._reject(held, UNSURE)
            return None
        found, first = self._release(), self._first
        self._first = None
        if first is None:
            self._reject(held, ALONE)
            return found
        follows = last is not None and last.sequence + 1 == held.meta.sequence
        if first.is_ambiguous or not follows or not self._is_the_gap(first.meta, held.meta):
            for each in (first, held):
                self._reject(each, UNSURE)
            return found
        self._pair = (first, held)
        return found

    def _is_copy(self, meta: FrameMeta, last: FrameMeta) -> bool:
        """Return whether a frame is the one before once more; the halves of a buffer have one stamp."""
        is_second_half = (
            self._section.effective_marker == "halves" and meta.sequence == last.sequence + 1 and meta.sequence % 2
        )
        return meta.timestamp_ns == last.timestamp_ns != 0 and not is_second_half

    def _is_the_gap(self, first: FrameMeta, second: FrameMeta) -> bool:
        if self._section.effective_marker == "halves":
            return True
        gap_ns = second.timestamp_ns - first.timestamp_ns
        return gap_ns <= self._longest_ns and abs(gap_ns - self._gap_ns) <= self._off_ns

    def _is_near(self, one: FrameMeta, other: FrameMeta) -> bool:
        """Return whether two exposures are nearer than two A of different pulses can be."""
        if other.timestamp_ns == 0:  # halves of a buffer are a pair without any clock
            return False
        return abs(other.timestamp_ns - one.timestamp_ns) < OTHER_PULSE * self._period_ns

    def _is_of_last_pulse(self, meta: FrameMeta) -> bool:
        return self._pair is not None and self._is_near(self._pair[0].meta, meta)

    def _distrust(self, meta: FrameMeta) -> None:
        """Drop the pair that waits if `meta` was exposed within its period; distrust the A that waits."""
        if self._is_of_last_pulse(meta) and self._pair is not None:
            for each in self._pair:
                self._reject(each, UNSURE)
            self._pair = None
        if self._first is not None and self._is_near(self._first.meta, meta):
            self._first.is_ambiguous = True

    def _release(self) -> tuple[T, T] | None:
        pair, self._pair = self._pair, None
        if pair is None:
            return None
        self.pairs += 1
        return pair[0].item, pair[1].item

    def _reject(self, held: _Held[T], why: str) -> None:
        self.rejected[why] += 1
        self._reject_item(held.item)


def longest_gap(section: PairsSection) -> float:
    """Longest time from A to B, as a share of the period.

    A to B shorter than B to A by the factor `SPACING_RATIO` is at most 1 / (1 + SPACING_RATIO) of the period.
    Where another marker tells them apart the frames may be evenly spaced; two of different pulses are 3/2 of a
    period apart.
    """
    return (
        STRADDLING
        if section.shape == "straddling" and section.effective_marker != "spacing"
        else 1 / (1 + SPACING_RATIO)
    )


class MarkerPolarity:
    """Counts how the chunks of a step ended.

    Parameters
    ----------
    section : PairsSection
        How pairs come and are marked.
    """

    def __init__(self, section: PairsSection) -> None:
        self.matters = section.shape == "straddling" and section.effective_marker in ("line_status", "counter")
        self._first = self._second = 0  # chunks that ended with an A, with a B

    def chunk_ended(self, last: Exposure | None) -> None:
        """Take what the marker says of the last frame of a chunk that has come to its end; None if nothing."""
        self._first += last == "A"
        self._second += last == "B"

    def objection(self, is_final: bool) -> str | None:
        """Say why the marker cannot be trusted, as a sentence; None if it can, or can still.

        Parameters
        ----------
        is_final : bool
            Whether no chunk comes any more.
        """
        if not self.matters or self._first == 0:
            return None
        wrong = self._first >= self._second if is_final else self._first >= self._second + ENOUGH
        if not wrong:
            return None
        return (
            f"{self._first} of {self._first + self._second} chunks ended with a frame that the marker calls A, "
            "and a chunk ends with exposure B: the marker is wired to B, its input is inverted, or the camera "
            "keeps the last frame back"
        )


def mean_counts(pixels: NDArray[np.uint16]) -> float:
    """Mean of a frame (H, W), of some of its pixels."""
    return float(pixels[::EVERY, ::EVERY].mean())


class BrightnessSign:
    """Watches which of A and B is brighter."""

    def __init__(self) -> None:
        self._differences: list[float] = []
        self.sign = 0  # 1: A is brighter; 0: not decided yet

    def is_flipped(self, first_counts: float, second_counts: float) -> bool:
        """Take a pair; True if A and B have changed places since the sign was decided."""
        self._differences.append(first_counts - second_counts)
        if len(self._differences) < BLOCK:
            return False
        differences, self._differences = np.array(self._differences), []
        mean, error = float(differences.mean()), float(differences.std(ddof=1)) / math.sqrt(BLOCK)
        if abs(mean) <= SIGN_STANDARD_ERRORS * max(error, QUIET_COUNTS / math.sqrt(BLOCK)):
            return False
        sign, before = (1 if mean > 0 else -1), self.sign
        self.sign = sign
        return before not in (0, sign)
