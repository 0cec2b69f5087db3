"""The TL and IF functions: from the library to a device.

Each is named as in the standard and raises GenTLError with the standard's code, which the producer turns into
the return value.
"""

from sim.camera.gentl import memory
from sim.camera.gentl.abi import GenTLError, Status
from sim.camera.gentl.modules import CameraPort, Device, Handles, Interface, System


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

    def TLGetInfo(self, handle: int, command: int, kind: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        memory.give_answer(self.handles.get(handle, System).answer(command), kind, buffer, size)

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

    def IFGetInfo(self, handle: int, command: int, kind: int, buffer: int, size: int) -> None:  # noqa: D102, N802
        memory.give_answer(self.handles.get(handle, Interface).answer(command), kind, buffer, size)

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

    def IFGetParentTL(self, handle: int, result: int) -> None:  # noqa: D102, N802
        self.handles.get(handle, Interface)
        raise GenTLError(Status.NOT_IMPLEMENTED, "parents are not handed out")

    def _device(self, handle: int, name: int) -> Device:
        wanted = memory.read_text(name)
        found = self.handles.get(handle, Interface).devices.get(wanted)
        if found is None:
            raise GenTLError(Status.INVALID_ID, wanted)
        return found
