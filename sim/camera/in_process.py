"""A simulated camera in the process of its client: no transport, so it works on every system, at once.

The other two ways to a `SimCamera` (a GenTL producer, a GigE Vision device) cross a wire that real cameras have,
and need a system whose libraries and sockets they know.  Here the client reads and writes the camera's registers
itself and takes frames from its sink: the same registers, formats, counters and faults.

    DEVICES["bench"] = SimCamera(config)                 # who has the device puts it here, under any name
    camera = InProcessCamera("bench")                    # a bench file: sim.camera.in_process:InProcessCamera

Frames wait packed, as the camera sends them, and are unpacked when they are asked for.  Those that wait and those
whose pixels are still held are at most the `buffers` of `arm`; a frame that finds no room is an underrun.
"""

import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import MappingProxyType

import numpy as np

from daq.cameras.camera import CameraInfo, Counters, Setting
from daq.cameras.features import CameraFeatures, NodesCamera
from daq.cameras.formats import pixel_format
from daq.cameras.frame import Frame, FrameMeta
from daq.cameras.ids import IdTracker
from daq.cameras.pixels import unpack
from daq.errors import (
    BadFrame,
    CameraBusy,
    CameraLost,
    CameraSetupError,
    CameraUsageError,
    FrameIncomplete,
    SettingRefused,
)
from sim.camera.device import MODEL, VENDOR, CameraGone, SimCamera, SimFrame
from sim.camera.registers import BadAddress, BadValue, WriteProtected

DEVICES: dict[str, SimCamera] = {}  # that have power in this process
_HELD: set[str] = set()
_LOCK = threading.Lock()


class RegisterNodes:
    """Features of a simulated camera by name, as `daq.cameras.sfnc.Nodes`."""

    def __init__(self, device: SimCamera) -> None:
        self._device, self._registers = device, device.registers

    def names(self) -> list[str]:
        """Every feature that has a value."""
        return [name for name in self._registers.addresses if self._registers.feature(name).kind != "command"]

    def has(self, name: str) -> bool:
        """Return whether the feature exists and has a value."""
        return name in self._registers.addresses and self._registers.feature(name).kind != "command"

    def get(self, name: str) -> Setting:
        """Value, read from the camera; CameraLost if it is gone."""
        feature = self._registers.feature(name)
        with _answering():
            data = self._device.read(self._registers.addresses[name], feature.length)
        value = self._registers.decode(name, data)
        if feature.kind == "bool":
            return bool(value)
        return next((entry for entry, number in feature.entries if number == value), value)

    def set(self, name: str, value: Setting) -> None:
        """Write a value; SettingRefused with what the camera takes."""
        feature = self._registers.feature(name)
        number: Setting | None = dict(feature.entries).get(str(value)) if feature.entries else value
        if number is None or feature.kind == "command":
            raise SettingRefused(f"{name} = {value!r} is refused (one of {', '.join(dict(feature.entries))})")
        try:
            with _answering():
                self._device.write(self._registers.addresses[name], self._registers.encode(name, number))
        except (BadValue, BadAddress, WriteProtected, ValueError, OverflowError) as error:
            raise SettingRefused(f"{name} = {value!r} is refused: {error}") from error

    def entries(self, name: str) -> tuple[str, ...]:
        """Entries of an enumeration."""
        return tuple(dict(self._registers.feature(name).entries))

    def can_execute(self, name: str) -> bool:
        """Return whether the command exists."""
        return name in self._registers.addresses and self._registers.feature(name).kind == "command"

    def execute(self, name: str) -> None:
        """Execute a command; CameraLost if the camera is gone."""
        with _answering():
            self._device.write(self._registers.addresses[name], self._registers.encode(name, 1))


class InProcessCamera(NodesCamera):
    """A simulated camera that has power in this process.

    Parameters
    ----------
    device : str
        Its name among `DEVICES`.
    """

    def __init__(self, device: str) -> None:
        super().__init__()
        self._name = device
        self._device: SimCamera | None = None
        self._told = threading.Condition()
        self._waiting: deque[tuple[SimFrame, int]] = deque()  # and when it came [ns]
        self._room: int | None = None  # frames that may wait or be held; None while it is not armed
        self._armed = 0  # how often; pixels of an earlier time take no room
        self._ids = IdTracker()
        self._ignored: int | None = None
        self._delivered = self._incomplete = self._underrun = self._unused = 0
        self._incomplete_told = self._held = 0

    @property
    def info(self) -> CameraInfo:
        """Vendor, model, serial number; CameraUsageError before `open`."""
        serial = str(RegisterNodes(self._device_in_hand).get("DeviceSerialNumber"))
        return CameraInfo("memory", VENDOR, MODEL, serial, self._name)

    @property
    def counters(self) -> Counters:
        """Counters since the last `arm`."""
        ignored = self._ignored
        if self._room is not None:
            ignored = self._features.count_ignored(self._open_nodes())
        with self._told:
            missing = self._ids.missing(self._incomplete + self._underrun)
            return Counters(
                self._delivered, self._incomplete, self._underrun, missing,
                ignored_triggers=ignored, unused=self._unused,
            )  # fmt: skip

    def open(self) -> None:
        """Take control; CameraSetupError if there is no such device, CameraBusy if it is open already."""
        if self._device is not None:
            raise CameraUsageError("the camera is open already; close it first")
        device = DEVICES.get(self._name)
        if device is None:
            raise CameraSetupError(f"no simulated camera {self._name!r} has power in this process")
        if device.is_lost:
            raise CameraLost(f"camera {self._name} is listed and does not answer; check cable and power")
        with _LOCK:
            if self._name in _HELD:
                raise CameraBusy(f"camera {self._name} is open elsewhere; close it there")
            _HELD.add(self._name)
        self._device, self._features = device, CameraFeatures()

    def arm(self, buffers: int = 24) -> None:
        """Start the acquisition with room for `buffers` frames."""
        self._require_disarmed()
        nodes = self._open_nodes()
        self._begin_counting()
        self._features.begin(nodes)
        self._armed += 1
        self._room = buffers
        self._device_in_hand.sink, self._device_in_hand.on_lost = self._take, self._hear_of_loss
        nodes.execute("AcquisitionStart")

    def poll(self, timeout_s: float) -> Frame | None:
        """Next complete frame, or None; FrameIncomplete when one came with pixels missing.

        CameraLost as soon as the camera is: a rehearsal need not wait in real time for what never comes.
        """
        self._require_armed()
        device = self._device_in_hand
        with self._told:
            self._told.wait_for(
                lambda: self._waiting or self._incomplete != self._incomplete_told or device.is_lost, timeout_s
            )
            if not self._waiting and self._incomplete == self._incomplete_told:
                if device.is_lost:
                    raise CameraLost("the camera does not answer; check cable and power")
                return None
            if not self._waiting:
                number, self._incomplete_told = self._incomplete - self._incomplete_told, self._incomplete
                raise FrameIncomplete(f"{number} frame came with pixels missing; look at the link")
            frame, received_ns = self._waiting.popleft()
            self._held += 1
            sequence = self._ids.note(frame.frame_id)
        return self._unpack(frame, sequence, received_ns)

    def probe(self, timeout_s: float) -> None:
        """CameraLost unless the camera answers; it answers at once or never."""
        self._open_nodes().get("Width")

    def disarm(self) -> Counters:
        """Stop the acquisition; frames that were not fetched count as unused."""
        if self._room is not None:
            with suppress(CameraLost):  # its registers cannot be asked
                self._ignored = self.counters.ignored_triggers
            self._device_in_hand.stop()
            self._device_in_hand.sink = None
            with self._told:
                self._room = None
                for frame, _ in self._waiting:
                    self._ids.note(frame.frame_id)
                self._unused += len(self._waiting)
                self._waiting.clear()
        return self.counters

    def close(self) -> None:
        """Give the camera back; harmless when repeated or after a loss."""
        if self._device is not None:
            self._device.stop()
            self._device.sink = None
            with _LOCK:
                _HELD.discard(self._name)
        self._device = self._room = None
        self._waiting.clear()

    @property
    def _device_in_hand(self) -> SimCamera:
        if self._device is None:
            raise CameraUsageError("the camera is closed; open it first")
        return self._device

    def _open_nodes(self) -> RegisterNodes:
        return RegisterNodes(self._device_in_hand)

    def _begin_counting(self) -> None:
        self._ids, self._ignored = IdTracker(), None
        self._delivered = self._incomplete = self._underrun = self._unused = 0
        self._incomplete_told = self._held = 0

    def _take(self, frame: SimFrame) -> None:
        """A frame has left the camera; called by its thread."""
        with self._told:
            if frame.is_incomplete:
                self._incomplete += 1
            elif self._room is None or len(self._waiting) + self._held >= self._room:
                self._underrun += 1
            else:
                self._waiting.append((frame, time.monotonic_ns()))
            self._told.notify_all()

    def _hear_of_loss(self) -> None:
        with self._told:
            self._told.notify_all()

    def _unpack(self, frame: SimFrame, sequence: int, received_ns: int) -> Frame:
        picture, form = frame.picture, pixel_format(frame.picture.format_code)
        out = np.empty(picture.width * picture.height, np.uint16)
        try:
            pixels = unpack(picture.payload, form, picture.width, picture.height, 0, out)
        except BadFrame:
            with self._told:
                self._held, self._unused = self._held - 1, self._unused + 1
            raise
        chunks = {name: frame.chunks[name] for name in self._features.chunks if name in frame.chunks}
        meta = FrameMeta(
            frame.frame_id, sequence, frame.timestamp_ns, received_ns, self._features.exposure_us, form.name,
            form.significant_bits, chunks=MappingProxyType(chunks),
        )  # fmt: skip
        self._delivered += 1
        armed = self._armed
        return Frame(pixels, meta, lambda: self._let_go(armed))

    def _let_go(self, armed: int) -> None:
        with self._told:
            self._held -= armed == self._armed

    @property
    def _is_armed(self) -> bool:
        return self._room is not None


@contextmanager
def _answering() -> Iterator[None]:
    try:
        yield
    except CameraGone as gone:
        raise CameraLost("the camera does not answer; check cable and power") from gone
