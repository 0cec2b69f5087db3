"""The library: what becomes of a call from C, and the line that puts methods behind the library's symbols.

The functions themselves are methods of `PortCalls`, `FindCalls` and `StreamCalls`, named as in the standard.

A method takes the C arguments as integers, writes results into the caller's memory and raises GenTLError for
anything but success; `Producer.callback` turns its code into the return value.  Nothing that a client passes in is
trusted further than C allows: handles are looked up, indices and sizes checked, null pointers refused.
"""

import ctypes
import json
import logging
import threading
from collections.abc import Callable

from sim.camera.config import CameraConfig
from sim.camera.device import CameraGone
from sim.camera.gentl import memory
from sim.camera.gentl.abi import SIGNATURES, GenTLError, Status
from sim.camera.gentl.elf import TABLE
from sim.camera.gentl.find_calls import FindCalls
from sim.camera.gentl.modules import Device, Handles, Interface, System
from sim.camera.gentl.port_calls import PortCalls
from sim.camera.gentl.stream_calls import StreamCalls
from sim.camera.registers import BadAddress, BadValue, WriteProtected

log = logging.getLogger(__name__)
_attached: dict[str, object] = {}  # callbacks must outlive every caller


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
        method = getattr(self, name)

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
