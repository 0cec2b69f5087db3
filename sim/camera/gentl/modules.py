"""The modules a GenTL client walks through: system, interface, device and its port; `stream` has what is below.

A handle is a number that finds one of these objects; a number that finds nothing is INVALID_HANDLE.

Each has a port, a small node map that says who it is.  System, interface, device and stream each have a few
read-only strings under the names of the GenTL SFNC.  The camera itself (the remote device) has its full node map
in the device model.
"""

import fcntl
import os
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from typing import Any, Protocol, TypeVar
from xml.sax.saxutils import escape

from sim.camera.config import CameraConfig
from sim.camera.device import MODEL, VENDOR, SimCamera
from sim.camera.features import XML_BASE
from sim.camera.gentl import abi
from sim.camera.gentl.abi import Answer, GenTLError, Kind, Status, answer_of, texts
from sim.camera.registers import BadAddress

STRING_BYTES = 256


class Port(Protocol):
    """Memory behind a GenTL port."""

    @property
    def xml(self) -> bytes:
        """GenApi description."""

    @property
    def port_name(self) -> str:
        """Name of the port in the description."""

    def read(self, address: int, length: int) -> bytes:
        """Read bytes; BadAddress outside."""

    def write(self, address: int, data: bytes) -> None:
        """Write bytes; BadAddress outside."""


@dataclass
class InfoPort:
    """Read-only strings of a transport layer module.

    Parameters
    ----------
    port_name : str
        "TLPort", "InterfacePort", "DevicePort" or "StreamPort"; also the name in the XML.
    values : dict of str to str
        Feature names with their values.
    """

    port_name: str
    values: dict[str, str]

    def __post_init__(self) -> None:
        nodes = "".join(
            f'<StringReg Name="{name}"><Address>{STRING_BYTES * index:#x}</Address>'
            f"<Length>{STRING_BYTES}</Length><AccessMode>RO</AccessMode><pPort>{self.port_name}</pPort></StringReg>\n"
            for index, name in enumerate(self.values)
        )
        features = "".join(f"<pFeature>{escape(name)}</pFeature>" for name in self.values)
        self.xml = (
            '<?xml version="1.0" encoding="utf-8"?>\n'
            '<RegisterDescription ModelName="rtpiv" VendorName="rtpiv" StandardNameSpace="None" '
            'SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" '
            'MinorVersion="0" SubMinorVersion="0" ProductGuid="5b0e1f4a-6f3d-4f0b-9a86-52d1c07a4e03" '
            'VersionGuid="5b0e1f4a-6f3d-4f0b-9a86-52d1c07a4e04" '
            'xmlns="http://www.genicam.org/GenApi/Version_1_1">\n'
            f'<Category Name="Root" NameSpace="Standard">{features}</Category>\n{nodes}'
            f'<Port Name="{self.port_name}" NameSpace="Standard"></Port>\n</RegisterDescription>\n'
        ).encode()
        self._memory = b"".join(
            value.encode()[: STRING_BYTES - 1].ljust(STRING_BYTES, b"\0") for value in self.values.values()
        )

    def read(self, address: int, length: int) -> bytes:
        """Read a string's bytes or the XML; BadAddress outside, and across their ends."""
        for base, memory in ((0, self._memory), (XML_BASE, self.xml)):
            if base <= address and address + length <= base + len(memory):
                return memory[address - base : address - base + length]
        raise BadAddress(f"{length} bytes at {address:#x}")

    def write(self, address: int, data: bytes) -> None:
        """Nothing here can be written: always BadAddress."""
        raise BadAddress(f"{len(data)} bytes at {address:#x} are read-only")


TL_TYPE = "Custom"
INTERFACE_ID = "rtpiv_interface"
M = TypeVar("M")


class Module(ABC):
    """A module of the tree: the system lists interfaces, an interface devices, a device its stream.

    Parameters
    ----------
    port : InfoPort
        Strings that say who it is.
    children : dict of str to Module
        Modules below it, by id.
    """

    def __init__(self, port: InfoPort, children: "dict[str, Module]") -> None:
        self.port, self.children = port, children
        self.is_open = False

    def open(self) -> None:
        """Open it; RESOURCE_IN_USE if it is open already."""
        if self.is_open:
            raise GenTLError(Status.RESOURCE_IN_USE, f"{self.port.port_name}: it is open already")
        self.is_open = True

    def close(self) -> None:
        """Close it; harmless when repeated."""
        self.is_open = False

    @abstractmethod
    def answer(self, command: int) -> Answer:
        """Answer a GetInfo function; NOT_AVAILABLE if the command asks for something else."""


class System(Module):
    """The library as a GenTL system, with one interface.

    Parameters
    ----------
    path : str
        Path of the .cti file.
    interface : Interface
        The one interface.
    """

    def __init__(self, path: str, interface: "Interface") -> None:
        about = {"TLID": "rtpiv", "TLVendorName": VENDOR, "TLModelName": "simulated cameras", "TLVersion": "1.0"}
        super().__init__(
            InfoPort("TLPort", {**about, "TLPath": path, "TLType": TL_TYPE}), {INTERFACE_ID: interface}
        )
        self.path = path

    def answer(self, command: int) -> Answer:
        """TLGetInfo and GCGetInfo."""
        name = self.path.rsplit("/", 1)[-1]
        answers = texts("rtpiv", VENDOR, "simulated cameras", "1.0", TL_TYPE, name, self.path, "rtpiv")
        numbers = {8: (Kind.INT32, 1), 9: (Kind.UINT32, 1), 10: (Kind.UINT32, 5)}
        return answer_of(answers | numbers, command, "system")


class Interface(Module):
    """The one interface; lists the cameras."""

    def __init__(self, devices: dict[str, Module]) -> None:
        port = InfoPort("InterfacePort", {"InterfaceID": INTERFACE_ID, "InterfaceType": TL_TYPE})
        super().__init__(port, devices)

    def answer(self, command: int) -> Answer:
        """TLGetInterfaceInfo and IFGetInfo."""
        return answer_of(texts(INTERFACE_ID, "rtpiv simulated interface", TL_TYPE), command, "interface")


class Device(Module):
    """One camera as the interface lists it; powered when it is opened for the first time."""

    def __init__(self, config: CameraConfig) -> None:
        about = {"DeviceID": config.serial, "DeviceVendorName": VENDOR, "DeviceModelName": MODEL}
        about |= {"DeviceSerialNumber": config.serial, "DeviceType": TL_TYPE}
        super().__init__(InfoPort("DevicePort", about), {})
        self.config = config
        self.camera: SimCamera | None = None
        self.remote_handle = 0
        self._lock: int | None = None

    def open(self) -> None:
        """Take exclusive control; RESOURCE_IN_USE if it is open anywhere, IO if the camera is unplugged."""
        super().open()
        try:
            if self.config.lock_path:
                self._lock = _lock(self.config.lock_path)
            if self.camera is None:
                with suppress(ConnectionError):  # a world of another process that has ended
                    self.camera = SimCamera(self.config)
            if self.camera is None or self.camera.is_lost:
                raise GenTLError(Status.IO, f"{self.config.serial} does not answer")
        except GenTLError:
            self.close()
            raise

    def close(self) -> None:
        """Give control back; settings stay, as on a camera under power."""
        super().close()
        for stream in self.children.values():
            stream.close()
        if self.camera is not None:
            self.camera.stop()
        self.remote_handle = 0
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def power_off(self) -> None:
        """Close and end the camera."""
        self.close()
        if self.camera is not None:
            self.camera.power_off()
            self.camera = None

    def answer(self, command: int) -> Answer:
        """IFGetDeviceInfo and DevGetInfo."""
        serial = self.config.serial
        answers = texts(serial, VENDOR, MODEL, TL_TYPE, f"{MODEL} {serial}", "", "", serial, "1.0")
        answers[9] = (Kind.UINT64, 1_000_000_000)
        if command == 5:  # asked of the lock file
            answers[5] = (Kind.INT32, self._access())
        return answer_of(answers, command, "device")

    def _access(self) -> int:
        if self.is_open:
            return abi.ACCESS_OPEN_READWRITE
        if self.config.lock_path:
            try:
                os.close(_lock(self.config.lock_path))
            except GenTLError:
                return abi.ACCESS_BUSY
        return abi.ACCESS_READWRITE


@dataclass
class CameraPort:
    """Port of the remote device: the camera's own registers and description."""

    owner: Device
    camera: SimCamera
    port_name: str = "Device"

    @property
    def xml(self) -> bytes:
        """The camera's GenApi description."""
        return self.camera.registers.xml

    def read(self, address: int, length: int) -> bytes:
        """Read the camera's registers."""
        return self.camera.read(address, length)

    def write(self, address: int, data: bytes) -> None:
        """Write the camera's registers."""
        self.camera.write(address, data)


def _lock(path: str) -> int:
    descriptor = os.open(path, os.O_CREAT | os.O_RDWR, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise GenTLError(Status.RESOURCE_IN_USE, "another process holds the camera") from None
    return descriptor


class Handles:
    """Handles given out, and the modules they stand for."""

    def __init__(self) -> None:
        self._objects: dict[int, Any] = {}
        self._next = count(0x1000)

    def add(self, module: object) -> int:
        """Give out a handle."""
        handle = next(self._next)
        self._objects[handle] = module
        return handle

    def get(self, handle: int, *kinds: type[M]) -> M:
        """Return the module of a handle; INVALID_HANDLE if it stands for none, or for another kind."""
        module = self._objects.get(handle)
        if not isinstance(module, kinds):
            raise GenTLError(Status.INVALID_HANDLE, f"handle {handle:#x}")
        return module

    def drop(self, module: object, only_owned: bool = False) -> None:
        """Forget a module and what it owns, or only the latter."""
        for handle, each in list(self._objects.items()):
            if getattr(each, "owner", None) is module or (each is module and not only_owned):
                del self._objects[handle]

    def clear(self) -> None:
        """Forget every handle."""
        self._objects.clear()

    def next_free(self) -> int:
        """Handle for something that is found elsewhere."""
        return next(self._next)
