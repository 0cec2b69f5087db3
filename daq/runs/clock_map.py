"""From the camera's clock to the computer's, by what the journal knows of both.

The camera was asked for its clock between steps (`camera` lines): its latch c lies between our b and a.  A line

    computer = offset + (1 + drift) c

is fitted to the middles with weights 1 / (a - b)^2.  The ways there and back need not take equally long, and are
the same every time, so no number of questions makes the offset surer: its sigma is that of one interval of the
weighted mean width, width / sqrt(12).  The drift is as unsure as if each middle were off by half its width.  A
clock that went back was started anew, in the middle of a run or by another session: each piece has its own map.

A camera whose clock is disciplined (PTP, IEEE 1588) is mapped in the same way; its drift is then our computer's.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from daq.runs.journal import Entry

Reading = tuple[int, int, int]  # ours before, the camera's, ours behind
APART_PPM = 1000.0  # no two clocks that work drift apart faster


@dataclass(frozen=True)
class ClockMap:
    """A stretch of a run within which the camera's clock went on.

    Parameters
    ----------
    first_ns, last_ns : int
        Camera clock of the first and the last question.
    at_ns : int
        Camera clock at which the map is anchored.
    host_ns : int
        The computer's monotonic clock there.
    drift_ppm, drift_sigma_ppm : float
        By how much the computer's clock is faster; sigma is inf where only one question was asked.
    sigma_ns : float
        Standard deviation of the anchor.
    questions : int
        That the map is made from.
    """

    first_ns: int
    last_ns: int
    at_ns: int
    host_ns: int
    drift_ppm: float
    drift_sigma_ppm: float
    sigma_ns: float
    questions: int

    def on_host_ns(self, camera_ns: int) -> int:
        """The computer's monotonic clock at a moment of the camera's."""
        since_ns = camera_ns - self.at_ns
        return self.host_ns + since_ns + round(since_ns * self.drift_ppm * 1e-6)

    @property
    def sentence(self) -> str:
        """Description for a person."""
        if self.questions < 2:
            return f"known to {self.sigma_ns / 1e3:.0f} us, drift unknown"
        return (
            f"{self.drift_ppm:+.1f} ppm (sigma {self.drift_sigma_ppm:.1g}) slower than the computer's, "
            f"known to {self.sigma_ns / 1e3:.0f} us"
        )


def clock_maps(entries: Iterable[Entry]) -> list[ClockMap]:
    """Maps of a run, one for each stretch; empty if the camera has no clock that can be read.

    Parameters
    ----------
    entries : iterable of Entry
        The journal.
    """
    stretches: list[list[Reading]] = []
    last: Reading | None = None
    for entry in entries:
        if entry["kind"] == "session":
            last = None
        if entry["kind"] != "camera" or "camera_ns" not in entry:
            continue
        before_ns, after_ns = entry["monotonic_ns"]
        reading = (before_ns, entry["camera_ns"], after_ns)
        if last is None or not _goes_on(last, reading):
            stretches.append([])
        stretches[-1].append(reading)
        last = reading
    return [_fit_map(stretch) for stretch in stretches]


def _goes_on(last: Reading, reading: Reading) -> bool:
    """True if as much time went by on both clocks, as far as the answers and two bad crystals leave it open."""
    ours_ns, its_ns = (reading[0] + reading[2] - last[0] - last[2]) / 2, reading[1] - last[1]
    open_ns = (reading[2] - reading[0] + last[2] - last[0]) / 2 + APART_PPM * 1e-6 * abs(ours_ns)
    return abs(ours_ns - its_ns) <= open_ns


def _fit_map(stretch: list[Reading]) -> ClockMap:
    before, camera, after = (np.array(column, dtype=object) for column in zip(*stretch, strict=True))
    widths = np.maximum((after - before).astype(float), 1.0)
    middles = (before + after) // 2
    at_ns, from_ns = int(camera[0]), int(middles[0])
    x, y = (camera - at_ns).astype(float), (middles - from_ns - (camera - at_ns)).astype(float)
    weights = widths**-2
    centre = float(np.sum(weights * x) / np.sum(weights))
    spread = float(np.sum(weights * (x - centre) ** 2))
    drift = float(np.sum(weights * (x - centre) * y) / spread) if spread > 0.0 else 0.0
    offset = float(np.sum(weights * y) / np.sum(weights))
    sigma_ns = float(np.sum(weights * widths) / np.sum(weights)) / math.sqrt(12.0)
    drift_sigma = 0.5 / math.sqrt(spread) if spread > 0.0 else math.inf
    anchor_ns = at_ns + round(centre)
    return ClockMap(
        at_ns, int(camera[-1]), anchor_ns, from_ns + round(centre) + round(offset), 1e6 * drift,
        1e6 * drift_sigma, sigma_ns, len(stretch),
    )  # fmt: skip
