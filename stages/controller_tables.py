"""Section of a bench file for one controller: its connection. See `stages.config` for the whole.

On a serial port:

    rail: {driver: isel_dnc, port: /dev/ttyUSB0}

Moved by Micro-Manager's core, with devices as its configurator names them; channels are `Z`, or `XY/x` and `XY/y`:

    glass:
      driver: micromanager
      adapters: /usr/lib/micro-manager     # folder of the adapter libraries
      homing: hand                         # or `device`: its library can look for the reference
      devices:                             # loaded in this order; or `config: glass.cfg`, beside this file
        port: {library: SerialManager, device: /dev/ttyUSB0, properties: {BaudRate: "9600"}}
        XY: {library: Marzhauser, device: XYStage, properties: {Port: port}}

Moved by objects with ``set``, ``stop`` and ``position``, as Bluesky's; channels are the names under `objects`:

    target:
      driver: positioners
      homing: device                       # they have a ``home()`` that ends at the reference
      objects:
        x: {object: "ophyd:EpicsMotor", arguments: {prefix: "LAB:m1", name: x}}

Turned by a person, who is asked to and says what the scale reads (`stages.by_hand`); channels are any names:

    hands: {driver: by_hand}
"""

import re
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from ground.config import Table
from ground.named_program import is_installed

Text = Annotated[str, Field(min_length=1)]
Dotted = Annotated[str, Field(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$")]
Value = bool | int | float | str
Scale = Annotated[float, Field(gt=0.0, le=1e6)]


class ControllerTable(Table):
    """A controller on a serial port."""

    driver: str
    port: Text
    baud: Annotated[int, Field(ge=300, le=4_000_000)] | None = None
    identity: Text | None = None
    programs: ClassVar[tuple[str, ...]] = ()  # what is called by the name in the file, beside the driver

    @property
    def place(self) -> str:
        """Location, for messages."""
        return self.port


class ForeignTable(Table):
    """A controller that is a library."""

    homing: Literal["device", "hand"]
    home_mm: Annotated[float, Field(ge=-1e6, le=1e6)] = 0.0  # what it reads at the reference that it has found
    # longest call; of a library that waits: longest way
    call_s: Annotated[float, Field(gt=0.0, le=600.0)] = 5.0
    identity: Text | None = None

    @property
    def place(self) -> str:
        """Location, for messages."""
        return "a library"

    def beside(self, folder: Path) -> "ForeignTable":
        """Return the same with files found in the folder of the bench file."""
        return self

    def problem(self, channels: set[str]) -> str | None:
        """Return a message on a channel of an axis that this controller does not have, or None."""
        return None

    @property
    def programs(self) -> tuple[str, ...]:
        """Programs that the file names."""
        return ()

    def lacks(self) -> str | None:
        """Return what this computer lacks for it, as far as can be seen without loading anything, or None."""
        return None


class AdapterTable(Table):
    """One device of Micro-Manager: adapter library, device in it, properties."""

    library: Text
    device: Text
    parent: Text | None = None
    properties: dict[Text, Value] = Field(default_factory=dict)


class MicroManagerTable(ForeignTable):
    """Stages moved by Micro-Manager's core."""

    driver: Literal["micromanager"]
    adapters: Text | None = None
    config: Text | None = None
    devices: dict[Text, AdapterTable] = Field(default_factory=dict)
    mm_per_unit: Scale = 0.001  # the core speaks micrometres
    core: Dotted = "pymmcore:CMMCore"

    @model_validator(mode="after")
    def _makes_sense(self) -> "MicroManagerTable":
        if (self.config is None) == (not self.devices):
            raise ValueError("set either devices or config, a file of Micro-Manager's configurator")
        if self.config is not None:
            path = PurePosixPath(self.config)
            if path.is_absolute() or ".." in path.parts or "\\" in self.config:
                raise ValueError(f"config {self.config!r} must be in the folder of the bench file")
        for label, device in self.devices.items():
            if not re.fullmatch(r"[^,/]{1,60}", label) or label == "Core":
                raise ValueError(f"device {label!r}: a label has no comma, no slash, and is not Core")
            if "Position" in device.properties:
                raise ValueError(f"device {label!r}: opening must not move anything; remove its Position")
            if device.parent is not None and device.parent not in self.devices:
                raise ValueError(f"device {label!r}: there is no device {device.parent!r}")
        return self

    @property
    def place(self) -> str:
        """Location, for messages."""
        return self.config or " and ".join(dict.fromkeys(device.library for device in self.devices.values()))

    def beside(self, folder: Path) -> "MicroManagerTable":
        """Return the same with the configuration found."""
        return self if self.config is None else self.model_copy(update={"config": str(folder / self.config)})

    def problem(self, channels: set[str]) -> str | None:
        """Say which channel is no device."""
        for channel in sorted(channels):
            label = channel.removesuffix("/x").removesuffix("/y")
            if "/" in label or (self.devices and label not in self.devices):
                known = ", ".join(self.devices)
                return f"channel {channel!r} is no device; there are {known}, or LABEL/x and LABEL/y of a pair"
        return None

    @property
    def programs(self) -> tuple[str, ...]:
        """The core."""
        return (self.core,)

    def lacks(self) -> str | None:
        """The core, the folder of adapters, the configuration file."""
        if not is_installed(self.core):
            return f"{self.core} is not installed; install the extra rtpiv[micromanager]"
        if self.adapters is not None and not Path(self.adapters).is_dir():
            return f"adapters: there is no folder {self.adapters}"
        if self.config is not None and not Path(self.config).is_file():
            return f"config: there is no file {self.config}"
        return None


class PositionerTable(Table):
    """One object that moves: its class, and what it is made with."""

    object: Dotted
    arguments: dict[Text, Value | None] = Field(default_factory=dict)
    mm_per_unit: Scale = 1.0


class PositionersTable(ForeignTable):
    """Objects with ``set``, ``stop`` and ``position``."""

    driver: Literal["positioners"]
    objects: Annotated[dict[Text, PositionerTable], Field(min_length=1)]

    @property
    def place(self) -> str:
        """Location, for messages."""
        return " and ".join(dict.fromkeys(one.object for one in self.objects.values()))

    def problem(self, channels: set[str]) -> str | None:
        """Say which channel is no object."""
        if strange := sorted(channels - set(self.objects)):
            return f"channel {strange[0]!r} is not one of the objects; there are {', '.join(self.objects)}"
        return None

    @property
    def programs(self) -> tuple[str, ...]:
        """Programs that make the objects."""
        return tuple(one.object for one in self.objects.values())

    def lacks(self) -> str | None:
        """The packages of the objects."""
        for one in self.objects.values():
            if not is_installed(one.object):
                return f"{one.object} is not installed here"
        return None


class HandTable(Table):
    """A person who turns screws."""

    driver: Literal["by_hand"]
    identity: None = None
    place: ClassVar[str] = "a person at the terminal"  # for messages
    programs: ClassVar[tuple[str, ...]] = ()


def _kind(said: Any) -> str:  # noqa: ANN401 - whatever a file holds
    """Return the kind of table that a section is."""
    driver = said.get("driver") if isinstance(said, dict) else getattr(said, "driver", None)
    return driver if driver in ("micromanager", "positioners", "by_hand") else "serial"


AnyControllerTable = Annotated[
    Annotated[ControllerTable, Tag("serial")]
    | Annotated[MicroManagerTable, Tag("micromanager")]
    | Annotated[PositionersTable, Tag("positioners")]
    | Annotated[HandTable, Tag("by_hand")],
    Discriminator(_kind),
]
