"""The `simulation` section of a bench file.

simulation:
bench: "sim.bench:SimulatedBench"
seed: 7                       # of misalignment, prints and noise
transport: memory             # sim:// in this process, time runs as fast as it can; or pty: device files
camera_transport: genicam     # what the camera's backend speaks (Linux, x86-64); or memory: in this process
speed: 20.0                   # of the world's clock on ptys
is_misaligned: true
samples: 4                    # rays across a pixel
axes:                         # what the workshop built; the firmware's zero is its low switch
rail_z: {lead_mm: 5.0, steps_per_rev: 1600, travel_mm: 300.0, backlash_um: 50.0, lead_error_um: 1.0}
firmware: {portal: {"23": 0}} # Grbl's $23: home towards the high switches
prints_truth: true            # optional: a corner of every frame says what it shows; see frame_truth.py
ring: frames/                 # optional: replay .npy frames instead of rendering
aperture: {f_mm: 60.0, f_number: 2.8, focus_mm: 500.0}    # optional: a pupil, sharp so far ahead of the camera;
                              # sensor_tilt_deg: [0.0, 6.8] tilts the sensor against that lens, as in a scene file
blur_px: 0.5                  # of lens and pixel
uneven_light: 0.03            # brighter to the right and darker to the left by this share
hand: {reads_um: 3.0, division_um: 10.0}    # who turns axes without a motor; see sim.emulators.by_hand
glass_off_mm: [1.2, -0.8, 0.5]    # how the glass was put up, beside its place in the scene file
flow: {field: jet}            # what flow runs see; see sim.flow.table
faults: {lost_at: 7, back_after_s: 0.5}     # optional, of the camera; see sim.camera.config
cameras: {behind: {aperture: {...}, faults: {...}, clock_ppm: 20.0}}    # optional, of further cameras

A rehearsal (daq.bench.rehearsal) says `schedule` and `keeps` beside them.
"""

import math
import platform
import sys
from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from daq.bench.bench_table import Bench
from daq.bench.fault_table import Fault
from ground.config import Document, Name, Table, validate
from ground.plain_words import exactly
from sim.camera.config import FaultPlan
from sim.flow.table import FlowTable
from sim.frame_truth import WIDTH_PX, height_px
from sim.renderer.render import Aperture
from sim.stages import ScrewTable
from tracer.errors import SceneError
from tracer.scene.scene_tables import SensorTilt

HAS_GENICAM = sys.platform == "linux" and platform.machine() == "x86_64"  # what `sim.camera.gentl.elf` writes


class FaultsTable(Table):
    """Scheduled faults of the camera, by frame number since the world began."""

    incomplete: list[int] = Field(default_factory=list)
    dropped: list[int] = Field(default_factory=list)
    skipped: list[int] = Field(default_factory=list)
    doubled: list[int] = Field(default_factory=list)
    first_skipped: Annotated[int, Field(ge=0, le=100)] = 0
    late_s: dict[str, float] = Field(default_factory=dict)
    lost_at: int | None = None
    back_after_s: float | None = None
    reset_at: int | None = None


class ApertureTable(Table):
    """The pupil of the camera's lens; without it the camera is a pinhole."""

    f_mm: Annotated[float, Field(gt=0.0)]
    f_number: Annotated[float, Field(gt=0.0)]
    focus_mm: Annotated[float, Field(gt=0.0)]
    sensor_tilt_deg: Annotated[list[SensorTilt], Field(min_length=2, max_length=2), exactly(2)] | None = None


class FurtherCameraTable(Table):
    """Settings of a further camera that differ from the section `camera`."""

    aperture: ApertureTable | None = None
    faults: FaultsTable = FaultsTable()
    clock_ppm: Annotated[float, Field(ge=-1000.0, le=1000.0)] = 0.0


class HandErrorsTable(Table):
    """Reading errors of the person who turns the axes without a motor."""

    reads_um: Annotated[float, Field(ge=0.0, le=1000.0)] = 3.0
    division_um: Annotated[float, Field(gt=0.0, le=1000.0)] = 10.0


class SynchroniserTable(Table):
    """A synchroniser of another program, which triggers camera and laser all the time."""

    rate_hz: Annotated[float, Field(gt=0.0, le=1000.0)]
    dt_us: Annotated[float, Field(gt=0.0, le=1e6)]


class SimulationTable(Table):
    """The `simulation` section of a bench file."""

    bench: str
    seed: Annotated[int, Field(ge=0, le=2**31)] = 7
    transport: Literal["memory", "pty"] = "memory"
    camera_transport: Literal["genicam", "memory"] = "genicam" if HAS_GENICAM else "memory"
    speed: Annotated[float, Field(gt=0.0, le=1000.0)] = 20.0
    is_misaligned: bool = True
    samples: Annotated[int, Field(ge=1, le=16)] = 4
    row_time_us: Annotated[float, Field(ge=0.0, le=1000.0)] = 5.0
    axes: dict[Name, ScrewTable]
    firmware: dict[Name, dict[str, float]] = Field(default_factory=dict)  # Grbl's $ settings, by controller
    prints_truth: bool = False
    ring: str | None = None
    aperture: ApertureTable | None = None
    blur_px: Annotated[float, Field(ge=0.0, le=50.0)] = 0.5
    uneven_light: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    glass_off_mm: Annotated[
        list[Annotated[float, Field(ge=-100.0, le=100.0)]], Field(min_length=3, max_length=3)
    ] = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    hand: HandErrorsTable = HandErrorsTable()
    flow: FlowTable = FlowTable()
    synchroniser: SynchroniserTable | None = None
    faults: FaultsTable = FaultsTable()
    cameras: dict[Name, FurtherCameraTable] = Field(default_factory=dict)
    schedule: list[Fault] = Field(default_factory=list)  # of a rehearsal: what goes wrong, and when
    keeps: bool = False  # of a rehearsal: whether what happens is kept

    @property
    def pupil(self) -> Aperture | None:
        """The lens; None for a pinhole."""
        lens = self.aperture
        if lens is None:
            return None
        tilt_x, tilt_y = map(math.radians, lens.sensor_tilt_deg or (0.0, 0.0))
        return Aperture(lens.f_mm, lens.f_number, lens.focus_mm, (tilt_x, tilt_y))


def simulation_of(bench: Bench) -> SimulationTable:
    """Read and check the section of a bench file.

    Raises
    ------
    ConfigError, SceneError
        The section is wrong.
    """
    lines = {place[1:]: line for place, line in bench.document.lines.items() if place[:1] == ("simulation",)}
    table = validate(Document(bench.path, dict(bench.table.simulation or {}), lines), SimulationTable)
    missing = [name for name in bench.table.stages.axes if name not in table.axes]
    if missing:
        raise SceneError(f"{bench.path}: simulation.axes does not describe {', '.join(missing)}")
    if strange := sorted(set(table.cameras) - set(bench.cameras)):
        raise SceneError(f"{bench.path}: simulation.cameras: the bench has no further camera {', '.join(strange)}")
    if table.prints_truth and table.ring is not None:
        raise SceneError(f"{bench.path}: simulation: frames of a ring cannot print their truth; leave one out")
    if table.schedule and not table.keeps:
        raise SceneError(f"{bench.path}: simulation: events of a schedule are kept; set keeps: true as well")
    if table.keeps and (table.transport, table.camera_transport) != ("memory", "memory"):
        raise SceneError(f"{bench.path}: simulation.keeps: say transport and camera_transport: memory as well")
    width, height = bench.scene.camera.sensor_px
    rows = height_px(len(bench.table.stages.axes))
    if table.prints_truth and (width < WIDTH_PX or height < rows):
        raise SceneError(
            f"{bench.path}: simulation.prints_truth needs a sensor of {WIDTH_PX} x {rows} px at least"
        )
    return table


def settings_by_number(settings: Mapping[str, float]) -> dict[int, float]:
    """Return settings of a firmware that numbers them."""
    return {int(number): value for number, value in settings.items()}


def fault_plan(table: FaultsTable, exposures_before: int) -> FaultPlan:
    """Faults in the camera's own count, which begins with this process; what lies behind is over."""
    given = table.model_dump()
    for name in ("incomplete", "dropped", "skipped", "doubled"):
        given[name] = tuple(n - exposures_before for n in given[name] if n >= exposures_before)
    for name in ("lost_at", "reset_at"):
        is_over = given[name] is None or given[name] < exposures_before
        given[name] = None if is_over else given[name] - exposures_before
    given["late_s"] = {str(int(number) - exposures_before): late_s for number, late_s in table.late_s.items()}
    return FaultPlan(**given)
