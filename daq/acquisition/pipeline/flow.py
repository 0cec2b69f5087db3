"""What the lanes of a run have done: counts, rates, latencies."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass
class Flow:
    """What the lanes have done so far; read by anybody, written by the lanes."""

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
        }


def _percentiles(values: list[float]) -> dict[str, float] | None:
    if not values:
        return None
    p50, p99 = np.percentile(values, (50.0, 99.0))
    return {"p50": round(float(p50), 2), "p99": round(float(p99), 2), "largest": round(max(values), 2)}


def _mean_ms(total_s: float, count: int) -> float | None:
    return round(1e3 * total_s / count, 2) if count else None
