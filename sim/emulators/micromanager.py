"""Micro-Manager's core, as far as it moves stages, over a simulated box.

The names are those of the real core. Like it, it speaks micrometres, takes any number, and sends both
coordinates of an XY stage at once. `setDeviceAdapterSearchPaths` says which box of the simulated world it is.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager

from sim.emulators.foreign_box import ForeignBox, Wire

STAGE, XY_STAGE = 5, 6


class SimulatedCore:
    """In the place of `pymmcore.CMMCore`."""

    def __init__(self) -> None:
        self._wire: Wire | None = None
        self._labels: dict[str, tuple[str, str]] = {}

    def setDeviceAdapterSearchPaths(self, paths: Sequence[str]) -> None:  # noqa: N802 - the core's names
        """Hang on a box."""
        self._wire = Wire(paths[0])

    def getAPIVersionInfo(self) -> str:  # noqa: N802
        """For messages."""
        return "simulated"

    def loadDevice(self, label: str, library: str, device: str) -> None:  # noqa: N802
        """Note a device."""
        self._labels[label] = (library, device)

    def setParentLabel(self, label: str, parent: str) -> None:  # noqa: N802
        """There are no hubs."""

    def hasProperty(self, label: str, name: str) -> bool:  # noqa: N802
        """There are no properties."""
        return False

    def setProperty(self, label: str, name: str, value: object) -> None:  # noqa: N802
        """Nor are any set."""

    def initializeAllDevices(self) -> None:  # noqa: N802
        """See whether the box answers."""
        with self._box("load"):
            pass

    def getLoadedDevices(self) -> tuple[str, ...]:  # noqa: N802
        """Labels."""
        return (*self._labels, "Core")

    def getDeviceType(self, label: str) -> int:  # noqa: N802
        """Stage, or XY stage."""
        with self._box("load") as box:
            return STAGE if label in box.motors else XY_STAGE

    def getDeviceLibrary(self, label: str) -> str:  # noqa: N802
        """As loaded."""
        return self._labels[label][0]

    def getDeviceName(self, label: str) -> str:  # noqa: N802
        """As loaded."""
        return self._labels[label][1]

    def unloadAllDevices(self) -> None:  # noqa: N802
        """Let go of the box."""
        if self._wire is not None:
            self._wire.close()
        self._labels.clear()

    def deviceBusy(self, label: str) -> bool:  # noqa: N802
        """Return whether anything of a device moves, as the box says."""
        with self._box("busy") as box:
            return any(box.busy(channel) for channel in _channels(box, label))

    def getPosition(self, label: str) -> float:  # noqa: N802
        """In micrometres."""
        with self._box("read") as box:
            return box.position_mm(label) * 1e3

    def getXPosition(self, label: str) -> float:  # noqa: N802
        """In micrometres."""
        with self._box("read") as box:
            return box.position_mm(f"{label}/x") * 1e3 if f"{label}/x" in box.motors else 0.0

    def getYPosition(self, label: str) -> float:  # noqa: N802
        """In micrometres."""
        with self._box("read") as box:
            return box.position_mm(f"{label}/y") * 1e3 if f"{label}/y" in box.motors else 0.0

    def setPosition(self, label: str, um: float) -> None:  # noqa: N802
        """Go."""
        with self._box("send") as box:
            box.send(label, um * 1e-3)

    def setXYPosition(self, label: str, x_um: float, y_um: float) -> None:  # noqa: N802
        """Go, with both axes."""
        with self._box("send") as box:
            for axis, um in (("x", x_um), ("y", y_um)):
                if f"{label}/{axis}" in box.motors:
                    box.send(f"{label}/{axis}", um * 1e-3)

    def home(self, label: str) -> None:
        """Look for the reference, with both axes."""
        with self._box("home") as box:
            for channel in _channels(box, label):
                box.seek(channel)

    def stop(self, label: str) -> None:
        """Brake."""
        with self._box("stop") as box:
            for channel in _channels(box, label):
                box.stop(channel)

    def _box(self, call: str) -> AbstractContextManager[ForeignBox]:
        if self._wire is None:
            raise RuntimeError("no adapters are known")
        return self._wire.call(call)


def _channels(box: ForeignBox, label: str) -> list[str]:
    return [channel for channel in box.motors if channel in (label, f"{label}/x", f"{label}/y")]


EMULATOR = ForeignBox
