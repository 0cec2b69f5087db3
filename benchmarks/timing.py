"""Interleaved timing: on a noisy machine only ratios within one run mean anything."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """Wall times of one contender over all rounds [s]."""

    name: str
    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median wall time [s]."""
        return statistics.median(self.seconds)


def race(contenders: dict[str, Callable[[], object]], rounds: int = 9) -> dict[str, Timing]:
    """Run every contender once to warm up, then `rounds` times in turn A B C, A B C, ...

    Parameters
    ----------
    contenders : dict of name -> callable
        What to time.
    rounds : int
        Counted rounds.
    """
    for function in contenders.values():
        function()
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, function in contenders.items():
            start = time.perf_counter()
            function()
            seconds[name].append(time.perf_counter() - start)
    return {name: Timing(name, tuple(values)) for name, values in seconds.items()}
