"""The simulated bench: emulators behind serial lines, a camera behind its transport, one world behind both.

The world knows three elements: camera, glass, target.  Motors carry them, with play, lead error and whole steps,
so an element stands where its screw has really brought it, not where a controller says.  The camera's pictures are
rendered at these TRUE places, with a camera, glass and aim that are all a little off the scene file (`misaligned`,
by the seed): what a bench does to an experimenter.  The target's plane is z = 0 of the scene.  The camera stands
behind a GenTL producer; if the bench file's backend is `aravis`, it is a GigE Vision device on the loopback.

    simulation:
      bench: "sim.bench:SimulatedBench"
      seed: 7                       # of misalignment, prints and noise
      transport: memory             # sim:// in this process, time runs as fast as it can; or pty: device files
      speed: 20.0                   # of the world's clock on ptys
      is_misaligned: true
      samples: 4                    # rays across a pixel
      axes:                         # what the workshop built; the firmware's zero is its low switch
        rail_z: {lead_mm: 5.0, steps_per_rev: 1600, travel_mm: 300.0, backlash_um: 50.0, lead_error_um: 1.0}
      firmware: {portal: {"23": 0}} # Grbl's $23: home towards the high switches
      prints_truth: true            # optional: a corner of every frame says what it shows; see frame_truth.py
      ring: frames/                 # optional: replay .npy frames instead of rendering
      faults: {lost_at: 7, back_after_s: 0.5}     # optional, of the camera; see sim.camera.faults
"""

import shutil
import tempfile
import threading
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from daq.acquisition.bench.bench_file import Bench, CameraSection
from ground.config import Document, Table, validate
from sim.camera.config import CameraConfig
from sim.camera.faults import FaultPlan
from sim.camera.gentl import write_producer
from sim.camera.gige.process import device_process
from sim.camera.remote import FrameServer
from sim.clock import ScaledClock, VirtualClock
from sim.demo.scenes import misaligned
from sim.prints.frame_truth import WIDTH_PX, FrameTruth, height_px, with_truth
from sim.prints.patterns import Chessboard, ParticleSheet, Pose, placed, printed_particles
from sim.renderer.render import render_irradiance
from sim.renderer.sensor import Sensor
from sim.stages import ScrewTable, SimulatedStages
from stages.config import Name
from tracer.bodies import shifted_by
from tracer.errors import SceneError
from tracer.scene import Scene
from tracer.scene_file import dump_scene

PRINT_MARGIN = 1.5  # glass looks past the edge of the bare view
KEPT_VIEWS = 4
SERIAL = "SIM-BENCH"


class FaultsTable(Table):
    """Scheduled faults of the camera, by frame number since the world began."""

    incomplete: list[int] = Field(default_factory=list)
    dropped: list[int] = Field(default_factory=list)
    late_s: dict[str, float] = Field(default_factory=dict)
    lost_at: int | None = None
    back_after_s: float | None = None
    reset_at: int | None = None


class SimulationTable(Table):
    """The `simulation` section of a bench file."""

    bench: str
    seed: Annotated[int, Field(ge=0, le=2**31)] = 7
    transport: Literal["memory", "pty"] = "memory"
    speed: Annotated[float, Field(gt=0.0, le=1000.0)] = 20.0
    is_misaligned: bool = True
    samples: Annotated[int, Field(ge=1, le=16)] = 4
    row_time_us: Annotated[float, Field(ge=0.0, le=1000.0)] = 5.0
    axes: dict[Name, ScrewTable]
    firmware: dict[Name, dict[str, float]] = Field(default_factory=dict)  # Grbl's $ settings, by controller
    prints_truth: bool = False
    ring: str | None = None
    faults: FaultsTable = FaultsTable()


class World:
    """Where everything really is, and what a sensor would see of it; a `FrameSource`.

    Parameters
    ----------
    bench : Bench
        Nominal scene, and which axis carries what.
    table : SimulationTable
        Seed and screws.
    stages : SimulatedStages
        Every axis.
    shows : str
        What hangs on the target's stage.
    exposures_before : int
        Exposures made before this process began.
    """

    def __init__(
        self,
        bench: Bench,
        table: SimulationTable,
        stages: SimulatedStages,
        shows: str,
        exposures_before: int,
    ) -> None:
        self._bench = bench
        self._table = table
        self._stages = stages
        self._exposures = exposures_before
        self.scene = misaligned(bench.scene, table.seed) if table.is_misaligned else bench.scene
        self._print = _print_of(bench, table.seed, shows)
        self._sensor = Sensor()
        self._views: dict[tuple[float, ...], NDArray[np.float32]] = {}
        self._lock = threading.Lock()

    def true_mm(self) -> dict[str, float]:
        """Where every axis really is, in its own coordinate."""
        return {name: self._stages.true_mm(name) for name in self._bench.table.stages.axes}

    def frame(self, trigger_index: int, time_ns: int) -> NDArray[np.uint16]:
        """One exposure of the world as it stands (H, W) uint16."""
        with self._lock:
            true_mm = self.true_mm()
            light = self._light(true_mm)
            number, self._exposures = self._exposures, self._exposures + 1
            image = self._sensor.expose(light, seed=self._table.seed * 1_000_003 + number)
            if not self._table.prints_truth:
                return image
            truth = FrameTruth(trigger_index, number, true_mm, self._stages.is_moving)
            return with_truth(image, truth, self._sensor.bits)

    def _light(self, true_mm: Mapping[str, float]) -> NDArray[np.float32]:
        key = tuple(true_mm.values())
        if key not in self._views:
            while len(self._views) >= KEPT_VIEWS:
                self._views.pop(next(iter(self._views)))
            scene, pattern = self._arranged(true_mm)
            self._views[key] = render_irradiance(
                scene, pattern, samples=self._table.samples, seed=self._table.seed
            )
        return self._views[key]

    def _arranged(self, true_mm: Mapping[str, float]) -> tuple[Scene, Chessboard | ParticleSheet]:
        """Scene and print at the true places of their carriages."""
        ways = {"camera": np.zeros(3), "glass": np.zeros(3), "target": np.zeros(3)}
        for name, axis in self._bench.table.stages.axes.items():
            ways[axis.carries]["xyz".index(axis.along)] += true_mm[name] - self._bench.home_mm[name]
        camera = self.scene.camera
        x, y, z = (float(c) for c in np.add(camera.position_mm, ways["camera"]))
        bodies = tuple(body.moved(shifted_by(ways["glass"])) for body in self.scene.bodies)
        scene = replace(self.scene, camera=replace(camera, position_mm=(x, y, z)), bodies=bodies)
        pose = Pose().moved(*(float(way) for way in ways["target"]))
        if isinstance(self._print, Chessboard):
            return scene, placed(self._print, pose)
        return scene, placed(self._print, pose)


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

    def __init__(self, bench: Bench, shows: str = "chessboard", exposures_before: int = 0) -> None:
        table = _section(bench)
        pty = table.transport == "pty"
        self.clock: ScaledClock | VirtualClock = ScaledClock(table.speed) if pty else VirtualClock()
        self._stack = ExitStack()
        try:
            options = {name: {"settings": _numbered(settings)} for name, settings in table.firmware.items()}
            stages = SimulatedStages(bench.table.stages, self.clock, table.axes, options)
            self.lines, self.witness = stages.lines, stages.witness
            if bench.table.keep_out is not None:
                stages.witness.look_at(bench.scene, bench.table.keep_out, bench.table.stages, bench.home_mm)
            self.stages = self._stack.enter_context(stages.serve() if pty else stages.put_up())
            self.world = World(bench, table, stages, shows, exposures_before)
            self.camera = self._camera(bench, table, exposures_before)
        except BaseException:
            self._stack.close()
            raise

    def true_mm(self) -> dict[str, float]:
        """Where every axis really is, in its own coordinate."""
        return self.world.true_mm()

    def secrets(self) -> dict[str, str]:
        """The true scene, to score a run by."""
        return {"truth.yaml": dump_scene(self.world.scene)}

    def close(self) -> None:
        """Take everything down."""
        self.witness.judge()
        self._stack.close()

    def _camera(self, bench: Bench, table: SimulationTable, exposures_before: int) -> CameraSection:
        folder = Path(tempfile.mkdtemp(prefix="rtpiv-"))
        self._stack.callback(shutil.rmtree, folder, ignore_errors=True)
        width, height = bench.scene.camera.sensor_px
        faults = _faults(table.faults, exposures_before)
        config = CameraConfig(width, height, serial=SERIAL, row_time_us=table.row_time_us, faults=faults)
        if table.ring is not None:
            ring = bench.path.parent / table.ring
            if not list(ring.glob("*.npy")):
                raise SceneError(f"{bench.path}: simulation.ring: {ring} holds no .npy frames")
            arguments = {"folder": str(ring), "first": exposures_before}
            config = replace(config, source="sim.camera.source:RingSource", source_arguments=arguments)
        else:
            server = FrameServer(self.world, folder, width, height)
            self._stack.callback(server.close)
            config = replace(config, source="sim.camera.remote:RemoteSource", source_arguments=server.arguments())
        if bench.table.camera.backend == "aravis":
            return _section_with(bench, "aravis", address=self._stack.enter_context(device_process(config)))
        return _section_with(
            bench, "harvesters", cti=str(write_producer(folder / "bench.cti", [config])), serial=SERIAL
        )


def _section_with(bench: Bench, backend: str, **options: str) -> CameraSection:
    return bench.table.camera.model_copy(update={"backend": backend, "options": options})


def _section(bench: Bench) -> SimulationTable:
    lines = {place[1:]: line for place, line in bench.document.lines.items() if place[:1] == ("simulation",)}
    table = validate(Document(bench.path, dict(bench.table.simulation or {}), lines), SimulationTable)
    missing = [name for name in bench.table.stages.axes if name not in table.axes]
    if missing:
        raise SceneError(f"{bench.path}: simulation.axes does not describe {', '.join(missing)}")
    if table.prints_truth and table.ring is not None:
        raise SceneError(f"{bench.path}: simulation: frames of a ring cannot print their truth; leave one out")
    width, height = bench.scene.camera.sensor_px
    rows = height_px(len(bench.table.stages.axes))
    if table.prints_truth and (width < WIDTH_PX or height < rows):
        raise SceneError(
            f"{bench.path}: simulation.prints_truth needs a sensor of {WIDTH_PX} x {rows} px at least"
        )
    return table


def _numbered(settings: Mapping[str, float]) -> dict[int, float]:
    return {int(number): value for number, value in settings.items()}


def _print_of(bench: Bench, seed: int, shows: str) -> Chessboard | ParticleSheet:
    if shows == "chessboard":
        return Chessboard(bench.table.target.square_mm, bench.table.target.disc_mm)
    camera = bench.scene.camera
    px_per_mm = camera.focal_px / float(np.linalg.norm(camera.position_mm))
    width_mm, height_mm = (PRINT_MARGIN * side / px_per_mm for side in camera.sensor_px)
    return printed_particles((width_mm, height_mm), px_per_mm, seed=seed)


def _faults(table: FaultsTable, exposures_before: int) -> FaultPlan:
    """Faults in the camera's own count, which begins with this process; what lies behind is over."""

    def here(number: int) -> int:
        return number - exposures_before

    def one(number: int | None) -> int | None:
        return None if number is None or here(number) < 0 else here(number)

    late: dict[str, Any] = {str(here(int(number))): late_s for number, late_s in table.late_s.items()}
    return FaultPlan(
        incomplete=tuple(here(number) for number in table.incomplete if here(number) >= 0),
        dropped=tuple(here(number) for number in table.dropped if here(number) >= 0),
        late_s=late,
        lost_at=one(table.lost_at),
        back_after_s=table.back_after_s,
        reset_at=one(table.reset_at),
    )
