"""Light of an external synchroniser: its own program fires, and the camera takes pairs as they are triggered.

Nothing is armed, counted or switched off here. A chunk is a number of pairs: it begins with the first trigger,
whenever the person starts the other program, and ends when all of its pairs are there, though the synchroniser
goes on. What cannot be checked is in `daq.runs.frame_accounting.UNCHECKED`.
"""

from collections.abc import Callable, Mapping
from typing import Self

from daq.bench.bench_table import Bench
from daq.cameras.camera import Setting
from daq.plans.pulse_order import PulseOrder, check_marker, pair_exposures, pairs_section
from daq.runner.interrupts import Interrupts
from daq.runner.laser_session import exposure_of, require_rate
from daq.runner.pair_source import Chunk
from daq.runs.frame_accounting import EXTERNAL, LEFT
from daq.timing.pulses import ANY_RATE_HZ, LaserHead, PairExposures, schedule_of

WAITING = "waiting for the triggers of the synchroniser; start it in its own program"


class ExternalLight:
    """Light of a flow step from an external synchroniser; see `LaserSession` for a laser of the bench.

    Parameters
    ----------
    bench : Bench
        With the camera.
    interrupts : Interrupts
        A wish for the end also ends the wait for the first trigger.
    """

    most_pairs = 10**9
    synchroniser = EXTERNAL
    doing = WAITING

    def __init__(self, bench: Bench, interrupts: Interrupts) -> None:
        self._bench, self._interrupts = bench, interrupts
        self.exposures: PairExposures | None = None

    @property
    def is_firing(self) -> bool:
        """True if triggers are to be expected."""
        return not self._interrupts.is_end_wanted

    def prepare(self, order: PulseOrder, settings: Mapping[str, Setting], tell: Callable[[str], None]) -> Self:
        """Refuse what the camera, as it reads back, cannot take of these pairs."""
        section = pairs_section(self._bench)
        exposure_us = exposure_of(settings)
        require_rate(settings, section.frames, order.rate_hz)
        check_marker(section, exposure_us, order.rate_hz)
        self.exposures = pair_exposures(section, exposure_us)
        schedule_of(order.timing, LaserHead(max_rate_hz=ANY_RATE_HZ), self.exposures)
        return self

    def fire(self, laser: Self, pairs: int, armed: Callable[[], bool]) -> Self:
        """Nothing: triggers come by themselves."""
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def wait(self) -> None:
        """Nothing: what is triggered after the last pair is no part of the chunk."""

    def account(self, chunk: Chunk) -> None:
        """Say how many triggers a chunk had: no box has counted them, so those that the camera has seen."""
        chunk.fired = chunk.kept + (sum(chunk.dropped.values()) + 1) // 2
        chunk.surplus += (chunk.dropped[LEFT] + 1) // 2
