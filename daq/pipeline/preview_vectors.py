"""Vectors of the last pair while the run goes on: the number that says whether dt, seeding and focus are right.

Corrected frames of the live thread are looked at as they come. When both frames of a pair have come, they lie in a
tray for one pair, from which a thread of low priority takes them; a newer pair takes the place of one that still
lies there. So no thread waits for vectors: neither the raw thread nor the live one loses a frame to them, and what
is shown is recent. Windows are 64 px (`piv.correlation.live`). At most `MOST_PER_S` pairs a second are measured,
for `PREVIEW_DUTY` at most: on a small or busy computer frames to be corrected come first.
"""

import math
import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.errors import CorrectionError
from daq.pipeline.priority import lower_priority
from daq.pipeline.stats import LiveVectors, PipelineStats
from daq.plans.steps import Step
from piv.correlation.live import live_vectors
from piv.correlation.vector_field import STATIC_SHARE, VectorField
from piv.errors import PivError

MOST_PER_S = 4.0
PREVIEW_DUTY = 0.25
WARM_PX = 320
COMPILE_PATIENCE_S = 10.0
MOST_ARROWS = 400
Frame = NDArray[np.float32]


def warm_up() -> None:
    """Compile what measures a pair before the first frame comes: a compiler keeps all other threads waiting."""
    frame = np.random.default_rng(0).normal(size=(WARM_PX, WARM_PX)).astype(np.float32)
    frame[: WARM_PX // 4] = np.nan  # masked windows have code of their own
    _measure(_Pair(0, frame, frame, time.monotonic_ns()))


@dataclass(frozen=True)
class _Pair:
    number: int
    a: Frame
    b: Frame
    received_ns: int


class PreviewVectors:
    """Finds pairs among corrected frames and measures the last one.

    Parameters
    ----------
    flow : PipelineStats
        Gets the result as `vectors`.
    """

    def __init__(self, flow: PipelineStats) -> None:
        self._flow = flow
        self._first: tuple[int, Frame] | None = None
        self._tray: _Pair | None = None
        self._wake = threading.Condition()
        self._ends = False
        self._thread = threading.Thread(target=self._work, name="vectors thread", daemon=True)
        self._thread.start()

    def see(self, step: Step, number: int, corrected: Frame, received_ns: int) -> None:
        """Look at a corrected frame (H, W), NaN where nothing is recovered; it must not be written to any more."""
        if step.group != 2 or (step.pulses is not None and step.pulses.is_background):
            return  # a background is taken without particles
        if (number - step.first_frame) % 2 == 0:
            self._first = number, corrected
            return
        first, self._first = self._first, None
        if first is None or first[0] != number - 1:
            return  # its partner was skipped
        with self._wake:
            self._tray = _Pair(first[0], first[1], corrected, received_ns)
            self._wake.notify()

    def close(self) -> None:
        """End; a pair that is being measured is waited for, one in the tray is not."""
        with self._wake:
            self._ends, self._tray = True, None
            self._wake.notify()
        self._thread.join(COMPILE_PATIENCE_S)

    def _work(self) -> None:
        lower_priority(2)
        while True:
            with self._wake:
                while self._tray is None and not self._ends:
                    self._wake.wait()
                if self._ends:
                    return
                pair, self._tray = self._tray, None
            assert pair is not None
            begun_s = time.monotonic()
            self._flow.vectors = _measure(pair)
            self._flow.vectors_live += 1
            del pair
            took_s = time.monotonic() - begun_s  # longer than it needed, where others need the processor
            with self._wake:
                left_s = max(1.0 / MOST_PER_S, took_s / PREVIEW_DUTY) - took_s
                self._wake.wait_for(lambda: self._ends, max(left_s, 0.0))


def _some(field: VectorField, good: NDArray[np.bool_]) -> tuple[tuple[float, float, float, float], ...]:
    """Every n-th good vector of every n-th row, so that there are not more than can be looked at."""
    every = max(1, math.ceil(math.sqrt(good.sum() / MOST_ARROWS)))
    chosen = np.zeros_like(good)
    chosen[::every, ::every] = good[::every, ::every]
    x, y = np.broadcast_arrays(field.x_px[None, :], field.y_px[:, None])
    columns = (values[chosen].round(1).tolist() for values in (x, y, field.u_px, field.v_px))
    return tuple(zip(*columns, strict=True))


def _measure(pair: _Pair) -> LiveVectors:
    """Measure a pair; what cannot be measured says why: frames of a lab can be anything."""
    facts: dict[str, Any] = {}
    try:
        valid = np.isfinite(pair.a) & np.isfinite(pair.b)
        field = live_vectors(pair.a, pair.b, valid, threads=1)
        asked = int(field.asked.sum())
        good = field.valid
        if good.any():
            u, v = field.u_px[good], field.v_px[good]
            facts["median_px"] = (float(np.median(u)), float(-np.median(v)))
            facts["largest_px"] = float(np.percentile(np.hypot(u, v), 98))
            facts["arrows"] = _some(field, good)
        facts["valid_share"] = float(good.sum() / max(asked, 1))
        if field.static_share > STATIC_SHARE:
            facts["remark"] = f"{100 * field.static_share:.0f} % of the light stands still"
    except (CorrectionError, PivError) as error:
        facts["remark"] = str(error)
    return LiveVectors(number=pair.number, age_ms=(time.monotonic_ns() - pair.received_ns) / 1e6, **facts)
