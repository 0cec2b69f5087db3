"""A bench that is open: stage, camera and clock, closed in reverse order whatever happens.

With ``simulate`` the file's `simulation` section names, as "package.module:Class", what stands behind ports and
camera instead of hardware.  The drivers, the camera backend and everything above them stay the same, and never
know.
"""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol, cast

from daq.acquisition.bench.bench_file import Bench, CameraSection
from daq.acquisition.cameras import make_camera
from daq.acquisition.cameras.camera import Camera
from daq.errors import PlanError
from ground.errors import ConfigError, Problem
from stages.clock import SYSTEM_CLOCK, Clock
from stages.config import StagesTable
from stages.keep_out import Carrier, Element, KeepOut
from stages.stage import Guard, Stage


class Simulation(Protocol):
    """What stands in for the hardware."""

    @property
    def stages(self) -> StagesTable:
        """The stages section, with the simulated ports."""
        ...

    @property
    def camera(self) -> CameraSection:
        """The camera section, with the simulated camera."""
        ...

    @property
    def clock(self) -> Clock:
        """Clock of the simulated world."""
        ...

    def true_mm(self) -> dict[str, float]:
        """Where every axis really is, in its own coordinate; nobody at a real bench knows."""
        ...

    def secrets(self) -> dict[str, str]:
        """Files that tell the truth, by name, to score a run by; nothing that works on the run may read them."""
        ...

    def close(self) -> None:
        """Take the simulated hardware down."""
        ...


@dataclass(frozen=True)
class OpenBench:
    """The hardware in use.

    Parameters
    ----------
    bench : Bench
        What the file says.
    stage : Stage
        Every axis; connected.
    camera : Camera
        Open, not configured.
    camera_section : CameraSection
        How it is to be configured.
    clock : Clock
        Clock of motions.
    simulation : Simulation or None
        The simulated hardware, if it is that.
    """

    bench: Bench
    stage: Stage
    camera: Camera
    camera_section: CameraSection
    clock: Clock
    simulation: Simulation | None


def start_simulation(bench: Bench, shows: str = "chessboard", exposures_before: int = 0) -> Simulation:
    """Set the simulated hardware of a bench file up.

    Parameters
    ----------
    bench : Bench
        With a `simulation` section.
    shows : str
        What somebody has hung on the target's stage: ``chessboard`` or ``particles``.
    exposures_before : int
        Frames that were taken in this world before, so that a resumed run goes on with the noise.

    Raises
    ------
    ConfigError
        There is no such section, or it is wrong.
    """
    section = bench.table.simulation
    line = bench.document.line(("simulation", "bench"))
    dotted = str((section or {}).get("bench", ""))
    module, colon, name = dotted.partition(":")
    if not colon:
        text = 'the bench has no simulation; say simulation: {bench: "package.module:Class"}'
        raise ConfigError(bench.path, [Problem(line, text)])
    try:
        make = getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(bench.path, [Problem(line, f"{dotted} cannot be loaded: {error}")]) from error
    return cast("Simulation", make(bench, shows=shows, exposures_before=exposures_before))


def guard_of(bench: Bench) -> Guard | None:
    """What judges every way before it is driven; None if the bench file asks for limits only.

    Raises
    ------
    StageUsageError
        The file allows contact with a body that is not in the scene.
    """
    if bench.table.keep_out is None:
        return None
    home = bench.home_mm
    carriers = {
        name: Carrier(cast("Element", axis.carries), axis.along, home[name])
        for name, axis in bench.table.stages.axes.items()
    }
    return KeepOut(bench.scene, carriers, bench.table.keep_out)


def idle_stage(bench: Bench) -> Stage:
    """Return the stage with closed ports, to ask what it would do."""
    return Stage(bench.table.stages, SYSTEM_CLOCK, guard_of(bench))


@contextmanager
def simulated_or_real(
    bench: Bench, simulate: bool, shows: str = "chessboard", exposures_before: int = 0
) -> Iterator[tuple[StagesTable, CameraSection, Clock, Simulation | None]]:
    """Yield what to open: the sections of the file, or those of its simulation, which ends with the block."""
    if not simulate:
        yield bench.table.stages, bench.table.camera, SYSTEM_CLOCK, None
        return
    simulation = start_simulation(bench, shows, exposures_before)
    try:
        yield _any_box(simulation.stages), simulation.camera, simulation.clock, simulation
    finally:
        simulation.close()


def _any_box(stages: StagesTable) -> StagesTable:
    """Return the same stages with any box accepted: simulated ones have other serial numbers than yours."""
    controllers = {name: table.model_copy(update={"identity": None}) for name, table in stages.controllers.items()}
    return stages.model_copy(update={"controllers": controllers})


@contextmanager
def open_bench(
    bench: Bench, simulate: bool = False, shows: str = "chessboard", exposures_before: int = 0
) -> Iterator[OpenBench]:
    """Open stage and camera; nothing moves.

    Raises
    ------
    StageError, CameraError
        Something is not there; what was opened before is closed again.
    """
    with ExitStack() as stack:
        opened = simulated_or_real(bench, simulate, shows, exposures_before)
        stages, section, clock, simulation = stack.enter_context(opened)
        stage = stack.enter_context(Stage.open(stages, clock, guard_of(bench)))
        camera = make_camera(section.backend, **section.options)
        stack.callback(camera.close)
        camera.open()
        yield OpenBench(bench, stage, camera, section, clock, simulation)


@contextmanager
def open_stage(bench: Bench, simulate: bool = False) -> Iterator[Stage]:
    """Open the stage alone."""
    with (
        simulated_or_real(bench, simulate) as (stages, _, clock, _),
        Stage.open(stages, clock, guard_of(bench)) as it,
    ):
        yield it


@contextmanager
def open_camera(bench: Bench, simulate: bool = False) -> Iterator[tuple[Camera, CameraSection]]:
    """Open the camera alone."""
    with simulated_or_real(bench, simulate) as (_, section, _, _):
        camera = make_camera(section.backend, **section.options)
        try:
            camera.open()
            yield camera, section
        finally:
            camera.close()


def known_positions(where_mm: Mapping[str, float | None]) -> dict[str, float]:
    """Positions of all axes.

    Raises
    ------
    PlanError
        Some axes do not know where they are.
    """
    unknown = [name for name, mm in where_mm.items() if mm is None]
    if unknown:
        raise PlanError(
            f"{', '.join(unknown)} do not know where they are; home them (--home, or rtpiv stage home)"
        )
    return {name: float(mm) for name, mm in where_mm.items() if mm is not None}
