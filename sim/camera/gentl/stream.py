"""The data stream: the client's buffers go round between an input pool, the camera and an output queue.

A frame that finds no buffer in the input pool is an underrun and is counted, as on hardware.
"""

import ctypes
import threading
from collections import deque
from dataclasses import dataclass

from sim.camera.device import SimFrame
from sim.camera.gentl import abi
from sim.camera.gentl.abi import Answer, GenTLError, Kind, Status, answer_of
from sim.camera.gentl.modules import TL_TYPE, Device, InfoPort, Module

STREAM_ID = "Stream0"


@dataclass(slots=True)
class Buffer:
    """Memory of the client that frames are written to."""

    handle: int
    address: int
    size: int
    user: int
    is_queued: bool = False
    filled: int = 0
    frame: SimFrame | None = None

    def answer(self, command: int) -> Answer:
        """DSGetBufferInfo.

        Raises
        ------
        GenTLError
            NO_DATA: the buffer holds no frame yet; NOT_AVAILABLE: the command asks for something else.
        """
        frame = self.frame
        always: dict[int, Answer] = {
            0: (Kind.PTR, self.address),
            1: (Kind.SIZET, self.size),
            2: (Kind.PTR, self.user),
            4: (Kind.BOOL8, int(frame is not None)),
            5: (Kind.BOOL8, int(self.is_queued)),
            6: (Kind.BOOL8, 0),
            8: (Kind.STRING, TL_TYPE),
            30: (Kind.BOOL8, int(frame is not None and bool(frame.chunks))),
            31: (Kind.BOOL8, 0),
        }
        if command in always:
            return always[command]
        if frame is None:
            raise GenTLError(Status.NO_DATA, "the buffer holds no frame yet")
        of_frame: dict[int, Answer] = {
            3: (Kind.UINT64, frame.timestamp_ns),
            7: (Kind.BOOL8, int(frame.is_incomplete)),
            9: (Kind.SIZET, self.filled),
            10: (Kind.SIZET, frame.picture.width),
            11: (Kind.SIZET, frame.picture.height),
            12: (Kind.SIZET, frame.picture.offset_x),
            13: (Kind.SIZET, frame.picture.offset_y),
            14: (Kind.SIZET, 0),
            15: (Kind.SIZET, 0),
            16: (Kind.UINT64, frame.frame_id),
            17: (Kind.BOOL8, 1),
            18: (Kind.SIZET, 0),
            19: (Kind.SIZET, abi.PAYLOAD_IMAGE),
            20: (Kind.UINT64, frame.picture.format_code),
            21: (Kind.UINT64, abi.NAMESPACE_PFNC_32BIT),
            22: (Kind.SIZET, frame.picture.height),
            26: (Kind.INT32, abi.LITTLE_ENDIAN_PIXELS),
            27: (Kind.SIZET, self.filled),
            28: (Kind.UINT64, frame.timestamp_ns),
            29: (
                Kind.BOOL8,
                int(self.filled < frame.picture.payload.size + len(frame.tail) and not frame.is_incomplete),
            ),
        }
        return answer_of(of_frame, command, "buffer")


class Stream(Module):
    """The one data stream of a device.

    Parameters
    ----------
    device : Device
        Its device, whose camera has power while the stream is open.
    """

    def __init__(self, device: Device) -> None:
        super().__init__(InfoPort("StreamPort", {"StreamID": STREAM_ID, "StreamType": TL_TYPE}), {})
        self.device = device
        self.ready = threading.Condition()
        self.is_started = False
        self.delivered = self.started_frames = self.underrun = 0
        self.buffers: dict[int, Buffer] = {}
        self.input: deque[Buffer] = deque()
        self.output: deque[Buffer] = deque()

    def open(self) -> None:
        """Take the frames of the camera; RESOURCE_IN_USE if it is open already."""
        super().open()
        assert self.device.camera is not None
        self.device.camera.sink = self.take

    def close(self) -> None:
        """Take no more frames, and forget the buffers."""
        super().close()
        self.is_started = False
        for kept in (self.buffers, self.input, self.output):
            kept.clear()
        if self.device.camera is not None:
            self.device.camera.sink = None

    def take(self, frame: SimFrame) -> None:
        """Copy a frame into the next free buffer (called on the camera's thread)."""
        with self.ready:
            if not self.is_started:
                return
            self.started_frames += 1
            if not self.input:
                self.underrun += 1
                return
            buffer = self.input.popleft()
        whole = min(buffer.size, frame.picture.payload.size)
        filled = whole // 2 if frame.is_incomplete else whole
        ctypes.memmove(buffer.address, frame.picture.payload.ctypes.data, filled)
        if frame.chunks and filled + len(frame.tail) <= buffer.size and not frame.is_incomplete:
            ctypes.memmove(buffer.address + filled, frame.tail, len(frame.tail))
            filled += len(frame.tail)
        with self.ready:
            buffer.frame, buffer.filled, buffer.is_queued = frame, filled, False
            self.output.append(buffer)
            self.delivered += 1
            self.ready.notify_all()

    def wait(self, timeout_s: float, hold_gil: bool) -> Buffer:
        """Take the next filled buffer.

        With `hold_gil` the wait keeps Python's lock, as a binding without lock release does around a vendor's
        producer: other threads of the process stand still for `timeout_s`.

        Raises
        ------
        GenTLError
            TIMEOUT: no frame came in time.
        """
        if hold_gil and not self.output:
            ctypes.PyDLL(None).usleep(round(1e6 * min(timeout_s, 1.0)))
            timeout_s = 0.0
        with self.ready:
            self.ready.wait_for(lambda: self.output, timeout_s)
            if not self.output:
                raise GenTLError(Status.TIMEOUT, "no frame in time")
            return self.output.popleft()

    def find(self, handle: int) -> Buffer:
        """Buffer of a handle.

        Raises
        ------
        GenTLError
            INVALID_BUFFER: it was never announced, or is revoked.
        """
        try:
            return self.buffers[handle]
        except KeyError:
            raise GenTLError(Status.INVALID_BUFFER, f"no buffer {handle:#x}") from None

    def queue(self, buffer: Buffer) -> None:
        """Give a buffer to the camera."""
        with self.ready:
            if buffer not in self.input:
                buffer.is_queued = True
                buffer.frame = None
                self.input.append(buffer)

    def flush(self, operation: int) -> None:
        """DSFlushQueue: move or forget buffers (0 input to output ... 4 all discard)."""
        with self.ready:
            if operation == 0:
                self.output.extend(self.input)
                self.input.clear()
            if operation in (1, 2, 4):
                returned = list(self.output) if operation == 2 else []
                self.output.clear()
                self.input.extend(returned)
            if operation == 3:
                waiting = {buffer.handle for buffer in (*self.input, *self.output)}
                self.input.extend(b for b in self.buffers.values() if b.handle not in waiting)
            if operation == 4:
                self.input.clear()

    def start(self) -> None:
        """Accept frames from now on.

        Raises
        ------
        GenTLError
            RESOURCE_IN_USE: the stream is started already.
        """
        with self.ready:
            if self.is_started:
                raise GenTLError(Status.RESOURCE_IN_USE, "the stream is started already")
            self.is_started = True
            self.delivered = self.started_frames = self.underrun = 0

    def stop(self) -> None:
        """Accept no more frames."""
        with self.ready:
            self.is_started = False

    def revoke(self, buffer: Buffer) -> None:
        """Forget a buffer."""
        with self.ready:
            for queue in (self.input, self.output):
                if buffer in queue:
                    queue.remove(buffer)
            del self.buffers[buffer.handle]

    def answer(self, command: int) -> Answer:
        """DSGetInfo.

        Raises
        ------
        GenTLError
            NOT_AVAILABLE: the command asks for something else.
        """
        camera = self.device.camera
        assert camera is not None
        with self.ready:
            answers: dict[int, Answer] = {
                0: (Kind.STRING, STREAM_ID),
                1: (Kind.UINT64, self.delivered),
                2: (Kind.UINT64, self.underrun),
                3: (Kind.SIZET, len(self.buffers)),
                4: (Kind.SIZET, len(self.input)),
                5: (Kind.SIZET, len(self.output)),
                6: (Kind.UINT64, self.started_frames),
                7: (Kind.SIZET, camera.registers.integer("PayloadSize")),
                8: (Kind.BOOL8, int(self.is_started)),
                9: (Kind.BOOL8, 1),
                10: (Kind.STRING, TL_TYPE),
                12: (Kind.SIZET, 1),
                13: (Kind.SIZET, 1),
            }
        return answer_of(answers, command, "stream")


@dataclass
class Event:
    """A registration for filled buffers."""

    owner: Stream
    fired: int = 0

    def answer(self, command: int) -> Answer:
        """EventGetInfo; NOT_AVAILABLE if the command asks for something else."""
        numbers = (abi.EVENT_NEW_BUFFER, len(self.owner.output), self.fired, 16, 16)
        kinds = (Kind.INT32, Kind.SIZET, Kind.UINT64, Kind.SIZET, Kind.SIZET)
        return answer_of(dict(enumerate(zip(kinds, numbers, strict=True))), command, "event")
