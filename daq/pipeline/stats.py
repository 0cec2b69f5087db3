"""Statistics of the threads of a run: counts, rates, latencies."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class LiveVectors:
    """Vectors of one pair from windows of 64 px, while the run goes on.

    Parameters
    ----------
    number : int
        Number of its first frame.
    age_ms : float
        Time from the second frame's arrival to its vectors.
    median_px : (float, float)
        Median displacement, to the right and UP [px of the corrected image]; NaN without vectors.
    largest_px : float
        What 98 % of the displacements stay below.
    valid_share : float
        Measured vectors of those outside the mask, 0 to 1.
    remark : str
        What speaks against them, or why there are none.
    arrows : tuple of (x, y, u, v)
        Some of them, spread evenly [px of the corrected image, v down].
    """

    number: int
    age_ms: float
    median_px: tuple[float, float] = (float("nan"), float("nan"))
    largest_px: float = float("nan")
    valid_share: float = 0.0
    remark: str = ""
    arrows: tuple[tuple[float, float, float, float], ...] = ()

    def sentence(self) -> str:
        """The same for a person."""
        if not np.isfinite(self.largest_px):
            return f"none: {self.remark or 'no window has a peak'}"
        right, up = self.median_px
        words = f"median {right:+.2f}, {up:+.2f} px, up to {self.largest_px:.1f} px"
        words += f", {100 * self.valid_share:.0f} % of the windows measured"
        return f"{words}; {self.remark}" if self.remark else words


@dataclass
class PipelineStats:
    """Work done so far by the threads, which alone write it."""

    submitted: int = 0
    written: int = 0
    written_bytes: int = 0
    write_s: float = 0.0
    corrected: int = 0
    correct_s: float = 0.0
    skipped: list[int] = field(default_factory=list)
    latency_ms: list[float] = field(default_factory=list)
    raw_latency_ms: list[float] = field(default_factory=list)
    raw_waiting_most: int = 0
    submit_wait_s: float = 0.0
    vectors: LiveVectors | None = None
    vectors_live: int = 0

    def summary(self) -> dict[str, Any]:
        """Figures for done.json."""
        return {
            "written": self.written,
            "written_MB": round(self.written_bytes / 1e6, 1),
            "write_ms_mean": _mean_ms(self.write_s, self.written),
            "write_MB_s_per_writer": round(self.written_bytes / 1e6 / self.write_s, 1) if self.write_s else None,
            "raw_latency_ms": _percentiles(self.raw_latency_ms),
            "raw_queue_most": self.raw_waiting_most,
            "submit_wait_s": round(self.submit_wait_s, 3),
            "corrected_live": self.corrected,
            "correct_ms_mean": _mean_ms(self.correct_s, self.corrected),
            "latency_ms": _percentiles(self.latency_ms),
            "skipped_live": len(self.skipped),
            "vectors_live": self.vectors_live,
        }


def _percentiles(values: list[float]) -> dict[str, float] | None:
    if not values:
        return None
    p50, p99 = np.percentile(values, (50.0, 99.0))
    return {"p50": round(float(p50), 2), "p99": round(float(p99), 2), "largest": round(max(values), 2)}


def _mean_ms(total_s: float, count: int) -> float | None:
    return round(1e3 * total_s / count, 2) if count else None
