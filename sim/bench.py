"""The simulated bench: emulators behind serial lines, a camera behind its transport, one world behind both.

The camera stands behind a GenTL producer; if the bench file's backend is `aravis`, it is a GigE Vision device on
the loopback.  `bench_table` says what can be chosen, `world` what is true.
"""

import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, cast
from zlib import crc32

from daq.bench.bench_table import STAGES, Bench, CameraSection, Device
from daq.bench.elements import CAMERA
from daq.bench.kinds import kind_of
from daq.bench.reading import ReadingSection
from daq.errors import RunUsageError
from daq.timing.timing_table import TimingTable
from ground.config import Table
from ground.errors import ConfigError, Problem
from sim.arranged import check_views, where_scene_holds
from sim.bench_table import FurtherCameraTable, SimulationTable, fault_plan, settings_by_number, simulation_of
from sim.camera.config import CameraConfig
from sim.camera.core import CONFIG, SimCore
from sim.camera.device import SimCamera
from sim.camera.gentl import write_producer
from sim.camera.gige.process import device_process
from sim.camera.in_process import DEVICES
from sim.camera.remote import FrameServer
from sim.camera.wires import Wires
from sim.devices import connect, external_pulses, external_synchroniser
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.event_log import EventLog
from sim.expected import estimate_s
from sim.mechanics.clock import PacedClock, ScaledClock
from sim.stages import SimulatedStages
from sim.timing import SimulatedTiming
from sim.watched_world import Struck, WatchedWorld
from sim.world import FLOW, World
from stages.config import StagesTable
from stages.controller_tables import HandTable
from stages.scale_question import ScaleQuestion
from tracer.errors import SceneError

SERIAL = "SIM-BENCH"
CAMERA_HERE = "sim.camera.in_process:InProcessCamera"
STOOD = """# The true scene with every axis where the scene holds. Screws have play: where things truly stood for a
# frame is its true_mm in steps.jsonl (`sim.arranged`). 0.05 mm from here, a map of two balls differs by 0.04 px.
# Glass is given at wavelength_nm; a run of the target was taken in fit.light, any other in the laser's light.
"""


class SimulatedBench:
    """Everything of a bench but the software.

    Parameters
    ----------
    bench : Bench
        With a `simulation` section.
    shows : str
        ``chessboard`` or ``particles``.
    exposures_before : int
        Exposures made in this world before.

    Raises
    ------
    ConfigError
        The section is wrong.
    """

    check_views = staticmethod(check_views)  # refuses a plan that cannot be shown, before anything runs
    estimate_s = staticmethod(estimate_s)

    def __init__(self, bench: Bench, shows: str = "chessboard", exposures_before: int = 0) -> None:
        table = simulation_of(bench)
        for name, section in bench.cameras.items():
            if section.scene_shows == "sensor":
                place = ("camera",) if name == CAMERA else ("devices", name)
                text = f"{name}: the simulated world shows images, so its scene has to; say scene_shows: image"
                raise ConfigError(bench.path, [Problem(bench.document.line((*place, "scene_shows")), text)])
        pty = table.transport == "pty"
        self._in_memory = table.camera_transport == "memory"
        # a flow is seen in real time: cameras live on the wall's clock
        speed = 1.0 if shows == FLOW else table.speed
        self.clock: ScaledClock | PacedClock = ScaledClock(speed) if pty else PacedClock()
        self._stack = ExitStack()
        self._shows = shows
        self._further_worlds: dict[str, World] = {}
        self._cameras: dict[str, SimCamera] = {}  # that have power in this process, by serial number
        self._units: dict[str, SimulatedTiming] = {}
        self._gauges: dict[str, Line | None] = {}  # readings in this process
        self._watched: WatchedWorld | None = None
        try:
            options: dict[str, dict[str, Any]] = {
                name: {"settings": settings_by_number(settings)} for name, settings in table.firmware.items()
            }
            for name, controller in bench.table.stages.controllers.items():
                if isinstance(controller, HandTable):
                    options[name] = {**table.hand.model_dump(), "seed": table.seed}
            self._stages = stages = SimulatedStages(bench.table.stages, self.clock, table.axes, options)
            self.lines, self.witness = stages.lines, stages.witness
            if bench.table.keep_out is not None:
                home = where_scene_holds(bench, table.glass_off_mm)
                stages.witness.look_at(bench.scene, bench.table.keep_out, bench.table.stages, home)
            served = self._stack.enter_context(stages.serve() if pty else stages.in_process())
            self.world = World(bench, table, stages, shows, exposures_before)
            if isinstance(self.clock, PacedClock) and shows == FLOW:
                self.clock.is_paced = lambda: any(unit.triggers_camera for unit in self.world.timing)
            folder = Path(tempfile.mkdtemp(prefix="rtpiv-"))
            self._stack.callback(shutil.rmtree, folder, ignore_errors=True)
            self._wires = Wires(folder)  # all cameras hang on the same
            self._stack.callback(self._wires.close)
            camera = self._camera(bench, table, exposures_before, folder)
            self.sections: dict[str, Table] = {STAGES: _any_box(served), CAMERA: camera}
            for name, device in bench.more.items():
                if isinstance(device.section, CameraSection):
                    self.sections[name] = self._further(bench, name, table, stages, exposures_before, folder)
                else:
                    self.sections[name] = opened = self._stack.enter_context(self._more(bench, name, device))
                    if isinstance(opened, ReadingSection) and opened.port is not None:
                        self._gauges[name] = LINES.get(opened.port.removeprefix("sim://"))
                    self._wire(name, device)
            if table.synchroniser is not None and shows == FLOW:
                pulses = external_pulses(table.synchroniser, bench.table.camera)
                unit = self._stack.enter_context(external_synchroniser(pulses, self.world, self.clock))
                connect(unit, self.clock, self._wires, self.world.lit)
            if table.keeps:
                self._watched = self._watch(table, stages)
        except BaseException:
            self._stack.close()
            raise

    @staticmethod
    def check(bench: Bench) -> None:
        """Say what is wrong with the section of a bench file; nothing is put up."""
        simulation_of(bench)

    @staticmethod
    def needs_camera_libraries(bench: Bench) -> bool:
        """Return whether the cameras stand behind what their backends' libraries speak."""
        return simulation_of(bench).camera_transport != "memory"

    def true_mm(self) -> dict[str, float]:
        """Return the true position of every axis, in its own coordinate."""
        return self.world.true_mm()

    def turns(self, question: ScaleQuestion, given_up: Callable[[], bool]) -> str | None:
        """Turn an axis without a motor, and type what its scale seems to read."""
        return self._stages.turns(question, given_up)

    def place(self, positions_mm: Mapping[str, float]) -> None:
        """Let axes stand elsewhere, without any motor."""
        self._stages.place(positions_mm)

    def seed(self, is_open: bool) -> None:
        """Open or close the seeding of the flow."""
        if self.world.lit is not None:
            self.world.lit.seed(is_open)

    def step_begins(self, number: int) -> None:
        """Hear that a step of a run begins, 1 first; faults may wait for it."""
        if self._watched is not None:
            self._watched.step_begins(number)

    def event_log(self) -> EventLog:
        """Return the events so far, if the bench file's section keeps them."""
        return EventLog(()) if self._watched is None else self._watched.event_log(self.witness.judge())

    def rendering_s(self) -> float:
        """Seconds in which pictures were drawn, up to now: time of this computer, not of the cameras."""
        return self.world.drawing.so_far_s

    def secrets(self) -> dict[str, str]:
        """The true scene, and the flow if one was shown: to score a run by."""
        truths = {"truth.yaml": STOOD + self.world.truth()}
        if self.world.lit is not None:
            truths["flow_truth.yaml"] = self.world.flow_truth()
        for name, world in self._further_worlds.items():
            truths[f"truth_{name}.yaml"] = STOOD + world.truth()
        return truths

    def close(self) -> None:
        """Take everything down."""
        self.witness.judge()
        self._stack.close()

    def _more(self, bench: Bench, name: str, device: Device) -> AbstractContextManager[Table]:
        """Put a device of another kind up by what that kind names as its simulator."""
        module, _, function = (kind_of(device.kind).simulator or "").partition(":")
        if not function:
            line = bench.document.line(("devices", name))
            text = f"devices.{name}: the simulated bench has no more devices of kind {device.kind!r}"
            raise ConfigError(bench.path, [Problem(line, text)])
        simulator = getattr(import_module(module), function)
        return cast("AbstractContextManager[Table]", simulator(device.section, self.world, self.clock))

    def _wire(self, name: str, device: Device) -> None:
        """Hang camera and light on the unit that was put up last, if the device is one."""
        if isinstance(device.section, TimingTable):
            self._units[name] = self.world.timing[-1]
            connect(self._units[name], self.clock, self._wires, self.world.lit)

    def _watch(self, table: SimulationTable, stages: SimulatedStages) -> WatchedWorld:
        """Keep what happens from now on, and let the faults of a rehearsal wait for their moments."""
        assert isinstance(self.clock, PacedClock)
        if self._shows == FLOW and any(fault.what == "dim" for fault in table.schedule):
            raise RunUsageError(
                "dim of lamp: a flow is lit by the laser, which cannot be dimmed; leave that fault out"
            )
        worlds = {CAMERA: self.world, **self._further_worlds}
        cameras = {name: self._cameras[_serial_of(name)] for name in worlds if _serial_of(name) in self._cameras}
        gauges = {name: line for name, line in self._gauges.items() if line is not None}
        lines = {**self.lines, **{name: unit.line for name, unit in self._units.items()}, **gauges}
        struck = Struck(lines, stages, cameras, worlds, self._units)
        return WatchedWorld(struck, self.clock, table.schedule)

    def _further(
        self,
        bench: Bench,
        name: str,
        table: SimulationTable,
        stages: SimulatedStages,
        exposures_before: int,
        folder: Path,
    ) -> CameraSection:
        """A further camera: eyes of its own in the same world, the same light, behind the same glass."""
        beside = bench.as_seen_by(name)
        beside = beside.with_scene(replace(bench.scene, camera=beside.scene.camera))
        own = table.cameras.get(name, FurtherCameraTable())
        its = table.model_copy(update={"aperture": own.aperture, "ring": None, "faults": own.faults})
        noise_seed = table.seed + crc32(name.encode())
        world = World(beside, its, stages, self._shows, exposures_before, self.world, noise_seed)
        config = _config_of(name, beside, its, exposures_before, own.clock_ppm)
        own_folder = folder / name
        own_folder.mkdir()
        self._further_worlds[name] = world
        return self._behind_transport(beside, config, world, own_folder)

    def _behind_transport(self, bench: Bench, config: CameraConfig, world: World, folder: Path) -> CameraSection:
        """Let a camera see a world; return how it is opened."""
        if self._in_memory:
            return _section_with(
                bench, CAMERA_HERE, device=self._stack.enter_context(self._power_camera(config, world))
            )
        config = replace(config, wires=str(self._wires.path))
        if config.source == CameraConfig().source:
            server = FrameServer(world, folder, config.width, config.height)
            self._stack.callback(server.close)
            config = replace(config, source="sim.camera.remote:RemoteSource", source_arguments=server.arguments())
        if bench.table.camera.backend == "micromanager":
            (folder / CONFIG).write_text(config.to_json())
            core = f"{SimCore.__module__}:{SimCore.__name__}"
            options = {"library": "SimCamera", "device": "Sim", "adapters": str(folder), "core": core}
            return _section_with(bench, "micromanager", **options)
        if bench.table.camera.backend == "aravis":
            return _section_with(bench, "aravis", address=self._stack.enter_context(device_process(config)))
        cti = str(write_producer(folder / "bench.cti", [config]))
        return _section_with(bench, "harvesters", cti=cti, serial=config.serial)

    @contextmanager
    def _power_camera(self, config: CameraConfig, world: World) -> Iterator[str]:
        """Give a camera in this process power; yield its name."""
        name = f"{config.serial}-{id(self):x}"
        sees_world = config.source == CameraConfig().source
        DEVICES[name] = device = SimCamera(config, world if sees_world else None)
        self._cameras[config.serial] = device
        self._wires.lead_to(device.line_pulse)
        try:
            yield name
        finally:
            del DEVICES[name]
            device.power_off()

    def _camera(self, bench: Bench, table: SimulationTable, exposures_before: int, folder: Path) -> CameraSection:
        config = _config_of(CAMERA, bench, table, exposures_before)
        if table.ring is not None:
            ring = bench.path.parent / table.ring
            if not list(ring.glob("*.npy")):
                raise SceneError(f"{bench.path}: simulation.ring: {ring} holds no .npy frames")
            arguments = {"folder": str(ring), "first": exposures_before}
            config = replace(config, source="sim.camera.source:RingSource", source_arguments=arguments)
        return self._behind_transport(bench, config, self.world, folder)


def _serial_of(camera: str) -> str:
    """Serial number of a simulated camera."""
    return SERIAL if camera == CAMERA else f"{SERIAL}-{camera}"


def _config_of(
    name: str, bench: Bench, table: SimulationTable, exposures_before: int, clock_ppm: float = 0.0
) -> CameraConfig:
    """Configuration of a camera that draws what its world shows."""
    size, faults = bench.scene.camera.sensor_px, fault_plan(table.faults, exposures_before)
    serial, row_time_us = _serial_of(name), table.row_time_us
    return CameraConfig(*size, serial=serial, row_time_us=row_time_us, clock_ppm=clock_ppm, faults=faults)


def _any_box(stages: StagesTable) -> StagesTable:
    """Return the same stages with any box accepted: simulated ones have other serial numbers than yours."""
    controllers = {name: table.model_copy(update={"identity": None}) for name, table in stages.controllers.items()}
    return stages.model_copy(update={"controllers": controllers})


def _section_with(bench: Bench, backend: str, **options: str) -> CameraSection:
    return bench.table.camera.model_copy(update={"backend": backend, "options": options})
