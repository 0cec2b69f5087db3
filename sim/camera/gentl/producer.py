"""The library: what becomes of a call from C, and the functions that lead to a device.

The functions are methods of `PortCalls` (GC: registers and descriptions of every module), `FindCalls` (TL and IF:
from the library to a device) and `StreamCalls` (a file of its own), named as in the standard.

A method takes the C arguments as integers, writes results into the caller's memory and raises GenTLError, with
the standard's code, for anything but success; `Producer.callback` turns the code into the return value.  Nothing
that a client passes in is trusted further than C allows: handles are looked up, indices and sizes checked, null
pointers refused.
"""

import ctypes
import json
import logging
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from sim.camera.config import CameraConfig
from sim.camera.device import CameraGone
from sim.camera.features import XML_BASE
from sim.camera.gentl import memory
from sim.camera.gentl.abi import SIGNATURES, Answer, GenTLError, Kind, Status, answer_of, texts
from sim.camera.gentl.elf import TABLE
from sim.camera.gentl.modules import CameraPort, Device, Event, Handles, Interface, Port, StreamModule, System
from sim.camera.gentl.stream_calls import StreamCalls
from sim.camera.registers import BadAddress, BadValue, WriteProtected

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
        self._call_stacked(handle, entries, number, self.GCReadPort)

    def GCWritePortStacked(self, handle: int, entries: int, number: int) -> None:  # noqa: D102, N802
        self._call_stacked(handle, entries, number, self.GCWritePort)

    def _call_stacked(
        self, handle: int, entries: int, number: int, one: Callable[[int, int, int, int], None]
    ) -> None:
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
        name, length = f"rtpiv_{port.port_name}.xml", len(port.xml)
        answers: dict[int, Answer] = dict.fromkeys((1, 2, 3), (Kind.INT32, 1))
        answers |= dict.fromkeys((4, 5, 9), (Kind.INT32, 0))
        answers |= {0: (Kind.STRING, self._url(handle)), 10: (Kind.STRING, name)}
        answers |= {7: (Kind.UINT64, XML_BASE), 8: (Kind.UINT64, length)}
        memory.give_answer(answer_of(answers, command, "URL"), kind, buffer, size)

    def GCGetPortInfo(self, handle: int, command: int, kind: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        port = self._port(handle)
        name = port.port_name
        answers = texts(name, "rtpiv", name, "Custom", name) | {11: (Kind.STRING, "1.0"), 12: (Kind.STRING, name)}
        flags = {5: 0, 6: 1, 7: 1, 8: int(name == "Device"), 9: 0, 10: 0}
        answers |= {number: (Kind.BOOL8, flag) for number, flag in flags.items()}
        memory.give_answer(answer_of(answers, command, "port"), kind, buffer, size)


class FindCalls:
    """Part of `sim.camera.gentl.producer.Producer`."""

    handles: Handles
    system: System

    def TLOpen(self, result: int) -> None:  # noqa: D102, N802
        if self.system.is_open:
            raise GenTLError(Status.RESOURCE_IN_USE, "the system is open already")
        memory.write_size(result, self.handles.add(self.system))
        self.system.is_open = True

    def TLClose(self, handle: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, System).is_open = False
        self.handles.drop(handle)

    def TLGetNumInterfaces(self, handle: int, number: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, System)
        memory.write_u32(number, 1)

    def TLGetInterfaceID(self, handle: int, index: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, System)
        if index != 0:
            raise GenTLError(Status.INVALID_INDEX, f"interface {index}")
        memory.give_text(str(self.system.interface.answer(0)[1]), buffer, size)

    def TLGetInterfaceInfo(  # noqa: D102, N802
        self, handle: int, name: int, command: int, kind: int, buffer: int, size: int
    ) -> None:
        memory.give_answer(self._interface(handle, name).answer(command), kind, buffer, size)

    def TLOpenInterface(self, handle: int, name: int, result: int) -> None:  # noqa: D102, N802
        interface = self._interface(handle, name)
        if interface.is_open:
            raise GenTLError(Status.RESOURCE_IN_USE, "the interface is open already")
        memory.write_size(result, self.handles.add(interface))
        interface.is_open = True

    def TLUpdateInterfaceList(self, handle: int, changed: int, timeout_ms: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, System)
        memory.write_bool(changed, False)

    def _interface(self, handle: int, name: int) -> Interface:
        interface = self.handles.get(handle, System).interface
        if memory.read_text(name) != interface.answer(0)[1]:
            raise GenTLError(Status.INVALID_ID, memory.read_text(name))
        return interface

    def IFClose(self, handle: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, Interface).is_open = False
        self.handles.drop(handle)

    def IFGetNumDevices(self, handle: int, number: int) -> None:  # noqa: D102, N802
        memory.write_u32(number, len(self.handles.get(handle, Interface).devices))

    def IFGetDeviceID(self, handle: int, index: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        names = list(self.handles.get(handle, Interface).devices)
        if not 0 <= index < len(names):
            raise GenTLError(Status.INVALID_INDEX, f"device {index}")
        memory.give_text(names[index], buffer, size)

    def IFUpdateDeviceList(self, handle: int, changed: int, timeout_ms: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, Interface)
        memory.write_bool(changed, False)

    def IFGetDeviceInfo(  # noqa: D102, N802
        self, handle: int, name: int, command: int, kind: int, buffer: int, size: int
    ) -> None:
        memory.give_answer(self._device(handle, name).answer(command), kind, buffer, size)

    def IFOpenDevice(self, handle: int, name: int, flags: int, result: int) -> None:  # noqa: D102, N802
        device = self._device(handle, name)
        camera = device.open()
        device.handle = self.handles.add(device)
        device.remote_handle = self.handles.add(CameraPort(camera))
        memory.write_size(result, device.handle)

    def _device(self, handle: int, name: int) -> Device:
        wanted = memory.read_text(name)
        found = self.handles.get(handle, Interface).devices.get(wanted)
        if found is None:
            raise GenTLError(Status.INVALID_ID, wanted)
        return found


log = logging.getLogger(__name__)
_attached: dict[str, object] = {}  # callbacks must outlive every caller
INFO: dict[str, type[Any]] = {  # functions that ask a module for one of its answers
    "TLGetInfo": System, "IFGetInfo": Interface, "DevGetInfo": Device, "DSGetInfo": StreamModule,
    "EventGetInfo": Event,
}  # fmt: skip
# parents are not handed out
ABSENT: dict[str, type[Any]] = {"IFGetParentTL": Interface, "DevGetParentIF": Device}


class Producer(PortCalls, FindCalls, StreamCalls):
    """All state behind one .cti file.

    Parameters
    ----------
    path : str
        The file, for TLPath.
    configs : list of CameraConfig
        Cameras on its one interface.
    """

    def __init__(self, path: str, configs: list[CameraConfig]) -> None:
        self.path = path
        self.devices = {config.serial: Device(config) for config in configs}
        self.system = System(path, Interface(self.devices))
        self.handles = Handles()
        self.is_initialised = False
        self._last = threading.local()

    def callback(self, name: str) -> Callable[..., int]:
        """Wrap a method so that it returns a status, that of a GenTLError, and never lets an exception out."""
        method = (
            partial(self._info, INFO[name]) if name in INFO else getattr(self, name, partial(self._absent, name))
        )

        def call(*arguments: int) -> int:
            status, text = Status.SUCCESS, ""
            try:
                if not self.is_initialised and name not in ("GCInitLib", "GCGetInfo", "GCGetLastError"):
                    raise GenTLError(Status.NOT_INITIALIZED, "call GCInitLib first")
                method(*arguments)
            except GenTLError as error:
                status, text = error.status, str(error)
            except CameraGone:
                status, text = Status.IO, "the camera does not answer"
            except (BadAddress, WriteProtected) as error:
                status, text = Status.INVALID_ADDRESS, str(error)
            except BadValue as error:
                status, text = Status.INVALID_VALUE, str(error)
            except Exception as error:  # a C caller cannot receive it
                log.exception("%s failed", name)
                status, text = Status.ERROR, repr(error)
            if name != "GCGetLastError":
                self._last.value = (int(status), text)
            return int(status)

        return call

    def _info(self, module: type[Any], handle: int, command: int, kind: int, buffer: int, size: int) -> None:
        memory.give_answer(self.handles.get(handle, module).answer(command), kind, buffer, size)

    def _absent(self, name: str, handle: int, *arguments: int) -> None:
        """Refuse a function that clients expect to be exported."""
        if name in ABSENT:
            self.handles.get(handle, ABSENT[name])
        why = "parents are not handed out" if name in ABSENT else "flows and segments came after version 1.5"
        raise GenTLError(Status.NOT_IMPLEMENTED, why)

    def GCInitLib(self) -> None:  # noqa: D102, N802 - the standard's names; see SIGNATURES
        if self.is_initialised:
            raise GenTLError(Status.RESOURCE_IN_USE, "GCInitLib was called before")
        self.is_initialised = True

    def GCCloseLib(self) -> None:  # noqa: D102, N802
        for device in self.devices.values():
            device.power_off()
        self.handles.clear()
        self.is_initialised = self.system.is_open = self.system.interface.is_open = False

    def GCGetInfo(self, command: int, kind: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        memory.give_answer(self.system.answer(command), kind, buffer, size)

    def GCGetLastError(self, code: int, text: int, size: int) -> None:  # noqa: D102, N802
        status, words = getattr(self._last, "value", (0, ""))
        if code:
            ctypes.c_int32.from_address(code).value = status
        memory.give_text(words, text, size)


def attach(path: str, configs_json: str) -> None:
    """Fill the jump table of the library at `path`; called once by the library itself at its first use.

    Parameters
    ----------
    path : str
        The .cti file.
    configs_json : str
        JSON list of camera configurations.
    """
    if path in _attached:
        return
    configs = [CameraConfig.from_json(json.dumps(entry)) for entry in json.loads(configs_json)]
    producer = Producer(path, configs)
    library = ctypes.CDLL(path)
    table = (ctypes.c_void_p * len(SIGNATURES)).in_dll(library, TABLE)
    callbacks = []
    for index, (name, types) in enumerate(SIGNATURES.items()):
        callback = ctypes.CFUNCTYPE(ctypes.c_int32, *types)(producer.callback(name))
        callbacks.append(callback)
        table[index] = ctypes.cast(callback, ctypes.c_void_p).value
    _attached[path] = (producer, library, callbacks)
