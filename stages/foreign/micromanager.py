"""Stages that Micro-Manager knows, some 75 families, through its core in this process (extra `micromanager`).

Channels are labels of its devices: ``Z`` for a single axis, ``XY/x`` and ``XY/y`` for the two of an XY stage.
The core speaks micrometres (`mm_per_unit`), knows no limits, and takes NaN for a position; it has no speeds but
properties of adapters, so the speeds of a bench file only say how long a way takes.

An XY stage is sent both coordinates at once, and an adapter that is sent one keeps its own idea of the other. So
the partner's last target goes with every move; where the partner does not rest on it (a joystick, a restart),
what it reads goes instead, and nothing drives back.

A configuration file may do whatever its author wanted, also move stages on loading; lines that would are refused.
"""

import hashlib
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ground.named_program import import_program
from stages.controller_tables import AdapterTable, ForeignTable, MicroManagerTable
from stages.errors import PortUnavailable, StageUsageError, WrongDevice
from stages.foreign.calls import first_line
from stages.foreign.foreign_controller import ForeignController

STAGE, XY_STAGE = 5, 6  # the core's types of devices
MAX_CONFIG_BYTES = 1_000_000
MOVES = re.compile(r"^(Property,[^,]*|ConfigGroup,System,Startup,[^,]*),Position,", re.MULTILINE)


class MicroManager(ForeignController):
    """One core with its devices."""

    library = "Micro-Manager"

    _core: Any = None
    _mm_per_unit = 0.001
    _sent: dict[str, dict[str, float]]  # last targets of XY stages [mm]

    def channels_homed_with(self, channel: str) -> frozenset[str]:
        """Both axes of an XY stage are homed by one command."""
        label, axis = _label_and_axis(channel)
        pair = {f"{label}/x", f"{label}/y"} & set(self._channels)
        return frozenset(pair if axis and not self._homed_by_hand else {channel})

    def _load(self, table: ForeignTable) -> str:
        assert isinstance(table, MicroManagerTable)
        core = self._core = _class_of(table.core)()
        self._mm_per_unit, self._sent = table.mm_per_unit, {}
        if table.adapters is not None:
            core.setDeviceAdapterSearchPaths([table.adapters])
        parts = []
        if table.config is not None:
            parts.append(_load_file(core, Path(table.config)))
        else:
            _load_devices(core, table.devices)
        for label in dict.fromkeys(_label_and_axis(channel)[0] for channel in self._channels):
            pair = {(label, "x"), (label, "y")} & {_label_and_axis(channel) for channel in self._channels}
            parts.append(self._describe(label, XY_STAGE if pair else STAGE))
        return ", ".join(parts)

    def _describe(self, label: str, wanted: int) -> str:
        if label not in self._core.getLoadedDevices():
            raise WrongDevice(f"{self.name}: there is no device {label!r} in the loaded configuration")
        if int(self._core.getDeviceType(label)) != wanted:
            kind = {STAGE: "a stage of one axis", XY_STAGE: "an XY stage"}[wanted]
            raise WrongDevice(
                f"{self.name}: device {label!r} is not {kind}; use LABEL, or LABEL/x and LABEL/y of a pair"
            )
        return f"{label}: {self._core.getDeviceLibrary(label)} {self._core.getDeviceName(label)}"

    def _unload(self) -> None:
        if self._core is not None:
            self._core.unloadAllDevices()

    def _busy(self, channel: str) -> bool:
        return bool(self._core.deviceBusy(_label_and_axis(channel)[0]))

    def _read_mm(self, channel: str) -> float:
        label, axis = _label_and_axis(channel)
        read = {"x": self._core.getXPosition, "y": self._core.getYPosition, "": self._core.getPosition}[axis]
        return float(read(label)) * self._mm_per_unit

    def _send(self, channel: str, target_mm: float) -> None:
        label, axis = _label_and_axis(channel)
        if not axis:
            self._core.setPosition(label, target_mm / self._mm_per_unit)
            return
        targets = self._sent.setdefault(label, {})
        partner = "y" if axis == "x" else "x"
        partner_mm = self._read_mm(f"{label}/{partner}")
        if not math.isfinite(partner_mm):
            raise StageUsageError(f"{label}/{partner} reads {partner_mm}; nothing was sent")
        noise_mm = self.noise_mm(channel)
        if abs(targets.get(partner, math.inf) - partner_mm) > noise_mm:
            rests_mm = self._rests_mm.get(f"{label}/{partner}", math.inf)
            # does it hunt?
            targets[partner] = rests_mm if abs(rests_mm - partner_mm) <= noise_mm else partner_mm
        targets[axis] = target_mm
        self._core.setXYPosition(label, targets["x"] / self._mm_per_unit, targets["y"] / self._mm_per_unit)

    def _seek(self, channel: str) -> None:
        label = _label_and_axis(channel)[0]
        self._sent.pop(label, None)
        self._core.home(label)

    def _halt(self) -> str:
        said = []
        for label in dict.fromkeys(_label_and_axis(channel)[0] for channel in self._channels):
            try:
                self._core.stop(label)
            except Exception as error:  # whatever one says, the others are stopped
                said.append(first_line(error))
        return "; ".join(said)


def _label_and_axis(channel: str) -> tuple[str, str]:
    """Label and axis of a channel; no axis for a stage that has one only."""
    label, slash, axis = channel.rpartition("/")
    return (label, axis) if slash and axis in ("x", "y") else (channel, "")


def _class_of(dotted: str) -> Any:  # noqa: ANN401 - third-party
    try:
        return import_program(dotted)
    except (ImportError, AttributeError) as error:
        raise PortUnavailable(f"{dotted} cannot be imported ({error}); install rtpiv[micromanager]") from error


def _load_devices(core: Any, devices: Mapping[str, AdapterTable]) -> None:  # noqa: ANN401
    """Load and initialise devices; properties that are asked for before are set before."""
    for label, device in devices.items():
        try:
            core.loadDevice(label, device.library, device.device)
        except Exception as error:
            raise PortUnavailable(
                f"{label}: {first_line(error)}; is the adapter in the folder `adapters`, for version "
                f"{core.getAPIVersionInfo()}?"
            ) from error
    late = []
    for label, device in devices.items():
        if device.parent is not None:
            core.setParentLabel(label, device.parent)
        for name, value in device.properties.items():
            text = str(int(value)) if isinstance(value, bool) else value
            if core.hasProperty(label, name) and core.isPropertyPreInit(label, name):
                core.setProperty(label, name, text)
            else:
                late.append((label, name, text))
    core.initializeAllDevices()
    for label, name, text in late:
        core.setProperty(label, name, text)


def _load_file(core: Any, path: Path) -> str:  # noqa: ANN401
    """Load a configuration file; return its name and what tells it from another."""
    try:
        data = path.read_bytes()[: MAX_CONFIG_BYTES + 1]
    except OSError as error:
        raise PortUnavailable(f"{path}: cannot be read ({error.strerror})") from error
    if len(data) > MAX_CONFIG_BYTES:
        raise PortUnavailable(f"{path}: larger than any configuration, {MAX_CONFIG_BYTES} bytes")
    text = data.decode("utf-8", "replace")
    if found := MOVES.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise StageUsageError(f"{path}:{line}: opening must not move anything; remove this line: {found[0]}...")
    core.loadSystemConfiguration(str(path))
    return f"{path.name} {hashlib.sha256(data).hexdigest()[:8]}"
