"""A simulated bench that is open for a test, with the truth beside it.

with Rehearsed("bench.yaml", faults=[{"what": "unplug", "of": "target", "word": "MOV"}], seed=3) as bench:
    bench.home()
    bench.move(target_z=-5.0)
    bench.true_mm()["target_z"], bench.event_log().bytes_to("target")
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from daq.bench.bench_file import load_bench
from daq.bench.bench_session import BenchSession
from daq.bench.rehearsal import Rehearsal
from sim.event_log import EventLog


class Rehearsed(BenchSession):
    """The simulation of a bench file as an open session.

    Parameters
    ----------
    bench : path
        bench.yaml, with a `simulation` section.
    faults, seed
        As for `Rehearsal`.

    Raises
    ------
    ConfigError, RunUsageError
        The file, the faults or the seed are wrong.
    """

    def __init__(
        self,
        bench: Path | str,
        faults: Path | str | Sequence[Mapping[str, Any]] | None = None,
        seed: int | None = None,
    ) -> None:
        super().__init__(Rehearsal(faults, seed).of(load_bench(bench)), simulate=True)

    def true_mm(self) -> dict[str, float]:
        """Return the true position of every axis [mm], whatever its controller says."""
        assert self.simulation is not None
        return self.simulation.true_mm()

    def event_log(self) -> EventLog:
        """Return the events so far."""
        assert self.simulation is not None
        return cast("EventLog", self.simulation.event_log())
