"""A bench that is open: devices by name, opened in the order of the file, closed in reverse whatever happens.

With ``simulate`` the file's `simulation` section names, as "package.module:Class", what stands behind ports and
addresses instead of hardware: it puts another section in place of each device's own.  The drivers, the camera
backend and everything above them stay the same, and never know.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol, cast

from daq.bench.bench_table import STAGES, Bench, CameraSection
from daq.bench.elements import CAMERA
from daq.bench.guards import idle_stage
from daq.bench.kinds import kind_of
from daq.cameras import BACKENDS, backend_class, require_libraries
from daq.cameras.camera import Camera
from daq.errors import DaqError, PlanError
from daq.timing.drivers_by_name import driver_class
from daq.timing.laser import Laser
from daq.timing.states import LaserState
from daq.timing.timing_table import TimingTable
from ground.config import Table
from ground.errors import ConfigError, Problem
from ground.named_program import import_program, require_trust
from stages.clock import SYSTEM_CLOCK, Clock
from stages.config import StagesTable
from stages.errors import StageError
from stages.scale_question import ScaleQuestion
from stages.stage import Stage


class Simulation(Protocol):
    """Simulated hardware of a bench."""

    @property
    def sections(self) -> Mapping[str, Table]:
        """Section of every device by name, with simulated ports and addresses."""

    @property
    def clock(self) -> Clock:
        """Clock of the simulated world."""

    def true_mm(self) -> dict[str, float]:
        """True position of every axis in its own coordinate, which a real bench cannot know."""

    def secrets(self) -> dict[str, str]:
        """Files that tell the truth, by name, to score a run by; nothing that works on the run may read them."""

    def place(self, positions_mm: Mapping[str, float]) -> None:
        """Let axes stand elsewhere, where no command has moved them: of a page that moves nothing."""

    def seed(self, is_open: bool) -> None:
        """Open or close the seeding of a simulated flow, which at a real bench a person does."""

    def turns(self, question: ScaleQuestion, given_up: Callable[[], bool]) -> str | None:
        """Turn an axis by a simulated hand, and type what that reads; see `stages.scale_question.Person`."""

    def step_begins(self, number: int) -> None:
        """Hear that a step of a run begins, 1 first."""

    def rendering_s(self) -> float:
        """Seconds in which its pictures were drawn, up to now; no camera's time, so no timeout counts them."""

    def event_log(self) -> Any:  # noqa: ANN401 - `sim.event_log.EventLog`, which stands above us
        """Events of the simulated world, if they are recorded; `text()` is "" if not."""

    def close(self) -> None:
        """Take the simulated hardware down."""


@dataclass(frozen=True)
class OpenBench:
    """The hardware in use.

    Parameters
    ----------
    bench : Bench
        What the file says.
    devices : mapping
        Every device that was opened, by name, as its kind gives it.
    sections : mapping
        What each was opened with.
    clock : Clock
        Clock of motions.
    simulation : Simulation or None
        The simulated hardware, if it is that.
    """

    bench: Bench
    devices: Mapping[str, object]
    sections: Mapping[str, Table]
    clock: Clock
    simulation: Simulation | None

    @property
    def stage(self) -> Stage:
        """Every axis; connected."""
        return cast("Stage", self.devices[STAGES])

    @property
    def camera(self) -> Camera:
        """Open, not configured."""
        return cast("Camera", self.devices[CAMERA])

    def as_seen_by(self, name: str) -> "OpenBench":
        """Return the bench with another of its cameras in the place of the first."""
        return replace(
            self,
            bench=self.bench.as_seen_by(name),
            devices={**self.devices, CAMERA: self.devices[name]},
            sections={**self.sections, CAMERA: self.sections[name]},
        )

    def rendering_s(self) -> float:
        """Seconds in which a simulation drew pictures, up to now; 0 at hardware."""
        return 0.0 if self.simulation is None else self.simulation.rendering_s()

    @property
    def camera_section(self) -> CameraSection:
        """Section of the bench file for the camera."""
        return cast("CameraSection", self.sections[CAMERA])


def check_devices(bench: Bench, only: Collection[str] = ()) -> None:
    """Refuse a bench whose devices could not be opened on any computer; nothing is opened.

    Parameters
    ----------
    bench : Bench
        What the file says.
    only : collection of str
        Names of the devices that are needed; all if none is named.

    Raises
    ------
    StageUsageError, CameraSetupError, TimingUsageError
        A controller, camera or box cannot be as the file says, or is not there.
    UntrustedProgram
        The file names programs that the person does not trust.
    """
    sections = [device.section for name, device in bench.devices.items() if not only or name in only]
    boxes = {section.box for section in sections if isinstance(section, TimingTable)}
    cameras = [section for section in sections if isinstance(section, CameraSection)]
    backends = {camera.backend for camera in cameras} - BACKENDS.keys()  # ours are known to be there
    cores = {str(camera.options["core"]) for camera in cameras if "core" in camera.options}
    switches = {
        str(switch.by)
        for section in sections
        if isinstance(section, TimingTable)
        for switch in section.switches.values()
        if switch.by is not None
    }
    require_trust(sorted(name for name in boxes | backends | cores | switches if ":" in name))
    for backend in sorted(backends):
        backend_class(backend)
    for box in sorted(boxes):
        driver_class(box)
    if any(isinstance(section, StagesTable) for section in sections):
        idle_stage(bench)


def start_simulation(bench: Bench, shows: str = "chessboard", exposures_before: int = 0) -> Simulation:
    """Set the simulated hardware of a bench file up.

    Parameters
    ----------
    bench : Bench
        With a `simulation` section.
    shows : str
        Pattern on the target's stage: ``chessboard`` or ``particles``.
    exposures_before : int
        Frames that were taken in this world before, so that a resumed run goes on with the noise.

    Raises
    ------
    ConfigError
        There is no such section, or it is wrong.
    """
    return cast("Simulation", simulation_class(bench)(bench, shows=shows, exposures_before=exposures_before))


def check_simulation(bench: Bench) -> bool:
    """Return whether a bench has a simulation; what is wrong with its section is said, nothing is set up.

    Raises
    ------
    ConfigError, SceneError
        The section is wrong.
    """
    if bench.table.simulation is None:
        return False
    judge = getattr(simulation_class(bench), "check", None)
    if judge is not None:
        judge(bench)
    return True


def require_camera_libraries(bench: Bench, simulate: bool = False, only: Collection[str] = ()) -> None:
    """Look whether the libraries behind the cameras are installed; a simulated one may need none.

    Raises
    ------
    CameraSetupError
        Some are not; the message names them and the extra that brings them.
    """
    needs = getattr(simulation_class(bench), "needs_camera_libraries", None) if simulate else None
    if needs is not None and not needs(bench):
        return
    for name, device in bench.devices.items():
        if isinstance(device.section, CameraSection) and (not only or name in only):
            require_libraries(device.section.backend)


def simulation_class(bench: Bench) -> Callable[..., object]:
    """Return the simulation that the bench file names; ConfigError if there is none, or it is wrong."""
    section = bench.table.simulation
    line = bench.document.line(("simulation", "bench"))
    dotted = str((section or {}).get("bench", ""))
    if ":" not in dotted:
        text = 'the bench has no simulation; say simulation: {bench: "package.module:Class"}'
        raise ConfigError(bench.path, [Problem(line, text)])
    try:
        return cast("Callable[..., object]", import_program(dotted))
    except (ImportError, AttributeError) as error:
        raise ConfigError(bench.path, [Problem(line, f"{dotted} cannot be loaded: {error}")]) from error


@contextmanager
def device_sections(
    bench: Bench, simulate: bool, shows: str = "chessboard", exposures_before: int = 0
) -> Iterator[tuple[Mapping[str, Table], Clock, Simulation | None]]:
    """Yield what to open: the sections of the file, or those of its simulation, which ends with the block."""
    if not simulate:
        yield {name: device.section for name, device in bench.devices.items()}, SYSTEM_CLOCK, None
        return
    simulation = start_simulation(bench, shows, exposures_before)
    try:
        yield simulation.sections, simulation.clock, simulation
    finally:
        simulation.close()


@contextmanager
def open_bench(
    bench: Bench,
    simulate: bool = False,
    shows: str = "chessboard",
    exposures_before: int = 0,
    only: Collection[str] = (),
) -> Iterator[OpenBench]:
    """Open the devices of a bench; nothing moves and nothing is switched on.

    Parameters
    ----------
    bench : Bench
        What the file says.
    simulate, shows, exposures_before
        As for `start_simulation`.
    only : collection of str
        Names of the devices that are needed; all if none is named.

    Raises
    ------
    StageError, CameraError
        Something is not there; what was opened before is closed again.
    """
    check_devices(bench, only)
    wanted = {name: device for name, device in bench.devices.items() if not only or name in only}
    require_camera_libraries(bench, simulate, only)  # before anything is compiled or set up
    with ExitStack() as stack:
        opened = device_sections(bench, simulate, shows, exposures_before)
        sections, clock, simulation = stack.enter_context(opened)
        devices = {
            name: stack.enter_context(kind_of(device.kind).open(sections[name], bench, clock))
            for name, device in wanted.items()
        }
        for stage in [device for device in devices.values() if isinstance(device, Stage)]:
            for laser in [device for device in devices.values() if isinstance(device, Laser)]:
                keep_apart(laser, stage)
            if simulation is not None and bench.table.stages.by_hand:
                stage.set_operator(simulation.turns)
        yield OpenBench(bench, devices, sections, clock, simulation)


def keep_apart(laser: Laser, stage: Stage) -> None:
    """See that nothing moves while light may leave a laser, none leaves meanwhile, and no hand finds it on."""
    laser.add_motion_interlock(stage)
    stage.bar_hands(partial(_dark_for_hands, laser))


def _dark_for_hands(laser: Laser) -> str | None:
    """Switch a laser off before a person reaches in, lamps and all; say why that is not sure.

    Motors may move while lamps run.  A hand is in the bench for minutes, and only a Q-switch would keep the light.
    """
    if laser.state in (LaserState.WARM, LaserState.READY):
        with suppress(DaqError, StageError):
            laser.safe()
    state = laser.state
    return None if state is LaserState.SAFE else f"{laser.name} is {state.value}; switch it off (rtpiv laser off)"


def require_positions(where_mm: Mapping[str, float | None]) -> dict[str, float]:
    """Positions of all axes.

    Raises
    ------
    PlanError
        Some axes do not know where they are.
    """
    unknown = [name for name, mm in where_mm.items() if mm is None]
    if unknown:
        raise PlanError(
            f"{', '.join(unknown)} have no position reference; home them (--home, or rtpiv bench stage home)"
        )
    return {name: float(mm) for name, mm in where_mm.items() if mm is not None}
