"""The Dev, DS and Event functions: from a device to its frames.

Each is named as in the standard and raises GenTLError with the standard's code, which the producer turns into
the return value.
"""

import ctypes
import struct
from contextlib import suppress

from sim.camera.gentl import memory
from sim.camera.gentl.abi import EVENT_NEW_BUFFER, Answer, GenTLError, Kind, Status, answer_of
from sim.camera.gentl.modules import Device, Event, Handles, StreamModule
from sim.camera.gentl.stream import Buffer, Stream
from sim.camera.payload import places


class StreamCalls:
    """Part of `sim.camera.gentl.producer.Producer`."""

    handles: Handles

    # ---- device --------------------------------------------------------------------------------------------
    def DevGetPort(self, handle: int, result: int) -> None:  # noqa: D102, N802
        memory.write_size(result, self.handles.get(handle, Device).remote_handle)

    def DevGetNumDataStreams(self, handle: int, number: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, Device)
        memory.write_u32(number, 1)

    def DevGetDataStreamID(self, handle: int, index: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, Device)
        if index != 0:
            raise GenTLError(Status.INVALID_INDEX, f"stream {index}")
        memory.give_text("Stream0", buffer, size)

    def DevOpenDataStream(self, handle: int, name: int, result: int) -> None:  # noqa: D102, N802
        device = self.handles.get(handle, Device)
        if memory.read_text(name) != "Stream0":
            raise GenTLError(Status.INVALID_ID, memory.read_text(name))
        if device.stream is not None or device.camera is None:
            raise GenTLError(Status.RESOURCE_IN_USE, "the stream is open already")
        device.stream = Stream(device.camera)
        memory.write_size(result, self.handles.add(StreamModule(device, device.stream)))

    def DevClose(self, handle: int) -> None:  # noqa: D102, N802
        device = self.handles.get(handle, Device)
        device.close()
        self.handles.drop(device.remote_handle)
        self.handles.drop(handle)

    # ---- events --------------------------------------------------------------------------------------------
    def GCRegisterEvent(self, handle: int, event: int, result: int) -> None:  # noqa: D102, N802
        module = self.handles.get(handle, object)
        if event != EVENT_NEW_BUFFER or not isinstance(module, StreamModule):
            raise GenTLError(Status.NOT_IMPLEMENTED, f"event {event}")
        memory.write_size(result, self.handles.add(Event(module)))

    def GCUnregisterEvent(self, handle: int, event: int) -> None:  # noqa: D102, N802
        self.handles.drop_owned(self.handles.get(handle, StreamModule))

    def EventGetData(self, handle: int, buffer: int, size: int, timeout_ms: int) -> None:  # noqa: D102, N802
        event = self.handles.get(handle, Event)
        device = event.owner.device
        timeout_s = min(timeout_ms / 1e3, 3600.0)
        filled = event.owner.stream.wait(timeout_s, device.config.hold_gil)
        event.fired += 1
        memory.give(filled.handle.to_bytes(8, "little") + filled.user.to_bytes(8, "little"), buffer, size)

    def EventGetDataInfo(  # noqa: D102, N802
        self, handle: int, data: int, length: int, command: int, kind: int, buffer: int, size: int
    ) -> None:
        self.handles.get(handle, Event)
        if length < 16 or not data:
            raise GenTLError(Status.INVALID_PARAMETER, "no event data")
        id_and_user = (ctypes.c_uint64 * 2).from_address(data)
        answers: dict[int, Answer] = {command: (Kind.PTR, value) for command, value in enumerate(id_and_user)}
        memory.give_answer(answer_of(answers, command, "event data"), kind, buffer, size)

    def EventFlush(self, handle: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, Event).owner.stream.flush(1)

    def EventKill(self, handle: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, Event).owner.stream.kill_wait()

    # ---- stream --------------------------------------------------------------------------------------------
    def _stream(self, handle: int) -> Stream:
        return self.handles.get(handle, StreamModule).stream

    def _announce(self, stream: Stream, address: int, size: int, user: int, result: int, owner: object) -> None:
        if not address or size <= 0:
            raise GenTLError(Status.INVALID_PARAMETER, "an empty buffer")
        buffer = Buffer(self.handles.next_free(), address, size, user, owner)
        memory.write_size(result, buffer.handle)
        stream.buffers[buffer.handle] = buffer

    def DSAnnounceBuffer(self, handle: int, address: int, size: int, user: int, result: int) -> None:  # noqa: D102, N802
        self._announce(self._stream(handle), address, size, user, result, None)

    def DSAllocAndAnnounceBuffer(self, handle: int, size: int, user: int, result: int) -> None:  # noqa: D102, N802
        if not 0 < size <= 1 << 30:
            raise GenTLError(Status.INVALID_PARAMETER, f"a buffer of {size} bytes")
        owner = ctypes.create_string_buffer(size)
        self._announce(self._stream(handle), ctypes.addressof(owner), size, user, result, owner)

    def DSFlushQueue(self, handle: int, operation: int) -> None:  # noqa: D102, N802
        self._stream(handle).flush(operation)

    def DSStartAcquisition(self, handle: int, flags: int, frames: int) -> None:  # noqa: D102, N802
        self._stream(handle).start()

    def DSStopAcquisition(self, handle: int, flags: int) -> None:  # noqa: D102, N802
        self._stream(handle).stop()

    def DSGetBufferID(self, handle: int, index: int, result: int) -> None:  # noqa: D102, N802
        numbers = list(self._stream(handle).buffers)
        if not 0 <= index < len(numbers):
            raise GenTLError(Status.INVALID_INDEX, f"buffer {index}")
        memory.write_size(result, numbers[index])

    def DSClose(self, handle: int) -> None:  # noqa: D102, N802
        module = self.handles.get(handle, StreamModule)
        module.stream.stop()
        if module.device.camera is not None:
            module.device.camera.sink = None
        module.device.stream = None
        self.handles.drop_owned(module)
        self.handles.drop(handle)

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
        memory.give_answer(self._stream(handle).find(buffer).answer(command, "Custom"), kind, out, size)

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

    def DSGetParentDev(self, handle: int, result: int) -> None:  # noqa: D102, N802
        memory.write_size(result, self.handles.get(handle, StreamModule).device.handle)

    def DSGetNumBufferParts(self, handle: int, buffer: int, number: int) -> None:  # noqa: D102, N802
        self._stream(handle).find(buffer)
        raise GenTLError(Status.NO_DATA, "frames have one part and are not multi-part")

    def DSGetBufferPartInfo(  # noqa: D102, N802
        self, handle: int, buffer: int, part: int, command: int, kind: int, out: int, size: int
    ) -> None:
        self._stream(handle).find(buffer)
        raise GenTLError(Status.INVALID_INDEX, f"part {part}")
