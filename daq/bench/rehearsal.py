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
from daq.bench.fault_table import Fault, FaultFile, not_recorded, validation_errors
from daq.bench.opened import simulation_class
from daq.errors import RunUsageError
from ground.config import Document, open_document, validate
from ground.errors import ConfigError, Problem
from stages.dialogue import read_dialogue

SEEDS = 2**31


@dataclass(frozen=True)
class Rehearsal:
    """Rehearsal: faults and random numbers of the simulated bench.

    Parameters
    ----------
    faults : path or sequence of mapping, optional
        Faults of the simulated bench and their times: a YAML file, which may name recordings, or its entries.
    seed : int, optional
        Seed of misalignment, prints and noise of the simulated bench.  Default: that of the bench file.
    """

    faults: Path | str | Sequence[Mapping[str, Any]] | None = None
    seed: int | None = None

    def of(
        self, bench: Bench, steps: int | None = None, recorded: Mapping[str, Path | str] | None = None
    ) -> Bench:
        """Return a bench whose simulation is this rehearsal.

        Parameters
        ----------
        bench : Bench
            With a `simulation` section.
        steps : int, optional
            How many steps the run has; None where nothing is done step by step.
        recorded : mapping of str to path, optional
            Files of what was said at real hardware, which answer in place of an emulator, by the name of the box.

        Raises
        ------
        ConfigError, RunUsageError
            The faults cannot be on this bench, or the seed is no seed; the first with the line.
        """
        if self.seed is not None and not 0 <= self.seed <= SEEDS:
            raise RunUsageError(f"seed {self.seed}: use a whole number from 0 to {SEEDS}")
        document, file = self._read_faults()
        found = file.faults
        problems = [
            Problem(document.line(("faults", index)) if document.lines else 0, f"faults[{index}]: {text}")
            for index, fault in enumerate(found)
            for text in (*validation_errors(fault, bench), *_wrong_step(fault, steps))
        ]
        beside = document.path.parent
        files = {name: Path(path) for name, path in (recorded or {}).items()}
        files |= {name: beside / path for name, path in file.recorded.items()}
        problems += [
            Problem(document.line(("recorded", name)) if document.lines else 0, f"recorded.{name}: {why}")
            for name in files
            if (why := not_recorded(name, bench))
        ]
        if problems:
            raise ConfigError(document.path, problems)
        for path in files.values():
            read_dialogue(path)
        return with_rehearsal(bench, self.seed, found, files)

    def _read_faults(self) -> tuple[Document, FaultFile]:
        """Faults and recordings of a file, each with its line."""
        if self.faults is None:
            return Document(Path("recorded"), {}, {}), FaultFile.model_construct(faults=[], recorded={})
        if isinstance(self.faults, Path | str):
            document = open_document(self.faults)
            return document, validate(document, FaultFile)
        document = Document(Path("faults"), {"faults": [dict(each) for each in self.faults]}, {})
        if not self.faults:
            return document, FaultFile.model_construct(faults=[], recorded={})
        return document, validate(document, FaultFile)


def _wrong_step(fault: Fault, steps: int | None) -> list[str]:
    """Return why a fault would never be due."""
    if fault.step is None:
        return []
    if steps is None:
        return ["step: an open bench has no steps, only the run of a plan has; say word or at_s"]
    return [f"step: the plan has {steps} steps, so step {fault.step} never begins"] if fault.step > steps else []


def with_rehearsal(
    bench: Bench, seed: int | None, schedule: Sequence[Fault] = (), recorded: Mapping[str, Path] | None = None
) -> Bench:
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
    own |= {"recorded": {name: str(path) for name, path in recorded.items()}} if recorded else {}
    simulation = {**(bench.table.simulation or {}), **own}
    return replace(bench, table=bench.table.model_copy(update={"simulation": simulation}))
