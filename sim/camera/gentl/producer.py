"""The library: what becomes of a call from C.

Functions that are alike for every module of the tree (count, name, describe, open and close what is below) are
those of `TREE`; the others are methods of `Producer` (registers, library) and of `StreamCalls` (a file of its
own), named as in the standard.  What clients do not call that fetch frames is NOT_IMPLEMENTED.

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
from sim.camera.gentl.modules import CameraPort, Device, Handles, Interface, Module, Port, System
from sim.camera.gentl.stream import STREAM_ID, Event, Stream
from sim.camera.gentl.stream_calls import StreamCalls
from sim.camera.registers import BadAddress, BadValue, WriteProtected

MAX_READ_BYTES = 1 << 24


log = logging.getLogger(__name__)
_attached: dict[str, object] = {}  # callbacks must outlive every caller
TREE: dict[str, tuple[str, type[Any]]] = {  # what is done, and the kind of module that the handle stands for
    "TLGetInfo": ("info", System), "IFGetInfo": ("info", Interface), "DevGetInfo": ("info", Device),
    "DSGetInfo": ("info", Stream), "EventGetInfo": ("info", Event),
    "TLGetNumInterfaces": ("count", System), "IFGetNumDevices": ("count", Interface),
    "DevGetNumDataStreams": ("count", Device),
    "TLGetInterfaceID": ("name", System), "IFGetDeviceID": ("name", Interface),
    "DevGetDataStreamID": ("name", Device),
    "TLGetInterfaceInfo": ("info_below", System), "IFGetDeviceInfo": ("info_below", Interface),
    "TLUpdateInterfaceList": ("update", System), "IFUpdateDeviceList": ("update", Interface),
    "TLOpenInterface": ("open", System), "IFOpenDevice": ("open", Interface),
    "DevOpenDataStream": ("open", Device),
    "TLClose": ("close", System), "IFClose": ("close", Interface), "DevClose": ("close", Device),
    "DSClose": ("close", Stream),
}  # fmt: skip


class Producer(StreamCalls):
    """The producer of one .cti file, loaded into this process.

    Parameters
    ----------
    path : str
        The .cti file.
    configs : list of CameraConfig
        Cameras on the interface.
    """

    def __init__(self, path: str, configs: list[CameraConfig]) -> None:
        self.path = path
        self.devices = [Device(config) for config in configs]
        for device in self.devices:
            device.children[STREAM_ID] = Stream(device)
        self.interface = Interface({device.config.serial: device for device in self.devices})
        self.system = System(path, self.interface)
        self.handles = Handles()
        self.is_initialised = False
        self._last = threading.local()

    def callback(self, name: str) -> Callable[..., int]:
        """Wrap a method so that it returns a status, that of a GenTLError, and never lets an exception out."""
        if name in TREE:
            what, kind = TREE[name]
            method = partial(getattr(self, f"_{what}"), kind)
        else:
            method = getattr(self, name, partial(self._absent, name))

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

    def _count(self, kind: type[Module], handle: int, number: int) -> None:
        memory.write_u32(number, len(self.handles.get(handle, kind).children))

    def _name(self, kind: type[Module], handle: int, index: int, buffer: int, size: int) -> None:
        names = list(self.handles.get(handle, kind).children)
        if not 0 <= index < len(names):
            raise GenTLError(Status.INVALID_INDEX, f"{index} of {len(names)}")
        memory.give_text(names[index], buffer, size)

    def _below(self, kind: type[Module], handle: int, name: int) -> Module:
        wanted = memory.read_text(name)
        found = self.handles.get(handle, kind).children.get(wanted)
        if found is None:
            raise GenTLError(Status.INVALID_ID, wanted)
        return found

    def _info_below(self, module: type[Module], handle: int, name: int, *where: int) -> None:
        command, kind, buffer, size = where
        memory.give_answer(self._below(module, handle, name).answer(command), kind, buffer, size)

    def _update(self, kind: type[Module], handle: int, changed: int, timeout_ms: int) -> None:
        self.handles.get(handle, kind)
        memory.write_bool(changed, False)

    def _open(self, kind: type[Module], handle: int, name: int, *more: int) -> None:
        self._open_module(self._below(kind, handle, name), more[-1])  # behind the flags of a device

    def _open_module(self, module: Module, result: int) -> None:
        memory.write_size(result, 0)  # a null pointer opens nothing
        module.open()
        memory.write_size(result, self.handles.add(module))

    def _close(self, kind: type[Module], handle: int) -> None:
        module = self.handles.get(handle, kind)
        module.close()
        self.handles.drop(module)

    def _port(self, handle: int) -> Port:
        module: object = self.handles.get(handle, Module, CameraPort)
        return module.port if isinstance(module, Module) else self.handles.get(handle, CameraPort)

    def _absent(self, name: str, *arguments: int) -> None:
        raise GenTLError(Status.NOT_IMPLEMENTED, f"{name} is not there: frames are fetched without it")

    def TLOpen(self, result: int) -> None:  # noqa: D102, N802
        self._open_module(self.system, result)

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
        answers |= {0: (Kind.STRING, f"local:{name};{XML_BASE:X};{length:X}"), 10: (Kind.STRING, name)}
        answers |= {7: (Kind.UINT64, XML_BASE), 8: (Kind.UINT64, length)}
        memory.give_answer(answer_of(answers, command, "URL"), kind, buffer, size)

    def GCGetPortInfo(self, handle: int, command: int, kind: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        port = self._port(handle)
        name = port.port_name
        answers = texts(name, "rtpiv", name, "Custom", name) | {11: (Kind.STRING, "1.0"), 12: (Kind.STRING, name)}
        flags = {5: 0, 6: 1, 7: 1, 8: int(name == "Device"), 9: 0, 10: 0}
        answers |= {number: (Kind.BOOL8, flag) for number, flag in flags.items()}
        memory.give_answer(answer_of(answers, command, "port"), kind, buffer, size)

    def GCInitLib(self) -> None:  # noqa: D102, N802 - the standard's names; see SIGNATURES
        if self.is_initialised:
            raise GenTLError(Status.RESOURCE_IN_USE, "GCInitLib was called before")
        self.is_initialised = True

    def GCCloseLib(self) -> None:  # noqa: D102, N802
        for device in self.devices:
            device.power_off()
        self.handles.clear()
        self.is_initialised = self.system.is_open = self.interface.is_open = False

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
