"""The C interface of GenTL 1.5: functions with their argument types, commands, error codes.

Pointers and handles are plain integers here.  Source: EMVA, GenICam GenTL Standard 1.5, chapter 6.
"""

from collections.abc import Mapping
from ctypes import c_int32, c_size_t, c_uint32, c_uint64
from enum import IntEnum
from typing import Any

_P = c_size_t  # any pointer, handle or size
_INFO: tuple[Any, ...] = (c_int32, _P, _P, _P)  # command, type*, buffer*, size*

SIGNATURES: dict[str, tuple[Any, ...]] = {
    "GCGetInfo": _INFO,
    "GCGetLastError": (_P, _P, _P),
    "GCInitLib": (),
    "GCCloseLib": (),
    "GCReadPort": (_P, c_uint64, _P, _P),
    "GCWritePort": (_P, c_uint64, _P, _P),
    "GCReadPortStacked": (_P, _P, _P),
    "GCWritePortStacked": (_P, _P, _P),
    "GCGetPortURL": (_P, _P, _P),
    "GCGetNumPortURLs": (_P, _P),
    "GCGetPortURLInfo": (_P, c_uint32, *_INFO),
    "GCGetPortInfo": (_P, *_INFO),
    "GCRegisterEvent": (_P, c_int32, _P),
    "GCUnregisterEvent": (_P, c_int32),
    "EventGetData": (_P, _P, _P, c_uint64),
    "EventGetDataInfo": (_P, _P, _P, *_INFO),
    "EventGetInfo": (_P, *_INFO),
    "EventFlush": (_P,),
    "EventKill": (_P,),
    "TLOpen": (_P,),
    "TLClose": (_P,),
    "TLGetInfo": (_P, *_INFO),
    "TLGetNumInterfaces": (_P, _P),
    "TLGetInterfaceID": (_P, c_uint32, _P, _P),
    "TLGetInterfaceInfo": (_P, _P, *_INFO),
    "TLOpenInterface": (_P, _P, _P),
    "TLUpdateInterfaceList": (_P, _P, c_uint64),
    "IFClose": (_P,),
    "IFGetInfo": (_P, *_INFO),
    "IFGetNumDevices": (_P, _P),
    "IFGetDeviceID": (_P, c_uint32, _P, _P),
    "IFUpdateDeviceList": (_P, _P, c_uint64),
    "IFGetDeviceInfo": (_P, _P, *_INFO),
    "IFOpenDevice": (_P, _P, c_int32, _P),
    "IFGetParentTL": (_P, _P),
    "DevGetPort": (_P, _P),
    "DevGetNumDataStreams": (_P, _P),
    "DevGetDataStreamID": (_P, c_uint32, _P, _P),
    "DevOpenDataStream": (_P, _P, _P),
    "DevGetInfo": (_P, *_INFO),
    "DevClose": (_P,),
    "DevGetParentIF": (_P, _P),
    "DSAnnounceBuffer": (_P, _P, _P, _P, _P),
    "DSAllocAndAnnounceBuffer": (_P, _P, _P, _P),
    "DSFlushQueue": (_P, c_int32),
    "DSStartAcquisition": (_P, c_int32, c_uint64),
    "DSStopAcquisition": (_P, c_int32),
    "DSGetInfo": (_P, *_INFO),
    "DSGetBufferID": (_P, c_uint32, _P),
    "DSClose": (_P,),
    "DSRevokeBuffer": (_P, _P, _P, _P),
    "DSQueueBuffer": (_P, _P),
    "DSGetBufferInfo": (_P, _P, *_INFO),
    "DSGetBufferChunkData": (_P, _P, _P, _P),
    "DSGetParentDev": (_P, _P),
    "DSGetNumBufferParts": (_P, _P, _P),
    "DSGetBufferPartInfo": (_P, _P, c_uint32, *_INFO),
    # of version 1.6, exported without a meaning
    "DSAnnounceCompositeBuffer": (_P, _P, _P, _P, _P, _P),
    "DSGetNumFlows": (_P, _P),
    "DSGetFlowInfo": (_P, c_uint32, *_INFO),
    "DSGetNumBufferSegments": (_P, _P, _P),
    "DSGetBufferSegmentInfo": (_P, _P, c_uint32, *_INFO),
}


class Status(IntEnum):
    """Return codes that this producer uses."""

    SUCCESS = 0
    ERROR = -1001
    NOT_INITIALIZED = -1002
    NOT_IMPLEMENTED = -1003
    RESOURCE_IN_USE = -1004
    INVALID_HANDLE = -1006
    INVALID_ID = -1007
    NO_DATA = -1008
    INVALID_PARAMETER = -1009
    IO = -1010
    TIMEOUT = -1011
    ABORT = -1012
    INVALID_BUFFER = -1013
    NOT_AVAILABLE = -1014
    INVALID_ADDRESS = -1015
    BUFFER_TOO_SMALL = -1016
    INVALID_INDEX = -1017
    INVALID_VALUE = -1019
    BUSY = -1022


class Kind(IntEnum):
    """INFO_DATATYPE: how an answer is to be read."""

    STRING = 1
    INT32 = 5
    UINT32 = 6
    UINT64 = 8
    PTR = 10
    BOOL8 = 11
    SIZET = 12


SIZES = {Kind.INT32: 4, Kind.UINT32: 4, Kind.UINT64: 8, Kind.PTR: 8, Kind.BOOL8: 1, Kind.SIZET: 8}

EVENT_NEW_BUFFER = 1
ACCESS_READWRITE, ACCESS_BUSY, ACCESS_OPEN_READWRITE = 1, 4, 5
PAYLOAD_IMAGE = 1
NAMESPACE_PFNC_32BIT = 4
LITTLE_ENDIAN_PIXELS = 1

Answer = tuple[Kind, int | str]


class GenTLError(Exception):
    """Leave a GenTL function with this status; the text is for GCGetLastError."""

    def __init__(self, status: Status, text: str = "") -> None:
        self.status = status
        super().__init__(text or status.name)


def answer_of(answers: Mapping[int, Answer], command: int, what: str) -> Answer:
    """Return the answer to the command of an Info function.

    Raises
    ------
    GenTLError
        NOT_AVAILABLE: the command asks for something else.
    """
    if command not in answers:
        raise GenTLError(Status.NOT_AVAILABLE, f"{what} info {command}")
    return answers[command]


def texts(*entries: str) -> dict[int, Answer]:
    """Return answers that are strings, of the commands 0, 1, ..."""
    return {command: (Kind.STRING, text) for command, text in enumerate(entries)}
