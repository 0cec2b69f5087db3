"""The Dev, DS and Event functions: from a device to its frames.

Each is named as in the standard and raises GenTLError with the standard's code, which the producer turns into
the return value.
"""

import struct
from contextlib import suppress

from sim.camera.gentl import memory
from sim.camera.gentl.abi import EVENT_NEW_BUFFER, GenTLError, Status
from sim.camera.gentl.modules import CameraPort, Device, Handles
from sim.camera.gentl.stream import Buffer, Event, Stream
from sim.camera.payload import places


class StreamCalls:
    """Part of `sim.camera.gentl.producer.Producer`."""

    handles: Handles

    # ---- device --------------------------------------------------------------------------------------------
    def DevGetPort(self, handle: int, result: int) -> None:  # noqa: D102, N802
        device = self.handles.get(handle, Device)
        assert device.camera is not None
        device.remote_handle = device.remote_handle or self.handles.add(CameraPort(device, device.camera))
        memory.write_size(result, device.remote_handle)

    # ---- events --------------------------------------------------------------------------------------------
    def GCRegisterEvent(self, handle: int, event: int, result: int) -> None:  # noqa: D102, N802
        module = self.handles.get(handle, object)
        if event != EVENT_NEW_BUFFER or not isinstance(module, Stream):
            raise GenTLError(Status.NOT_IMPLEMENTED, f"event {event}")
        memory.write_size(result, self.handles.add(Event(module)))

    def GCUnregisterEvent(self, handle: int, event: int) -> None:  # noqa: D102, N802
        self.handles.drop(self._stream(handle), only_owned=True)

    def EventGetData(self, handle: int, buffer: int, size: int, timeout_ms: int) -> None:  # noqa: D102, N802
        event = self.handles.get(handle, Event)
        filled = event.owner.wait(min(timeout_ms / 1e3, 3600.0), event.owner.device.config.hold_gil)
        event.fired += 1
        memory.give(filled.handle.to_bytes(8, "little") + filled.user.to_bytes(8, "little"), buffer, size)

    def EventFlush(self, handle: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, Event).owner.flush(1)

    # ---- stream --------------------------------------------------------------------------------------------
    def _stream(self, handle: int) -> Stream:
        return self.handles.get(handle, Stream)

    def DSAnnounceBuffer(self, handle: int, address: int, size: int, user: int, result: int) -> None:  # noqa: D102, N802
        stream = self._stream(handle)
        if not address or size <= 0:
            raise GenTLError(Status.INVALID_PARAMETER, "an empty buffer")
        buffer = Buffer(self.handles.next_free(), address, size, user)
        memory.write_size(result, buffer.handle)
        stream.buffers[buffer.handle] = buffer

    def DSFlushQueue(self, handle: int, operation: int) -> None:  # noqa: D102, N802
        self._stream(handle).flush(operation)

    def DSStartAcquisition(self, handle: int, flags: int, frames: int) -> None:  # noqa: D102, N802
        self._stream(handle).start()

    def DSStopAcquisition(self, handle: int, flags: int) -> None:  # noqa: D102, N802
        self._stream(handle).stop()

    def DSRevokeBuffer(self, handle: int, buffer: int, address: int, user: int) -> None:  # noqa: D102, N802
        stream = self._stream(handle)
        found = stream.find(buffer)
        stream.revoke(found)
        with suppress(GenTLError):  # both results may be unwanted
            memory.write_size(address, found.address)
        with suppress(GenTLError):
            memory.write_size(user, found.user)

    def DSQueueBuffer(self, handle: int, buffer: int) -> None:  # noqa: D102, N802
        stream = self._stream(handle)
        stream.queue(stream.find(buffer))

    def DSGetBufferInfo(  # noqa: D102, N802
        self, handle: int, buffer: int, command: int, kind: int, out: int, size: int
    ) -> None:
        memory.give_answer(self._stream(handle).find(buffer).answer(command), kind, out, size)

    def DSGetBufferChunkData(self, handle: int, buffer: int, chunk_list: int, number: int) -> None:  # noqa: D102, N802
        found = self._stream(handle).find(buffer)
        frame = found.frame
        chunks = [] if frame is None else places(frame.picture.payload.size, frame.chunks)
        if not chunks:
            raise GenTLError(Status.NO_DATA, "the frame carries no chunks")
        if chunk_list:  # without a list only their number is asked for
            if memory.read_size(number) < len(chunks):
                raise GenTLError(Status.BUFFER_TOO_SMALL, f"{len(chunks)} chunks")
            packed = [struct.pack("<QqQ", chunk.id, chunk.offset, chunk.length) for chunk in chunks]
            memory.put(b"".join(packed), chunk_list)
        memory.write_size(number, len(chunks))
