"""GigE Vision cameras through libaravis, opened by address and never by discovery.

libaravis receives packets, asks for lost ones again and fills our buffers from a thread of its own, outside
Python.  Frames are unpacked into shared memory in the caller's thread when it asks for the next one.

Discovery would broadcast on all interfaces of the machine, so the device is made from the two addresses alone.
"""

import ctypes
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from daq.cameras.aravis_nodes import AravisNodes
from daq.cameras.camera import CameraInfo, Counters, Setting
from daq.cameras.formats import pixel_format
from daq.cameras.frame import Frame, FrameMeta
from daq.cameras.gvcp_probe import is_controlled, local_address
from daq.cameras.ids import IdTracker
from daq.cameras.libaravis import CHECK_ENABLED, STATUS_SUCCESS, AravisError, call, functions
from daq.cameras.pixels import unpack, warm_up
from daq.cameras.ring import FrameRing
from daq.cameras.sfnc import apply_or_restore, count_missed_triggers, exposure_us, verify_settings
from daq.errors import CameraBusy, CameraError, CameraLost, CameraTimeout, CameraUsageError, FrameError

PROBE_MIN_S = 0.5
OPEN_PROBE_S = 1.0
POLL_S = 0.1
DRAIN_US = 1000
MAX_PAYLOAD_BYTES = 1 << 29


class AravisCamera:
    """A GigE Vision camera.

    Parameters
    ----------
    address : str
        IPv4 address of the camera.
    packet_bytes : int, optional
        Stream packet size; default is the largest that a test packet gets through with.
    """

    def __init__(self, address: str, packet_bytes: int | None = None) -> None:
        self._address = address
        self._packet_bytes = packet_bytes
        self._device = 0
        self._stream = 0
        self._info: CameraInfo | None = None
        self._configured: dict[str, Setting] = {}
        self._ring: FrameRing | None = None
        self._free: deque[int] = deque()
        self._memory: list[NDArray[np.uint8]] = []
        self._ids = IdTracker(16)
        self._counts_triggers = False
        self._exposure_us = float("nan")
        self._delivered = self._incomplete = self._unused = 0
        self._last = Counters()

    @property
    def info(self) -> CameraInfo:
        """Vendor, model, serial number."""
        if self._info is None:
            raise CameraUsageError("the camera is closed; open it first")
        return self._info

    @property
    def counters(self) -> Counters:
        """Counters since the last `arm`; asks the camera while it is armed."""
        if self._stream:
            self._last = self._count()
        return self._last

    def open(self) -> None:
        """Take control of the camera at this address."""
        if self._device:
            raise CameraUsageError("the camera is open already; close it first")
        functions()
        if is_controlled(self._address, OPEN_PROBE_S):
            raise CameraBusy(f"another process controls the camera at {self._address}; close it there first")
        ours, theirs = (
            call("g_inet_address_new_from_string", text.encode())
            for text in (local_address(self._address), self._address)
        )
        try:
            self._device = call("arv_gv_device_new", ours, theirs) or 0
        except AravisError as error:
            raise CameraLost(f"the camera at {self._address} cannot be opened: {error}") from error
        finally:
            call("g_object_unref", ours)
            call("g_object_unref", theirs)
        if not call("arv_gv_device_is_controller", self._device):
            self.close()
            raise CameraBusy(f"another process controls the camera at {self._address}; close it there first")
        try:
            self._prepare()
        except CameraError:
            self.close()
            raise

    def configure(self, settings: Mapping[str, Setting]) -> dict[str, Setting]:
        """Set SFNC features in a safe order; returns what the camera reads back."""
        nodes = self._open_nodes()
        if self._stream:
            raise CameraUsageError("the camera is armed; disarm it first")
        with self._errors("configure"):
            readback = apply_or_restore(nodes, settings, self._configured)
        self._configured.update(readback)
        return readback

    def verify(self) -> None:
        """Read the configured settings back once more; SettingsChanged if the camera lost any."""
        nodes = self._open_nodes()
        with self._errors("verify"):
            verify_settings(nodes, self._configured)

    def settings(self) -> dict[str, Setting]:
        """Every readable feature with its value."""
        nodes = self._open_nodes()
        values = {}
        for name in nodes.names():
            if nodes.has(name):
                with suppress(AravisError):  # not readable in the present state
                    values[name] = nodes.get(name)
        return values

    def arm(self, buffers: int = 24) -> None:
        """Allocate `buffers` frames, twice (raw and unpacked), and start the acquisition."""
        nodes = self._open_nodes()
        if self._stream:
            raise CameraUsageError("the camera is armed already; disarm it first")
        warm_up()
        with self._errors("arm"):
            size = int(nodes.get("PayloadSize"))
            pixels = int(nodes.get("Width")) * int(nodes.get("Height"))
            if not 0 < size <= MAX_PAYLOAD_BYTES or not 0 < pixels <= MAX_PAYLOAD_BYTES:
                raise FrameError(f"the camera announces frames of {size} bytes and {pixels} px")
            self._exposure_us = exposure_us(nodes)
            self._counts_triggers = count_missed_triggers(nodes)
            self._stream = call("arv_device_create_stream", self._device, None, None)
        self._ring = FrameRing(buffers, pixels)
        self._free = deque(range(buffers))
        self._memory = [np.empty(size, np.uint8) for _ in range(buffers)]
        for memory in self._memory:
            call("arv_stream_push_buffer", self._stream, call("arv_buffer_new", size, memory.ctypes.data))
        self._ids = IdTracker(16)
        self._delivered = self._incomplete = self._unused = 0
        self._last = Counters(ignored_triggers=0 if self._counts_triggers else None)
        try:
            with self._errors("arm"):
                if nodes.has("TLParamsLocked"):
                    nodes.set("TLParamsLocked", 1)
                nodes.execute("AcquisitionStart")
        except CameraError:
            self._drop_stream()
            raise

    def trigger(self) -> None:
        """Send one software trigger."""
        self._require_armed()
        with self._errors("trigger"):
            self._open_nodes().execute("TriggerSoftware")

    def next_frame(self, timeout_s: float) -> Frame:
        """Wait for the next complete frame; incomplete ones are counted and put aside."""
        self._require_armed()
        deadline = time.monotonic() + timeout_s
        while (left_s := deadline - time.monotonic()) > 0:
            if not self._free:
                time.sleep(min(left_s, 0.002))  # the caller holds every slot
                continue
            buffer = call("arv_stream_timeout_pop_buffer", self._stream, round(1e6 * min(left_s, POLL_S)))
            if buffer:
                frame = self._take(buffer)
                if frame is not None:
                    return frame
        if not self._free:
            raise CameraTimeout("every buffer is held by frames that were not released; release them")
        self._probe(max(PROBE_MIN_S, timeout_s / 2))
        raise CameraTimeout(f"no frame within {timeout_s:g} s; the camera answers, so look at its trigger")

    def disarm(self) -> Counters:
        """Stop the acquisition; complete frames that nobody fetched count as underrun."""
        if not self._stream:
            return self._last
        nodes = AravisNodes(self._device)
        try:
            with self._errors("disarm"):
                nodes.execute("AcquisitionStop")
                if nodes.has("TLParamsLocked"):
                    nodes.set("TLParamsLocked", 0)
                ignored = int(nodes.get("CounterValue")) if self._counts_triggers else None
            self._drain()
            self._last = self._count(ignored)
        finally:
            self._drop_stream()
        return self._last

    def close(self) -> None:
        """Give the camera back; harmless when repeated."""
        self._drop_stream()
        device, self._device = self._device, 0
        if device:
            call("g_object_unref", device)
        self._info = None
        self._configured = {}

    def _prepare(self) -> None:
        """Checks on, packet size, who it is."""
        call("arv_device_set_range_check_policy", self._device, CHECK_ENABLED)
        call("arv_device_set_access_check_policy", self._device, CHECK_ENABLED)
        nodes = AravisNodes(self._device)
        with self._errors("open"):
            if self._packet_bytes is None:
                call("arv_gv_device_auto_packet_size", self._device)
            else:
                call("arv_gv_device_set_packet_size", self._device, self._packet_bytes)
            names = ("DeviceVendorName", "DeviceModelName", "DeviceSerialNumber", "DeviceID")
            who = {name: str(nodes.get(name)) if nodes.has(name) else "" for name in names}
        serial = who["DeviceSerialNumber"] or who["DeviceID"]
        self._info = CameraInfo("aravis", who["DeviceVendorName"], who["DeviceModelName"], serial, self._address)

    def _take(self, buffer: int) -> Frame | None:
        """Frame of a buffer, or None if it is incomplete; the buffer goes back to the stream."""
        received_ns = time.monotonic_ns()
        frame_id = int(call("arv_buffer_get_frame_id", buffer))
        try:
            if call("arv_buffer_get_status", buffer) != STATUS_SUCCESS:
                self._incomplete += 1
                if frame_id:
                    self._ids.note(frame_id)
                return None
            sequence = self._ids.note(frame_id)
            return self._unpack(buffer, frame_id, sequence, received_ns)
        except FrameError:
            self._unused += 1
            raise
        finally:
            call("arv_stream_push_buffer", self._stream, buffer)

    def _drain(self) -> None:
        """Count the frames that nobody will fetch any more."""
        while buffer := call("arv_stream_timeout_pop_buffer", self._stream, DRAIN_US):
            if call("arv_buffer_get_status", buffer) == STATUS_SUCCESS:
                self._unused += 1
            else:
                self._incomplete += 1
            frame_id = int(call("arv_buffer_get_frame_id", buffer))
            if frame_id:
                self._ids.note(frame_id)
            call("g_object_unref", buffer)

    def _unpack(self, buffer: int, frame_id: int, sequence: int, received_ns: int) -> Frame:
        assert self._ring is not None
        size, padding, rows = ctypes.c_size_t(), ctypes.c_int(), ctypes.c_int()
        data = call("arv_buffer_get_data", buffer, ctypes.byref(size))
        call("arv_buffer_get_image_padding", buffer, ctypes.byref(padding), ctypes.byref(rows))
        form = pixel_format(int(call("arv_buffer_get_image_pixel_format", buffer)))
        width, height = (int(call(f"arv_buffer_get_image_{side}", buffer)) for side in ("width", "height"))
        if not data or size.value > MAX_PAYLOAD_BYTES:
            raise FrameError(f"a frame of {size.value} bytes is refused")
        raw = np.ctypeslib.as_array((ctypes.c_uint8 * size.value).from_address(data))
        slot = self._free[0]
        pixels = unpack(raw, form, width, height, padding.value, self._ring.slot(slot))
        self._free.popleft()
        self._delivered += 1
        timestamp_ns = int(call("arv_buffer_get_timestamp", buffer))
        meta = FrameMeta(
            frame_id, sequence, timestamp_ns, received_ns, self._exposure_us, form.name, form.significant_bits
        )
        ring, free = self._ring, self._free
        return Frame(pixels, meta, lambda: free.append(slot) if self._ring is ring else None, slot)

    def _count(self, ignored: int | None = None) -> Counters:
        completed, failed, underrun = ctypes.c_uint64(), ctypes.c_uint64(), ctypes.c_uint64()
        addresses = (ctypes.byref(number) for number in (completed, failed, underrun))
        call("arv_stream_get_statistics", self._stream, *addresses)
        resent = int(call("arv_stream_get_info_uint64_by_name", self._stream, b"n_resent_packets"))
        if ignored is None and self._counts_triggers:
            ignored = int(AravisNodes(self._device).get("CounterValue"))
        missing = self._ids.missing(underrun.value)
        return Counters(self._delivered, self._incomplete, underrun.value + self._unused, missing, resent, ignored)

    def _probe(self, timeout_s: float) -> None:
        """CameraLost unless the camera answers and still knows that it is controlled."""
        if not is_controlled(self._address, timeout_s):
            raise CameraLost(
                f"the camera at {self._address} was restarted: it no longer knows who controls it; open it again"
            )

    def _errors(self, what: str) -> "_Translate":
        return _Translate(self, what)

    def _drop_stream(self) -> None:
        stream, self._stream = self._stream, 0
        if stream:
            call("g_object_unref", stream)  # ends its thread and forgets the buffers in its queues
        self._memory = []
        ring, self._ring = self._ring, None
        if ring is not None:
            ring.close()

    def _open_nodes(self) -> AravisNodes:
        if not self._device:
            raise CameraUsageError("the camera is closed; open it first")
        return AravisNodes(self._device)

    def _require_armed(self) -> None:
        if not self._stream:
            raise CameraUsageError("the camera is not armed; call arm first")


class _Translate:
    """Turn what libaravis reports into a loss or a plain camera error, by asking the camera itself."""

    def __init__(self, camera: AravisCamera, what: str) -> None:
        self._camera = camera
        self._what = what

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if not isinstance(error, AravisError):
            return
        self._camera._probe(PROBE_MIN_S)
        raise CameraError(f"{self._what}: {error}") from error
