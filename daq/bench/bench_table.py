"""Contents of a bench file as checked data; `bench_file` describes the file.

Ways of triggering a camera have names (`PRESETS`: what has to be set for each, in SFNC names).  A trigger that is
half set up looks like a broken wire, so a bench file may name one of these instead of four to seven settings.
Whatever is set is read back, and `rtpiv bench camera test` tries it out.

==============  ==============================================================================================
preset          a frame is
==============  ==============================================================================================
free_running    taken by the camera's own clock (AcquisitionFrameRate)
software        asked for by us
edge            begun by a rising edge on `line`, exposed for ExposureTime
falling_edge    the same by a falling edge, as of inverted outputs
pulse_width     exposed as long as `line` is high: the timing unit says the exposure
burst           two of a burst, begun by a rising edge on `line` (shape burst)
==============  ==============================================================================================
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from correction.target import Chessboard
from correction.target.board_file import PrintedBoard
from daq.bench.elements import CAMERA, DIRECTIONS, ELEMENTS, GLASS, Vector
from daq.bench.keep_out import KeepOutTable
from daq.bench.pairs_section import PairsSection
from daq.bench.read_out import require_squares
from daq.cameras.camera import Setting
from daq.cameras.link import LinkName
from daq.errors import PlanError, SettingRefused
from ground.config import Document, Name, Table
from ground.plain_words import slip
from ground.usual import Usual
from stages.config import AxisTable, StagesTable, port_conflicts
from stages.profile import Positive
from tracer.scene.scene import Scene

Preset = Literal["free_running", "software", "edge", "falling_edge", "pulse_width", "burst"]
LINE = "line"  # stands for the input
_EDGE: dict[str, Setting] = {
    "TriggerSelector": "FrameStart",
    "TriggerSource": LINE,
    "TriggerActivation": "RisingEdge",
    "ExposureMode": "Timed",
    "TriggerMode": "On",
}
PRESETS: dict[str, dict[str, Setting]] = {
    "free_running": {"TriggerSelector": "FrameStart", "TriggerMode": "Off"},
    "software": {"TriggerSelector": "FrameStart", "TriggerSource": "Software", "TriggerMode": "On"},
    "edge": _EDGE,
    "falling_edge": {**_EDGE, "TriggerActivation": "FallingEdge"},
    "pulse_width": {**_EDGE, "TriggerActivation": "LevelHigh", "ExposureMode": "TriggerWidth"},
    "burst": {**_EDGE, "TriggerSelector": "FrameBurstStart", "AcquisitionBurstFrameCount": 2},
}


def needs_line(preset: Preset) -> bool:
    """Return whether a preset depends on an input line."""
    return LINE in PRESETS[preset].values()


def settings_of(preset: Preset, line: str | None) -> dict[str, Setting]:
    """Return the settings of a preset.

    Parameters
    ----------
    preset : str
        Its name.
    line : str or None
        The input, such as Line1.
    """
    return {name: line if value == LINE and line else value for name, value in PRESETS[preset].items()}


STAGES = "stages"  # beside CAMERA a device that every bench has

ChunkName = Annotated[str, Field(pattern="^[A-Za-z][A-Za-z0-9_]*$", max_length=64)]


class TriggerSection(Table):
    """Trigger of a camera, by the name of a preset."""

    preset: Preset
    line: Annotated[str, Field(min_length=1, max_length=64)] | None = None  # the input, such as Line1

    @model_validator(mode="after")
    def _has_its_line(self) -> "TriggerSection":
        if needs_line(self.preset) != (self.line is not None):
            raise ValueError(f"preset {self.preset} {'needs' if self.line is None else 'has no'} line")
        return self


class CameraSection(Table):
    """A camera and its settings."""

    backend: str
    options: dict[str, bool | int | float | str] = Field(default_factory=dict)
    settings: dict[str, bool | int | float | str] = Field(default_factory=dict)
    trigger: TriggerSection | None = None  # its settings join those above
    buffers: Annotated[int, Field(ge=2, le=1000)] = 24
    # kept of every frame
    chunks: Annotated[list[ChunkName], Field(max_length=32)] = Field(default_factory=list)
    timeout_s: Annotated[Annotated[float, Field(gt=0.0, le=600.0)], Usual(0.6, 120.0)] = 5.0
    retakes: Annotated[int, Field(ge=0, le=100)] = 3  # of a software-triggered frame that did not arrive whole
    back_within_s: Annotated[Annotated[float, Field(ge=0.0, le=3600.0)], Usual(0.0, 180.0)] = (
        20.0  # patience with a camera that was lost
    )
    pairs: PairsSection | None = None  # of double-frame cameras
    scene_shows: Literal["image", "sensor"] = "image"  # which of the two its file says
    link: LinkName | None = None  # the cable, where the camera does not report its speed

    @model_validator(mode="after")
    def _tells_what_it_is_asked(self) -> "CameraSection":
        if self.trigger is not None:
            preset = settings_of(self.trigger.preset, self.trigger.line)
            twice = sorted(name for name, value in preset.items() if self.settings.get(name, value) != value)
            if twice:
                names = ", ".join(twice)
                raise ValueError(f"settings and the preset {self.trigger.preset} disagree about {names}")
            self.settings.update(preset)
        try:
            require_squares(self.settings)
        except SettingRefused as error:
            raise ValueError(str(error)) from None
        if self.backend == "micromanager" and (self.pairs is not None or self.chunks):
            raise ValueError(
                "Micro-Manager reports no time of an exposure, so frames cannot be assigned to light pulses: "
                "remove pairs and chunks and use it for static frames, or open the camera by harvesters or aravis"
            )
        return self


class NamedCameraSection(CameraSection):
    """A further camera, under `devices`: it sees the same plane and glass, from its place or in its focus."""

    scene: Annotated[str, Field(min_length=1)] | None = None  # a file beside the bench file; None: the bench's


class GlassSection(Table):
    """Parking position of the glass for views without it."""

    out_mm: dict[Name, float]
    retract_mm: dict[Name, float] = Field(default_factory=dict)


class TargetSection(Table):
    """The board on the target's stage."""

    square_mm: Positive = 2.5
    disc_mm: Positive = 1.0
    board: Annotated[str, Field(min_length=1)] | None = (
        None  # a board file beside the bench file: what it says holds
    )

    @model_validator(mode="after")
    def _has_one_source(self) -> "TargetSection":
        if self.board is not None and (more := self.model_fields_set - {"board"}):
            raise ValueError(f"the board file contains its sizes; remove {', '.join(sorted(more))}")
        return self


class BenchTable(Table):
    """A whole bench file."""

    name: Name
    scene: Annotated[str, Field(min_length=1)]
    scene_at_mm: dict[Name, float] = Field(default_factory=dict)
    stages: StagesTable
    glass: GlassSection | None = None
    camera: CameraSection
    devices: dict[Name, dict[str, Any]] = Field(default_factory=dict)
    target: TargetSection = TargetSection()
    keep_out: KeepOutTable | None = None
    simulation: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> "BenchTable":
        problems = []
        places = {"scene_at_mm": self.scene_at_mm}
        if self.glass is not None:
            places |= {"glass.out_mm": self.glass.out_mm, "glass.retract_mm": self.glass.retract_mm}
        for key, named in places.items():
            for name in named:
                if name not in self.stages.axes:
                    problems.append(f"{key} names an unknown axis {name!r}")
                elif (
                    key.startswith("glass")
                    and not (limits := self.stages.axes[name].limits_mm)[0] <= named[name] <= limits[1]
                ):
                    hint = slip("_mm", named[name], *limits)
                    problems.append(f"{key}: {name} {named[name]:g} mm is outside its limits_mm{hint}")
                elif key.startswith("glass") and self.stages.axes[name].carries != GLASS:
                    problems.append(f"{key}: axis {name!r} does not carry the glass")
        ports = {name: str(getattr(table, "port", "")) for name, table in self.stages.controllers.items()}
        ports |= {name: str(device.get("port") or "") for name, device in self.devices.items()}
        problems += port_conflicts(ports)
        for name in {STAGES, CAMERA} & set(self.devices):
            problems.append(f"devices.{name}: that device has a section of its own; give this one another name")
        for name, axis in self.stages.axes.items():
            if axis.carries not in ELEMENTS:
                problems.append(f"axis {name} carries {axis.carries!r}; known are {', '.join(ELEMENTS)}")
        if problems:
            raise ValueError("; ".join(problems))
        return self

    @property
    def home_mm(self) -> dict[str, float]:
        """Position of every axis at which the scene file holds."""
        return {name: self.scene_at_mm.get(name, 0.0) for name in self.stages.axes}

    def offset_mm(self, element: str, positions_mm: Mapping[str, float]) -> Vector:
        """World displacement of an element from its place in the scene file.

        Parameters
        ----------
        element : str
            camera, glass or target.
        positions_mm : mapping
            Position of every axis.
        """
        home, offset = self.home_mm, dict.fromkeys(DIRECTIONS, 0.0)
        for name, axis in self.axes_of(element).items():
            offset[axis.along] += positions_mm[name] - home[name]
        return (offset["x"], offset["y"], offset["z"])

    def axes_of(self, element: str) -> dict[str, AxisTable]:
        """Axes that carry an element."""
        return {name: axis for name, axis in self.stages.axes.items() if axis.carries == element}


@dataclass(frozen=True)
class Device:
    """One device of a bench file: of which kind it is, and its section."""

    kind: str
    section: Table


@dataclass(frozen=True)
class Bench:
    """A bench as its file describes it; nothing is open.

    Parameters
    ----------
    path : Path
        The file.
    document : Document
        Its contents with line numbers.
    table : BenchTable
        Its contents, checked.
    scene : Scene
        The scene it names.
    more : mapping
        Devices besides stages and camera.
    scenes : mapping
        What further cameras see, by their names, where that is another scene than the bench's.
    printed : PrintedBoard, optional
        The board file it names.
    """

    path: Path
    document: Document
    table: BenchTable
    scene: Scene
    more: Mapping[str, Device] = field(default_factory=dict)
    scenes: Mapping[str, Scene] = field(default_factory=dict)
    printed: PrintedBoard | None = None

    @property
    def board(self) -> Chessboard:
        """Board on the target's stage; BoardError if it cannot be printed."""
        target = self.table.target
        return Chessboard(target.square_mm, target.disc_mm) if self.printed is None else self.printed.board()

    @property
    def cameras(self) -> dict[str, CameraSection]:
        """Every camera by name, that of the section `camera` first."""
        further = {name: d.section for name, d in self.more.items() if isinstance(d.section, CameraSection)}
        return {CAMERA: self.table.camera, **further}

    def as_seen_by(self, name: str) -> "Bench":
        """Return the same bench as one of its cameras sees it: with that one in the section `camera`.

        Raises
        ------
        PlanError
            It has no such camera.
        """
        if name not in self.cameras:
            raise PlanError(f"{self.path}: there is no camera {name!r}; there are {', '.join(self.cameras)}")
        table = self.table.model_copy(update={"camera": self.cameras[name]})
        return replace(self, table=table, scene=self.scenes.get(name, self.scene))

    @property
    def devices(self) -> dict[str, Device]:
        """Every device by name, in the order in which they are opened."""
        known = {STAGES: Device("stage", self.table.stages), CAMERA: Device("camera", self.table.camera)}
        return {**known, **self.more}

    @property
    def home_mm(self) -> dict[str, float]:
        """Position of every axis at which the scene file holds."""
        return self.table.home_mm

    @property
    def has_glass(self) -> bool:
        """True if bodies stand before the plane that can be driven out; a window that stands is none of them."""
        return any(not body.stays for body in self.scene.bodies)

    def content_hash(self) -> str:
        """Hex digest (16 characters) of all that the file says, but for ports and boxes, which may be replaced."""
        tree = self.table.model_dump(exclude_unset=True)  # a newer version may know more keys
        for controller in tree["stages"]["controllers"].values():
            controller.pop("port", None)
            controller.pop("adapters", None)
            controller.pop("identity", None)
        for device in tree.get("devices", {}).values():
            device.pop("port", None)
        if self.printed is not None:
            tree["target"] = self.printed.model_dump(exclude_none=True)
        del tree["scene"]  # its content is hashed by the scene itself, but for what moves with what
        walls = {body.name: body.carried for body in self.scene.bodies if body.room is not None}
        return digest(tree | {"walls": walls} if walls else tree)

    def with_scene(self, scene: Scene) -> "Bench":
        """Return the same bench with a scene that is known better, such as a fitted one."""
        return replace(self, scene=scene)


def digest(tree: Any) -> str:  # noqa: ANN401 - anything JSON can hold
    """Hex digest (16 characters) of plain data, independent of the order of keys."""
    text = json.dumps(tree, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def trigger_is_software(settings: Mapping[str, Setting]) -> bool:
    """True if every frame is asked for by us; otherwise frames come by themselves while the camera is armed."""
    return settings.get("TriggerMode") == "On" and settings.get("TriggerSource") == "Software"
