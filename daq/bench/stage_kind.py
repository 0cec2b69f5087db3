"""The stage: every axis of every controller, guarded by keep-out."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from typing import cast

from daq.bench.bench_table import Bench
from daq.bench.keep_out import Carrier, Element, KeepOut
from stages.clock import SYSTEM_CLOCK, Clock
from stages.config import StagesTable
from stages.stage import Guard, Piece, Stage
from tracer.scene.scene import Scene


class StageKind:
    """The section `stages`."""

    section = StagesTable
    simulator = None  # the world carries things on its own axes

    def open(self, section: StagesTable, bench: Bench, clock: Clock) -> AbstractContextManager[Stage]:
        """Connect every controller; leaving stops what moves."""
        return Stage.open(section.beside(bench.path.parent), clock, guard_of(bench))

    def places(self, section: StagesTable) -> Iterator[str]:
        """Ports of the controllers."""
        for name, controller in section.controllers.items():
            yield f"controller {name}: {controller.driver} on {controller.place}"


def guard_of(bench: Bench) -> Guard | None:
    """What judges every way before it is driven; None if the bench file asks for limits only.

    Raises
    ------
    StageUsageError
        The file allows contact with a body that is not in the scene.
    """
    if bench.table.keep_out is None:
        return None
    if bench.scenes:
        return _Guards([keep_out_of(bench, scene) for scene in (bench.scene, *bench.scenes.values())])
    return keep_out_of(bench, bench.scene)


class _Guards:
    """Several cameras ride on the same axes, each with its own lens: what is too close for one is."""

    def __init__(self, guards: Sequence[Guard]) -> None:
        self._guards = guards

    def check(self, way: Sequence[Piece]) -> None:
        for guard in self._guards:
            guard.check(way)


def keep_out_of(bench: Bench, scene: Scene) -> KeepOut:
    """What judges ways for a scene; the bench file has a section keep_out."""
    assert bench.table.keep_out is not None
    home = bench.home_mm
    carriers = {
        name: Carrier(cast("Element", axis.carries), axis.along, home[name])
        for name, axis in bench.table.stages.axes.items()
    }
    return KeepOut(scene, carriers, bench.table.keep_out)


def idle_stage(bench: Bench) -> Stage:
    """Return the stage with closed ports, to ask what it would do."""
    return Stage(bench.table.stages, SYSTEM_CLOCK, guard_of(bench))
