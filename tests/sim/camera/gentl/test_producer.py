"""The producer through its C interface, as a careless or hostile client would use it."""

import ctypes
import platform

import pytest

from sim.camera.config import CameraConfig
from sim.camera.gentl import write_producer
from sim.camera.gentl.abi import SIGNATURES, GenTLError, Kind, Status
from sim.camera.gentl.elf import MACHINE
from sim.camera.gentl.modules import Device

pytestmark = pytest.mark.skipif(platform.machine() != MACHINE, reason="no jump table for this processor")

SUCCESS, NOT_INITIALIZED, IN_USE, BAD_HANDLE, BAD_ID, BAD_PARAMETER = 0, -1002, -1004, -1006, -1007, -1009
TIMEOUT, BAD_BUFFER, BAD_ADDRESS, TOO_SMALL, BAD_INDEX, NOT_AVAILABLE = -1011, -1013, -1015, -1016, -1017, -1014

_texts = []  # C holds only addresses; somebody must hold the memory


@pytest.fixture(scope="module")
def cti(tmp_path_factory):
    path = write_producer(
        tmp_path_factory.mktemp("cti") / "one.cti", [CameraConfig(width=16, height=8, serial="S")]
    )
    library = ctypes.CDLL(str(path))
    for name, types in SIGNATURES.items():
        getattr(library, name).argtypes = types
        getattr(library, name).restype = ctypes.c_int32
    return library


@pytest.fixture
def system(cti):
    assert cti.GCInitLib() == SUCCESS
    handle = ctypes.c_size_t()
    assert cti.TLOpen(ctypes.addressof(handle)) == SUCCESS
    yield handle.value
    assert cti.GCCloseLib() == SUCCESS


def opened(function, *arguments):
    handle = ctypes.c_size_t()
    assert function(*arguments, ctypes.addressof(handle)) == SUCCESS
    return handle.value


def text(value):
    _texts.append(ctypes.create_string_buffer(value.encode()))
    return ctypes.addressof(_texts[-1])


@pytest.fixture
def device(cti, system):
    interface = opened(cti.TLOpenInterface, system, text("rtpiv_interface"))
    return opened(cti.IFOpenDevice, interface, text("S"), 4)


@pytest.fixture
def stream(cti, device):
    return opened(cti.DevOpenDataStream, device, text("Stream0"))


def test_nothing_works_before_the_library_is_initialised(cti):
    handle = ctypes.c_size_t()
    assert cti.TLOpen(ctypes.addressof(handle)) == NOT_INITIALIZED


def test_sizes_are_asked_for_first_and_small_buffers_refused(cti, system):
    kind, size = ctypes.c_int32(), ctypes.c_size_t()
    where = [ctypes.addressof(kind), None, ctypes.addressof(size)]
    assert cti.TLGetInfo(system, 1, where[0], 0, where[2]) == SUCCESS
    assert (kind.value, size.value) == (Kind.STRING, len("rtpiv") + 1)
    room = ctypes.create_string_buffer(size.value)
    assert cti.TLGetInfo(system, 1, where[0], ctypes.addressof(room), where[2]) == SUCCESS
    assert room.value == b"rtpiv"
    size.value = 3
    assert cti.TLGetInfo(system, 1, where[0], ctypes.addressof(room), where[2]) == TOO_SMALL
    assert size.value == 6
    assert cti.TLGetInfo(system, 999, where[0], 0, where[2]) == NOT_AVAILABLE


def test_wrong_handles_names_and_indices_are_refused(cti, system, device, stream):
    size, handle, number = ctypes.c_size_t(64), ctypes.c_size_t(), ctypes.c_uint32()
    out = ctypes.addressof(handle)
    assert cti.TLOpen(out) == IN_USE
    assert cti.DevClose(12345678) == BAD_HANDLE
    assert cti.DevClose(system) == BAD_HANDLE  # a system is no device
    assert cti.TLOpenInterface(system, text("other"), out) == BAD_ID
    assert cti.TLOpenInterface(system, 0, out) == BAD_PARAMETER
    assert cti.DevOpenDataStream(device, text("Stream7"), out) == BAD_ID
    assert cti.DevOpenDataStream(device, text("Stream0"), out) == IN_USE
    assert cti.TLGetInterfaceID(system, 7, 0, ctypes.addressof(size)) == BAD_INDEX
    assert cti.DSQueueBuffer(stream, 4711) == BAD_BUFFER
    assert cti.DSAnnounceBuffer(stream, 0, 100, 0, out) == BAD_PARAMETER
    assert cti.TLGetNumInterfaces(system, 0) == BAD_PARAMETER
    assert cti.DevGetNumDataStreams(device, ctypes.addressof(number)) == SUCCESS
    assert number.value == 1


def test_ports_refuse_what_is_not_there(cti, device):
    port = opened(cti.DevGetPort, device)
    room, size = ctypes.create_string_buffer(64), ctypes.c_size_t(64)
    here, length = ctypes.addressof(room), ctypes.addressof(size)
    assert cti.GCReadPort(port, 0x10000, here, length) == SUCCESS
    assert cti.GCReadPort(port, 0x7FFFFFFFFF, here, length) == BAD_ADDRESS
    size.value = 1 << 40
    assert cti.GCReadPort(port, 0x10000, here, length) == BAD_PARAMETER
    size.value = 4
    assert cti.GCWritePort(port, 0x10002, here, length) == BAD_ADDRESS
    assert cti.GCReadPort(port, 0x10000, 0, length) == BAD_PARAMETER


def test_waiting_without_frames_times_out_and_stays_usable(cti, stream):
    event = opened(cti.GCRegisterEvent, stream, 1)
    data, size = ctypes.create_string_buffer(16), ctypes.c_size_t(16)
    for _ in range(2):
        assert cti.EventGetData(event, ctypes.addressof(data), ctypes.addressof(size), 5) == TIMEOUT
    assert cti.GCUnregisterEvent(stream, 1) == SUCCESS
    assert cti.EventGetData(event, ctypes.addressof(data), ctypes.addressof(size), 5) == BAD_HANDLE


def test_last_error_tells_what_happened(cti, system):
    cti.DevClose(999)
    code, size = ctypes.c_int32(), ctypes.c_size_t(200)
    room = ctypes.create_string_buffer(200)
    where = [ctypes.addressof(thing) for thing in (code, room, size)]
    assert cti.GCGetLastError(*where) == SUCCESS
    assert code.value == BAD_HANDLE
    assert b"0x3e7" in room.value


def test_a_camera_whose_world_has_ended_does_not_answer(tmp_path):
    """Its program was killed before anybody opened it: an answer of the standard, and no traceback."""
    world = {"source": "sim.camera.remote:RemoteSource", "source_arguments": {"folder": str(tmp_path)}}
    device = Device(CameraConfig(width=16, height=8, serial="S", lock_path=str(tmp_path / "lock"), **world))
    for _ in range(2):
        with pytest.raises(GenTLError, match="S does not answer") as caught:
            device.open()
        assert caught.value.status == Status.IO
    assert not device.is_open
