"""Settle what a camera's time stamps mean, where something about them is odd: a few triggers with unequal pauses.

None of their frames is kept.  Between any two triggers lies another time, so the differences of the stamps say
which frame belongs to which trigger, even if frames of earlier triggers come in between or one is lost: an offset
between the clocks that explains three triggers out of four is the only one that does.  If no offset does and every
trigger had one frame, the stamps may count in another unit: then their differences are those of the triggers times
one factor, of those that cameras have (`UNITS_NS`).

`JITTER_NS` is what may pass between a trigger and its exposure; pauses differ by much more than that.
A `Shot` is one trigger, and what clocks said around it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.cameras.frame import FrameMeta

COARSE_NS, FINE_NS = 1_000_000, 1_000  # by which stamps may be rounded: in whole milliseconds, or finer
DRIFT = 2e-4  # of a quartz against another, with room


@dataclass(frozen=True, slots=True)
class Shot:
    """A trigger: the camera's clock right before it, and the host's before and after the call [ns]."""

    clock_ns: int | None
    before_ns: int
    after_ns: int

    def could_have_made(self, stamp_ns: float, received_ns: int) -> bool:
        """Return whether a stamp lies between this trigger and the arrival of its frame, by the latched clock."""
        if self.clock_ns is None:
            return False
        newest_ns = self.clock_ns + (received_ns - self.before_ns) * (1 + DRIFT) + COARSE_NS
        return not self.is_after(stamp_ns) and stamp_ns <= newest_ns

    def is_after(self, stamp_ns: float) -> bool:
        """Return whether the latched clock says that a stamp is older than this trigger."""
        rounded_ns = FINE_NS if stamp_ns % COARSE_NS else COARSE_NS
        return self.clock_ns is not None and stamp_ns < self.clock_ns - rounded_ns


PAUSES_S = (0.0, 0.1, 0.25, 0.45)  # before each trigger
JITTER_NS = 30_000_000
UNITS_NS = (1e9 / 125e6, 10.0, 16.0, 20.0, 25.0, 40.0, 64.0, 100.0, 1e3, 1e4, 1e5, 1e6)
UNIT_TOLERANCE = 0.03
ENOUGH = 3  # triggers that one offset explains

Pairing = tuple[Shot, float, int]  # a trigger, the stamp of its frame [ns], when that was here


@dataclass(frozen=True)
class ClockCalibration:
    """Result of a trial.

    Parameters
    ----------
    pairs : tuple of (Shot, float, int)
        Triggers with stamp [ns] and arrival of their frames.
    ns_per_unit : float
        Nanoseconds in what the stamps count.
    """

    pairs: tuple[Pairing, ...]
    ns_per_unit: float = 1.0

    @property
    def low_ns(self) -> float:
        """Least that the host's clock can be ahead of the camera's."""
        return max(shot.before_ns - stamp_ns for shot, stamp_ns, _ in self.pairs)

    @property
    def high_ns(self) -> float:
        """Most that the host's clock can be ahead of the camera's."""
        return min(received_ns - stamp_ns for _, stamp_ns, received_ns in self.pairs)


def explain(shots: Sequence[Shot], metas: Sequence[FrameMeta]) -> ClockCalibration | None:
    """Find out which frames answered which triggers.

    Parameters
    ----------
    shots : sequence of Shot
        The triggers of the trial, in order.
    metas : sequence of FrameMeta
        Every frame that arrived meanwhile, in order of arrival.

    Returns
    -------
    ClockCalibration or None
        None if no offset, and no unit, explains them.
    """
    stamps = [float(meta.timestamp_ns) for meta in metas]
    best: tuple[Pairing, ...] = ()
    for shot in shots:
        for stamp_ns in stamps:
            pairs = _pairs_by_offset(shots, metas, stamps, shot.before_ns - stamp_ns)
            best = max(best, pairs, key=len)
    if len(best) >= ENOUGH:
        return ClockCalibration(best)
    return _in_another_unit(shots, metas) if len(metas) == len(shots) else None


def _pairs_by_offset(
    shots: Sequence[Shot], metas: Sequence[FrameMeta], stamps: Sequence[float], offset_ns: float
) -> tuple[Pairing, ...]:
    """Pairs that an offset makes: each frame exposed between its trigger and a little after."""
    pairs = []
    for shot in shots:
        for meta, stamp_ns in zip(metas, stamps, strict=True):
            exposed_ns = stamp_ns + offset_ns
            if abs(exposed_ns - shot.before_ns) < JITTER_NS + (shot.after_ns - shot.before_ns):
                pairs.append((shot, stamp_ns, meta.received_ns))
                break
    return tuple(pairs)


def _in_another_unit(shots: Sequence[Shot], metas: Sequence[FrameMeta]) -> ClockCalibration | None:
    host_ns = np.array([shot.before_ns for shot in shots], dtype=np.float64)
    units = np.array([meta.timestamp_ns for meta in metas], dtype=np.float64)
    host_ns, units = host_ns - host_ns[0], units - units[0]
    if not np.any(units):
        return None
    slope = float(host_ns @ units / (units @ units))
    ns_per_unit = min(UNITS_NS, key=lambda unit_ns: abs(slope / unit_ns - 1))
    calls_ns = max(shot.after_ns - shot.before_ns for shot in shots)
    is_line = float(np.abs(units * slope - host_ns).max()) < JITTER_NS + calls_ns
    if not is_line or abs(slope / ns_per_unit - 1) > UNIT_TOLERANCE:
        return None
    pairs = tuple(
        (shot, meta.timestamp_ns * ns_per_unit, meta.received_ns) for shot, meta in zip(shots, metas, strict=True)
    )
    return ClockCalibration(pairs, ns_per_unit)
