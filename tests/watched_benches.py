"""The witness of every simulated bench that a test makes: imported by the conftest.py of folders with benches.

Whatever else a test looks at, it fails if on a simulated bench of its own something has truly passed a limit or
come too close, has moved on after a stop, or was told a false position (`sim.witness`). A test that provokes
such a thing on purpose is marked ``@pytest.mark.provokes("limit")``; then it must happen. Benches in other
processes write what their witnesses see into a folder that the environment names. Stops are judged on clocks
that move by waiting only: on the others the machine's load would be judged.
"""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from sim.emulators.protocol_sim import LINES
from sim.mechanics.clock import VirtualClock
from sim.witness.witness import LEDGER, Witness
from stages.stage import Stage
from stages.stop_latch import StopLatch


def _address(table: Any) -> str:
    """Name of the simulated line that a controller hangs on, whatever way leads to it."""
    if hasattr(table, "objects"):
        return str(next(iter(table.objects.values())).arguments.get("address", "")).removeprefix("sim://")
    return str(getattr(table, "port", None) or getattr(table, "adapters", None)).removeprefix("sim://")


class Watch:
    """Collects the witnesses of a test, and tells them of the stops that are theirs."""

    def __init__(self) -> None:
        self.witnesses: list[Witness] = []
        self._by_latch: dict[int, list[Witness]] = {}
        self._kept: list[object] = []  # an id must not be used again

    def add(self, witness: Witness) -> None:
        self.witnesses.append(witness)

    def opened(self, stage: Stage) -> None:
        lines = [LINES.get(_address(table)) for table in stage.config.controllers.values()]
        ours = [
            witness
            for witness in self.witnesses
            if any(watched.line in lines for watched in witness.axes.values())
        ]
        for witness in ours:
            witness.note_clear()  # a new program knows nothing of the stops of an older one
        self._by_latch[id(stage.latch)] = [w for w in ours if isinstance(w.clock, VirtualClock)]
        self._kept.append(stage.latch)

    def stopped(self, latch: StopLatch) -> None:
        for witness in self._by_latch.get(id(latch), []):
            witness.note_stop()

    def cleared(self, latch: StopLatch) -> None:
        for witness in self._by_latch.get(id(latch), []):
            witness.note_clear()

    def violations(self, ledger: Path) -> list[str]:
        seen = [str(violation) for witness in self.witnesses for violation in witness.judge()]
        elsewhere = [line for path in ledger.glob("*.txt") for line in path.read_text().splitlines()]
        return seen + [line for line in elsewhere if line not in seen]


_watches: list[Watch] = []  # that of the running test, if it has one


def _report(owner: type, method: str, event: Callable[[Watch, Any], None], *, is_before: bool = False) -> None:
    """Report calls of a method to the watch of the running test; patched once, since most tests make no bench."""
    original = getattr(owner, method)

    def called(self: Any, *args: Any, **options: Any) -> Any:
        if is_before and _watches:
            event(_watches[-1], self)
        result = original(self, *args, **options)
        if not is_before and _watches:
            event(_watches[-1], self)
        return result

    setattr(owner, method, called)


_report(Witness, "__init__", Watch.add)
_report(Stage, "__init__", Watch.opened)
_report(StopLatch, "stop", Watch.stopped)
_report(StopLatch, "clear", Watch.cleared, is_before=True)


@pytest.fixture(autouse=True)
def witnesses(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watch]:
    """Watch every simulated bench that the test makes."""
    watch = Watch()
    ledger = tmp_path_factory.getbasetemp() / f"witness-{abs(hash(request.node.nodeid)):x}"
    os.environ[LEDGER] = str(ledger)
    _watches.append(watch)
    yield watch
    _watches.remove(watch)
    os.environ.pop(LEDGER, None)
    violations = watch.violations(ledger)
    provoked = {kind for mark in request.node.iter_markers("provokes") for kind in mark.args}
    unwanted = [text for text in violations if text.split(" of ")[0] not in provoked]
    assert not unwanted, "what the simulated world has seen:\n" + "\n".join(unwanted[:10])
    missed = [kind for kind in provoked if not any(text.startswith(f"{kind} of ") for text in violations)]
    assert not missed, f"the test says that it provokes what has not happened: {missed}"
