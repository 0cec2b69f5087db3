"""One trigger, and what clocks said around it."""

from dataclasses import dataclass

COARSE_NS, FINE_NS = 1_000_000, 1_000  # by which stamps may be rounded: in whole milliseconds, or finer
DRIFT = 2e-4  # of a quartz against another, with room


@dataclass(frozen=True, slots=True)
class Shot:
    """A trigger: the camera's clock right before it, and the host's before and after the call [ns]."""

    clock_ns: int | None
    before_ns: int
    after_ns: int

    def could_have_made(self, stamp_ns: float, received_ns: int) -> bool:
        """Whether a stamp lies between this trigger and the arrival of its frame, by the latched clock."""
        if self.clock_ns is None:
            return False
        newest_ns = self.clock_ns + (received_ns - self.before_ns) * (1 + DRIFT) + COARSE_NS
        return not self.is_after(stamp_ns) and stamp_ns <= newest_ns

    def is_after(self, stamp_ns: float) -> bool:
        """Whether the latched clock says that a stamp is older than this trigger."""
        rounded_ns = FINE_NS if stamp_ns % COARSE_NS else COARSE_NS
        return self.clock_ns is not None and stamp_ns < self.clock_ns - rounded_ns
