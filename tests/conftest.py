"""What all tests share: how examples are drawn, and the witness of every simulated bench that a test makes.

Drawn examples are judged by their results, never by how long a busy machine took.

Whatever else a test looks at, it fails if on a simulated bench of its own something has truly passed a limit or
come too close, has moved on after a stop, or was told a false position (`sim.witness`). A test that provokes
such a thing on purpose says so: ``@pytest.mark.provokes("limit")``; then it must happen. Benches in other
processes write what their witnesses see into a folder that the environment names. Stops are judged on clocks
that move by waiting only: on the others the machine's load would be judged.
"""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from rtpiv.command_line import first_use
from sim.emulators.protocol_sim import LINES
from sim.mechanics.clock import VirtualClock
from sim.witness.witness import LEDGER, Witness
from stages.stage import Stage
from stages.stop_latch import StopLatch

first_use.MOST_HELPERS = 0  # all cores have tests

# Programs of other projects that bench files of tests name; what is asked of a person is tested with none of them.
TRUSTED = (
    "builtins:dict", "tests.daq.bench.test_devices:LampKind",
    "hangs:Hangs", "math:sqrt", "no.such.module:Camera", "no.such:Thing", "no_such_core:Core",
    "nowhere.at.all:Axis", "nowhere:Lamp", "ophyd.sim:SynAxis", "sim.camera.core:Untrue", "tests_demo_core:Core",
    "tests_own_axes:TimedAxis", "tests.system.test_mixed_bench:DemoBench",
)  # fmt: skip
os.environ["RTPIV_TRUST"] = ",".join(TRUSTED)

settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

# Under nohup or in the background of a script, as CI may be: programs inherit what is ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
for name in {"SIGHUP", "SIGQUIT", "SIGTSTP"} & set(dir(signal)):
    signal.signal(getattr(signal, name), signal.SIG_DFL)


def pytest_xdist_auto_num_workers() -> int:
    """One process more than cores: a fifth of the time a test waits for a program, a port or a disk."""
    return (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1) + 1


# The files that take longest begin: they are handed out in order (--no-loadscope-reorder), and the last are short.
# Those that compile what another file asks for as well begin long before it: two processes would compile it twice.
LONG = (
    "test_correction_map.py",
    "tracer/test_walls.py",
    "test_bed_sheets.py",
    "test_report.py",
    "test_board_search.py",
    "test_any_byte.py",
    "test_flows.py",
    "test_init.py",
    "test_shells.py",
    "test_names_and_limits.py",
    "test_stages.py",
    "test_series_verbs.py",
    "test_what_the_system_refuses.py",
)


SLOW_S = 3600.0  # what hangs is ended; what waits for a busy core is not


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Long files first, all else in its order; a slow test is not judged by how long a busy machine takes."""
    items.sort(key=_turn)
    is_posix = os.name == "posix" and not config.pluginmanager.has_plugin("tests.no_posix.plugin")
    for item in items:
        if not is_posix and (only := item.get_closest_marker("posix")):
            item.add_marker(pytest.mark.skip(reason=f"POSIX alone: {only.args[0]}"))
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_S))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Let the collector rest while tests are collected, which lets nothing go: it took a fifth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish() -> None:
    """Let the collector leave alone what stays, and rest longer: it took a twentieth of all time."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


def _turn(item: pytest.Item) -> int:
    path = item.path.as_posix()
    return next((turn for turn, name in enumerate(LONG) if path.endswith(f"/{name}")), len(LONG))


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

    def made(self, witness: Witness) -> None:
        self.witnesses.append(witness)

    def opened(self, stage: Stage) -> None:
        lines = [LINES.get(_address(table)) for table in stage.config.controllers.values()]
        ours = [
            witness
            for witness in self.witnesses
            if any(watched.line in lines for watched in witness.axes.values())
        ]
        for witness in ours:
            witness.cleared()  # a new program knows nothing of the stops of an older one
        self._by_latch[id(stage.latch)] = [w for w in ours if isinstance(w.clock, VirtualClock)]
        self._kept.append(stage.latch)

    def stopped(self, latch: StopLatch) -> None:
        for witness in self._by_latch.get(id(latch), []):
            witness.stopped()

    def cleared(self, latch: StopLatch) -> None:
        for witness in self._by_latch.get(id(latch), []):
            witness.cleared()

    def violations(self, ledger: Path) -> list[str]:
        seen = [str(violation) for witness in self.witnesses for violation in witness.judge()]
        elsewhere = [line for path in ledger.glob("*.txt") for line in path.read_text().splitlines()]
        return seen + [line for line in elsewhere if line not in seen]


def _after(original: Callable[..., Any], also: Callable[[Any], None]) -> Callable[..., Any]:
    def called(self: Any, *args: Any, **options: Any) -> Any:
        result = original(self, *args, **options)
        also(self)
        return result

    return called


def _before(original: Callable[..., Any], also: Callable[[Any], None]) -> Callable[..., Any]:
    def called(self: Any, *args: Any, **options: Any) -> Any:
        also(self)
        return original(self, *args, **options)

    return called


@pytest.fixture(autouse=True)
def witnesses(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Watch]:
    """Watch every simulated bench that the test makes."""
    watch = Watch()
    ledger = tmp_path_factory.getbasetemp() / f"witness-{abs(hash(request.node.nodeid)):x}"
    ledger.mkdir()
    monkeypatch.setenv(LEDGER, str(ledger))
    monkeypatch.setattr(Witness, "__init__", _after(Witness.__init__, watch.made))
    monkeypatch.setattr(Stage, "__init__", _after(Stage.__init__, watch.opened))
    monkeypatch.setattr(StopLatch, "stop", _after(StopLatch.stop, watch.stopped))
    monkeypatch.setattr(StopLatch, "clear", _before(StopLatch.clear, watch.cleared))
    yield watch
    violations = watch.violations(ledger)
    provoked = {kind for mark in request.node.iter_markers("provokes") for kind in mark.args}
    unwanted = [text for text in violations if text.split(" of ")[0] not in provoked]
    assert not unwanted, "what the simulated world has seen:\n" + "\n".join(unwanted[:10])
    missed = [kind for kind in provoked if not any(text.startswith(f"{kind} of ") for text in violations)]
    assert not missed, f"the test says that it provokes what has not happened: {missed}"
