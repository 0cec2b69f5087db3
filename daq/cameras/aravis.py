"""GigE Vision cameras by address and USB3 Vision cameras by id, through libaravis, and never by a broadcast.

libaravis receives packets, asks for lost ones again and fills our buffers from a thread of its own, outside
Python.  Frames are unpacked into shared memory in the caller's thread when it asks for the next one.

libaravis counts underruns by packets: every packet of a frame that found no buffer is one.  How many frames they
were follows from the ids that are skipped, or where none is (before the first frame, behind the last one) by the
number of packets that a frame has.

Discovery would broadcast on all interfaces of the machine, so a network's device is made from the two addresses
alone.  For a USB3 camera only the bus is looked at: libaravis' part for networks is switched off first.  An id
that begins with Fake is libaravis' own camera in this process, for trying things out.
"""

import ctypes
import math
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
from numpy.typing import NDArray

from daq.cameras.camera import PROBE_MIN_S, CameraInfo, Counters
from daq.cameras.features import CameraFeatures, NodesCamera
from daq.cameras.formats import pixel_format
from daq.cameras.frame import Frame, FrameMeta
from daq.cameras.gvcp_probe import is_controlled, local_address
from daq.cameras.ids import IdTracker
from daq.cameras.libaravis import (
    CHECK_ENABLED,
    STATUS_SUCCESS,
    AravisError,
    AravisNodes,
    call,
    functions,
    open_plain_stream,
    open_stream,
)
from daq.cameras.pixels import unpack, warm_up
from daq.cameras.ring import FrameRing
from daq.errors import (
    BadFrame,
    CameraBusy,
    CameraError,
    CameraLost,
    CameraSetupError,
    CameraTimeout,
    CameraUsageError,
    FrameIncomplete,
    SettingRefused,
)

FAKE = "Fake"
OPEN_PROBE_S = 1.0
STREAM_POLL_S = 0.1
DRAIN_US = 1000
MAX_PAYLOAD_BYTES = 1 << 29
PACKET_SIZE, SMALLEST_PACKET_BYTES = "GevSCPSPacketSize", 576
PACKET_OVERHEAD_BYTES = 36  # headers of IP, UDP and stream


class AravisCamera(NodesCamera):
    """A GigE Vision camera.

    Parameters
    ----------
    address : str, optional
        IPv4 address of a GigE Vision camera.
    packet_bytes : int, optional
        Stream packet size; default is the largest that a test packet gets through with.
    device_id : str, optional
        Instead of an address: a USB3 Vision camera as libaravis calls it, such as "FLIR-1E10-12345678".
    """

    hidden = (AravisError,)

    def __init__(
        self, address: str | None = None, packet_bytes: int | None = None, device_id: str | None = None
    ) -> None:
        if (address is None) == (device_id is None):
            raise CameraSetupError("a camera by Aravis needs an `address` (GigE Vision) or a `device_id` (USB3)")
        super().__init__()
        self._device_id, self._is_network = device_id, address is not None
        self._id_bits = 64 if device_id is not None and not device_id.startswith(FAKE) else 16
        self._address = address or f"device {device_id}"
        self._packet_bytes = packet_bytes
        self._device = 0
        self._stream = 0
        self._parser = 0
        self._ring: FrameRing | None = None
        self._free: deque[int] = deque()
        self._memory: list[NDArray[np.uint8]] = []
        self._ids = IdTracker(16)
        self._packets_per_frame = 1
        self._delivered = self._incomplete = self._unused = 0
        self._underrun_in_gaps = self._underrun_before = self._underrun_packets = 0
        self._last = Counters()

    @property
    def counters(self) -> Counters:
        """Counters since the last `arm`; asks the camera while it is armed."""
        if self._stream:
            self._last = self._count()
        return self._last

    def open(self) -> None:
        """Take control of the camera at this address.

        CameraBusy if another process controls it, CameraLost if it does not answer or cannot be reached,
        CameraUsageError if it is open already.
        """
        if self._device:
            raise CameraUsageError("the camera is open already; close it first")
        functions()
        if self._is_network:
            self._open_at_address()
        else:
            self._open_by_id(str(self._device_id))
        try:
            self._prepare()
        except CameraError:
            self.close()
            raise

    def _open_at_address(self) -> None:
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

    def _open_by_id(self, device_id: str) -> None:
        call("arv_disable_interface", b"GigEVision")  # its list is made by a broadcast
        if device_id.startswith(FAKE):
            call("arv_enable_interface", FAKE.encode())
        try:
            self._device = call("arv_open_device", device_id.encode()) or 0
        except AravisError as error:
            raise CameraLost(f"camera {device_id}: {error}; is it plugged in, and free?") from error
        if not self._device:
            raise CameraSetupError(f"there is no camera {device_id} on USB; arv-tool-0.8 lists their ids")

    def arm(self, buffers: int = 24) -> None:
        """Allocate `buffers` frames, twice (raw and unpacked), and start the acquisition.

        CameraUsageError if it is armed already, BadFrame if it announces frames of an impossible size.
        """
        nodes = self._open_nodes()
        self._require_disarmed()
        warm_up()
        with self._errors("arm"):
            size = int(nodes.get("PayloadSize"))
            pixels = int(nodes.get("Width")) * int(nodes.get("Height"))
            if not 0 < size <= MAX_PAYLOAD_BYTES or not 0 < pixels <= MAX_PAYLOAD_BYTES:
                raise BadFrame(f"the camera announces frames of {size} bytes and {pixels} px")
            self._packets_per_frame = _packets_per_frame(nodes, size) if self._is_network else 1
            self._features.begin(nodes)
            ring = FrameRing(buffers, pixels)
            self._memory = [np.empty(size, np.uint8) for _ in range(buffers)]
            ready = [call("arv_buffer_new", size, memory.ctypes.data) for memory in self._memory]
            self._stream = (open_stream if self._is_network else open_plain_stream)(self._device)
        for buffer in ready:  # at once: a frame that was under way may come from now on
            call("arv_stream_push_buffer", self._stream, buffer)
        self._ring = ring
        self._free = deque(range(buffers))
        self._ids = IdTracker(self._id_bits)
        self._delivered = self._incomplete = self._unused = 0
        self._underrun_in_gaps = self._underrun_before = self._underrun_packets = 0
        self._last = Counters(ignored_triggers=0 if self._features.counts_triggers else None)
        try:
            with self._errors("arm"):
                if nodes.has("TLParamsLocked"):
                    nodes.set("TLParamsLocked", 1)
                nodes.execute("AcquisitionStart")
        except CameraError:
            self._drop_stream()
            raise

    def poll(self, timeout_s: float) -> Frame | None:
        """Next complete frame, or None; FrameIncomplete when one came with pixels missing."""
        self._require_armed()
        deadline = time.monotonic() + timeout_s
        while True:
            left_s = max(0.0, deadline - time.monotonic())
            if self._free:
                wait_us = round(1e6 * min(left_s, STREAM_POLL_S))
                buffer = call("arv_stream_timeout_pop_buffer", self._stream, wait_us)
                if buffer:
                    return self._take(buffer)
            elif left_s:
                time.sleep(min(left_s, 0.002))  # the caller holds every slot
            if not left_s:
                return None

    def probe(self, timeout_s: float) -> None:
        """CameraLost unless the camera answers and still knows that it is controlled.

        CameraTimeout if the caller holds every buffer; release frames first.
        """
        self._require_armed()
        if not self._free:
            raise CameraTimeout("every buffer is held by frames that were not released; release them")
        self._probe(timeout_s)

    def disarm(self) -> Counters:
        """Stop the acquisition; complete frames not fetched count as unused."""
        if not self._stream:
            return self._last
        nodes = AravisNodes(self._device)
        try:
            with self._errors("disarm"):
                nodes.execute("AcquisitionStop")
                if nodes.has("TLParamsLocked"):
                    nodes.set("TLParamsLocked", 0)
                ignored = self._features.count_ignored(nodes)
            self._drain()
            self._last = self._count(ignored)
        finally:
            self._drop_stream()
        return self._last

    def close(self) -> None:
        """Give the camera back; harmless when repeated."""
        self._drop_stream()
        device, self._device = self._device, 0
        parser, self._parser = self._parser, 0
        if parser:
            call("g_object_unref", parser)
        if device:
            call("g_object_unref", device)
        self._info = None
        self._features = CameraFeatures()

    def _prepare(self) -> None:
        """Checks on, packet size, who it is."""
        call("arv_device_set_range_check_policy", self._device, CHECK_ENABLED)
        call("arv_device_set_access_check_policy", self._device, CHECK_ENABLED)
        nodes = AravisNodes(self._device)
        with self._errors("open"):
            if not self._is_network:
                pass
            elif self._packet_bytes is None:
                call("arv_gv_device_auto_packet_size", self._device)
            else:
                call("arv_gv_device_set_packet_size", self._device, self._packet_bytes)
            names = ("DeviceVendorName", "DeviceModelName", "DeviceSerialNumber", "DeviceID")
            who = {name: str(nodes.get(name)) if nodes.has(name) else "" for name in names}
        serial = who["DeviceSerialNumber"] or who["DeviceID"]
        self._info = CameraInfo("aravis", who["DeviceVendorName"], who["DeviceModelName"], serial, self._address)

    def _take(self, buffer: int) -> Frame:
        """Frame of a buffer, which goes back to the stream."""
        received_ns = time.monotonic_ns()
        frame_id = int(call("arv_buffer_get_frame_id", buffer))
        try:
            if call("arv_buffer_get_status", buffer) != STATUS_SUCCESS:
                self._incomplete += 1
                if frame_id:
                    self._note(frame_id)
                raise FrameIncomplete("a frame came with pixels missing; look at the link")
            sequence = self._note(frame_id)
            return self._unpack(buffer, frame_id, sequence, received_ns)
        except FrameIncomplete:
            raise
        except BadFrame:
            self._unused += 1
            raise
        finally:
            call("arv_stream_push_buffer", self._stream, buffer)

    def _drain(self) -> None:
        """Count the frames that will not be fetched any more."""
        while buffer := call("arv_stream_timeout_pop_buffer", self._stream, DRAIN_US):
            if call("arv_buffer_get_status", buffer) == STATUS_SUCCESS:
                self._unused += 1
            else:
                self._incomplete += 1
            frame_id = int(call("arv_buffer_get_frame_id", buffer))
            if frame_id:
                self._note(frame_id)
            call("g_object_unref", buffer)

    def _note(self, frame_id: int) -> int:
        """Follow the ids; ids that were skipped while packets found no buffer are underruns."""
        is_first, gaps = self._ids.sequence < 0, self._ids.gaps
        sequence = self._ids.note(frame_id)
        skipped = self._ids.gaps - gaps
        if is_first or skipped > 0:
            packets, self._underrun_packets = self._underrun_packets, self._statistics()[1]
            if self._underrun_packets > packets and is_first:
                self._underrun_before = -(-self._underrun_packets // self._packets_per_frame)
            elif self._underrun_packets > packets:
                self._underrun_in_gaps += skipped
        return sequence

    def _unpack(self, buffer: int, frame_id: int, sequence: int, received_ns: int) -> Frame:
        assert self._ring is not None
        size, padding, rows = ctypes.c_size_t(), ctypes.c_int(), ctypes.c_int()
        data = call("arv_buffer_get_data", buffer, ctypes.byref(size))
        call("arv_buffer_get_image_padding", buffer, ctypes.byref(padding), ctypes.byref(rows))
        form = pixel_format(int(call("arv_buffer_get_image_pixel_format", buffer)))
        width, height = (int(call(f"arv_buffer_get_image_{side}", buffer)) for side in ("width", "height"))
        if not data or size.value > MAX_PAYLOAD_BYTES:
            raise BadFrame(f"a frame of {size.value} bytes is refused")
        raw = np.ctypeslib.as_array((ctypes.c_uint8 * size.value).from_address(data))
        slot = self._free[0]
        pixels = unpack(raw, form, width, height, padding.value, self._ring.slot(slot))
        self._free.popleft()
        self._delivered += 1
        timestamp_ns = int(call("arv_buffer_get_timestamp", buffer))
        if timestamp_ns == int(call("arv_buffer_get_system_timestamp", buffer)):
            timestamp_ns = 0  # the camera has no clock, and libaravis stamps with this computer's, on arrival
        meta = FrameMeta(
            frame_id, sequence, timestamp_ns, received_ns, self._features.exposure_us, form.name,
            form.significant_bits, chunks=self._chunks_of(buffer),
        )  # fmt: skip
        ring, free = self._ring, self._free
        return Frame(pixels, meta, lambda: free.append(slot) if self._ring is ring else None, slot)

    def _chunks_of(self, buffer: int) -> dict[str, float]:
        """Chunk data that came with a frame, by SFNC name."""
        found: dict[str, float] = {}
        if not self._features.chunks or not call("arv_buffer_has_chunks", buffer):
            return found
        if not self._parser:
            self._parser = call("arv_device_create_chunk_parser", self._device) or 0
        nodes = self._open_nodes()
        for name in self._features.chunks:
            with suppress(AravisError):  # not among those of this frame
                kind = "float" if nodes.is_float(f"Chunk{name}") else "integer"
                key = f"Chunk{name}".encode()
                found[name] = call(f"arv_chunk_parser_get_{kind}_value", self._parser, buffer, key)
        return {name: value for name, value in found.items() if math.isfinite(value)}

    def _count(self, ignored: int | None = None) -> Counters:
        resent, packets = self._statistics()
        behind = -(-(packets - self._underrun_packets) // self._packets_per_frame)
        underrun = self._underrun_before + self._underrun_in_gaps + behind
        if ignored is None:
            ignored = self._features.count_ignored(AravisNodes(self._device))
        missing = self._ids.missing(self._underrun_in_gaps)
        return Counters(self._delivered, self._incomplete, underrun, missing, resent, ignored, unused=self._unused)

    def _statistics(self) -> tuple[int, int]:
        """Packets that were sent again, and packets that found no buffer."""
        completed, failed, underrun = ctypes.c_uint64(), ctypes.c_uint64(), ctypes.c_uint64()
        addresses = (ctypes.byref(number) for number in (completed, failed, underrun))
        call("arv_stream_get_statistics", self._stream, *addresses)
        resent = 0
        if self._is_network:
            resent = int(call("arv_stream_get_info_uint64_by_name", self._stream, b"n_resent_packets"))
        return resent, underrun.value

    def _probe(self, timeout_s: float) -> None:
        """CameraLost unless the camera answers and still knows that it is controlled."""
        if not self._is_network:
            try:
                AravisNodes(self._device).get("Width")
            except AravisError as error:
                raise CameraLost(f"the camera does not answer ({error}); check cable and power") from error
        elif not is_controlled(self._address, timeout_s):
            raise CameraLost(
                f"the camera at {self._address} was restarted: it has lost its control connection; open it again"
            )

    @contextmanager
    def _errors(self, what: str) -> Iterator[None]:
        """Turn what libaravis reports into a loss or a plain camera error, by asking the camera itself."""
        try:
            yield
        except (AravisError, SettingRefused) as error:
            self._probe(PROBE_MIN_S)  # a lost camera refuses everything
            if isinstance(error, AravisError):
                raise CameraError(f"{what}: {error}") from error
            raise

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

    @property
    def _is_armed(self) -> bool:
        return bool(self._stream)


def _packets_per_frame(nodes: AravisNodes, payload_bytes: int) -> int:
    """Leader, data and trailer of a frame."""
    packet_bytes = int(nodes.get(PACKET_SIZE)) if nodes.has(PACKET_SIZE) else SMALLEST_PACKET_BYTES
    data_bytes = max(1, (packet_bytes & 0xFFFF) - PACKET_OVERHEAD_BYTES)
    return -(-payload_bytes // data_bytes) + 2
