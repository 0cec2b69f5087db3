"""The GC functions of ports: registers and descriptions of every module.

Each is named as in the standard and raises GenTLError with the standard's code, which the producer turns into
the return value.
"""

import ctypes
from collections.abc import Callable

from sim.camera.features import XML_BASE
from sim.camera.gentl import memory
from sim.camera.gentl.abi import GenTLError, Kind, Status
from sim.camera.gentl.modules import CameraPort, Device, Handles, Interface, StreamModule, System
from sim.camera.gentl.ports import Port

MAX_READ_BYTES = 1 << 24


class PortCalls:
    """Part of `sim.camera.gentl.producer.Producer`."""

    handles: Handles

    def _port(self, handle: int) -> Port:
        module: object = self.handles.get(handle, System, Interface, Device, StreamModule, CameraPort)
        if isinstance(module, CameraPort):
            return module
        assert isinstance(module, System | Interface | Device | StreamModule)
        return module.port

    def GCReadPort(self, handle: int, address: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        length = memory.read_size(size)
        if length > MAX_READ_BYTES:
            raise GenTLError(Status.INVALID_PARAMETER, f"{length} bytes at once")
        memory.put(self._port(handle).read(address, length), buffer)

    def GCWritePort(self, handle: int, address: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        length = memory.read_size(size)
        if length > MAX_READ_BYTES or not buffer:
            raise GenTLError(Status.INVALID_PARAMETER, f"{length} bytes at once")
        self._port(handle).write(address, ctypes.string_at(buffer, length))

    def GCReadPortStacked(self, handle: int, entries: int, number: int) -> None:  # noqa: D102, N802
        self._stacked(handle, entries, number, self.GCReadPort)

    def GCWritePortStacked(self, handle: int, entries: int, number: int) -> None:  # noqa: D102, N802
        self._stacked(handle, entries, number, self.GCWritePort)

    def _stacked(self, handle: int, entries: int, number: int, one: Callable[[int, int, int, int], None]) -> None:
        wanted = memory.read_size(number)
        memory.write_size(number, 0)
        for index in range(wanted):
            address, buffer, _ = (ctypes.c_uint64 * 3).from_address(entries + 24 * index)
            one(handle, address, buffer, entries + 24 * index + 16)
            memory.write_size(number, index + 1)

    def _url(self, handle: int) -> str:
        port = self._port(handle)
        return f"local:rtpiv_{port.port_name}.xml;{XML_BASE:X};{len(port.xml):X}"

    def GCGetPortURL(self, handle: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        memory.give_text(self._url(handle), buffer, size)

    def GCGetNumPortURLs(self, handle: int, number: int) -> None:  # noqa: D102, N802
        self._port(handle)
        memory.write_u32(number, 1)

    def GCGetPortURLInfo(  # noqa: D102, N802
        self, handle: int, index: int, command: int, kind: int, buffer: int, size: int
    ) -> None:
        port = self._port(handle)
        if index != 0:
            raise GenTLError(Status.INVALID_INDEX, f"URL {index}")
        answers: dict[int, tuple[Kind, int | str]] = {
            0: (Kind.STRING, self._url(handle)),
            1: (Kind.INT32, 1),
            2: (Kind.INT32, 1),
            3: (Kind.INT32, 1),
            4: (Kind.INT32, 0),
            5: (Kind.INT32, 0),
            7: (Kind.UINT64, XML_BASE),
            8: (Kind.UINT64, len(port.xml)),
            9: (Kind.INT32, 0),
            10: (Kind.STRING, f"rtpiv_{port.port_name}.xml"),
        }
        if command not in answers:
            raise GenTLError(Status.NOT_AVAILABLE, f"URL info {command}")
        memory.give_answer(answers[command], kind, buffer, size)

    def GCGetPortInfo(self, handle: int, command: int, kind: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        port = self._port(handle)
        texts = {0: port.port_name, 1: "rtpiv", 2: port.port_name, 3: "Custom", 4: port.port_name, 11: "1.0"}
        texts[12] = port.port_name
        flags = {5: 0, 6: 1, 7: 1, 8: int(port.port_name == "Device"), 9: 0, 10: 0}
        if command in texts:
            memory.give_answer((Kind.STRING, texts[command]), kind, buffer, size)
        elif command in flags:
            memory.give_answer((Kind.BOOL8, flags[command]), kind, buffer, size)
        else:
            raise GenTLError(Status.NOT_AVAILABLE, f"port info {command}")
