"""A rehearsal: the simulated bench as a test wants it, with a seed, with faults, and repeatable.

Everything of it lives in one process, stages and cameras, so that no time passes but by waiting, and everything
that happens is kept: commands of each box, what went wrong, where everything truly stood at each exposure
(`sim.event_log`).  What a run is resumed with is its seed; its faults are over.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from daq.bench.bench_table import Bench
from daq.bench.fault_table import Fault, FaultFile, validation_errors
from daq.bench.opened import simulation_class
from daq.errors import RunUsageError
from ground.config import Document, open_document, validate
from ground.errors import ConfigError, Problem

SEEDS = 2**31


@dataclass(frozen=True)
class Rehearsal:
    """Rehearsal: faults and random numbers of the simulated bench.

    Parameters
    ----------
    faults : path or sequence of mapping, optional
        Faults of the simulated bench and their times: a YAML file, or its entries.
    seed : int, optional
        Seed of misalignment, prints and noise of the simulated bench.  Default: that of the bench file.
    """

    faults: Path | str | Sequence[Mapping[str, Any]] | None = None
    seed: int | None = None

    def of(self, bench: Bench, steps: int | None = None) -> Bench:
        """Return a bench whose simulation is this rehearsal.

        Parameters
        ----------
        bench : Bench
            With a `simulation` section.
        steps : int, optional
            How many steps the run has; None where nothing is done step by step.

        Raises
        ------
        ConfigError, RunUsageError
            The faults cannot be on this bench, or the seed is no seed; the first with the line.
        """
        if self.seed is not None and not 0 <= self.seed <= SEEDS:
            raise RunUsageError(f"seed {self.seed}: use a whole number from 0 to {SEEDS}")
        document, found = self._read_faults()
        problems = [
            Problem(document.line(("faults", index)) if document.lines else 0, f"faults[{index}]: {text}")
            for index, fault in enumerate(found)
            for text in (*validation_errors(fault, bench), *_wrong_step(fault, steps))
        ]
        if problems:
            raise ConfigError(document.path, problems)
        return with_rehearsal(bench, self.seed, found)

    def _read_faults(self) -> tuple[Document, list[Fault]]:
        """Faults of a file, each with its line."""
        if isinstance(self.faults, Path | str):
            document = open_document(self.faults)
        else:
            document = Document(Path("faults"), {"faults": [dict(each) for each in self.faults or ()]}, {})
        return document, validate(document, FaultFile).faults if self.faults else []


def _wrong_step(fault: Fault, steps: int | None) -> list[str]:
    """Return why a fault would never be due."""
    if fault.step is None:
        return []
    if steps is None:
        return ["step: an open bench has no steps, only the run of a plan has; say word or at_s"]
    return [f"step: the plan has {steps} steps, so step {fault.step} never begins"] if fault.step > steps else []


def with_rehearsal(bench: Bench, seed: int | None, schedule: Sequence[Fault] = ()) -> Bench:
    """Return a bench with its simulation in memory, its happenings kept.

    Raises
    ------
    ConfigError, RunUsageError
        The bench has no simulation, or one that cannot be rehearsed on.
    """
    if not hasattr(simulation_class(bench), "event_log"):
        named = (bench.table.simulation or {})["bench"]
        raise RunUsageError(
            f"{bench.path}: {named} supports neither faults nor a seed; omit them, or name "
            '"sim.bench:SimulatedBench" in its simulation'
        )
    own: dict[str, Any] = {"transport": "memory", "camera_transport": "memory", "keeps": True}
    own |= {} if seed is None else {"seed": seed}
    own |= {"schedule": [fault.model_dump(exclude_unset=True) for fault in schedule]} if schedule else {}
    simulation = {**(bench.table.simulation or {}), **own}
    return replace(bench, table=bench.table.model_copy(update={"simulation": simulation}))
