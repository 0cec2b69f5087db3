"""libaravis-0.8 by ctypes: the few dozen functions that the backend needs, a camera's features, and its stream.

ctypes needs no compiler, no GObject introspection and works on every Python; it also gives Python's lock away
during each call.  The library is LGPL and is loaded as the system installed it
(Debian, Ubuntu: ``apt-get install libaravis-0.8-0``).

A stream has to be one that has heard only its own camera.  Where it may (capability CAP_NET_RAW), libaravis
reads packets from a raw socket with a ring of 32 MB, which loses far less than a plain one.  It binds that socket
first and attaches the filter for its camera's address after, so whatever crosses the interface in between is taken
for the camera's: the foreign packet's block id becomes the last id seen, and the camera's own frames are dropped
as late ones, for as long as the stream lives and without an error (libaravis 0.8.26 to 0.8.36, `_ring_buffer_loop`
and `_find_frame_data` of arvgvstream.c).

Before the acquisition starts our camera sends nothing, so a stream that has received a packet by then is spoilt
and is opened anew.  The ring hands a packet on within 5 ms (`tp_retire_blk_tov`); after SETTLE_S it was counted.
Where an interface is so busy that it goes wrong again and again, a plain socket, which the kernel filters from
its first packet on, takes its place.
"""

import ctypes
import ctypes.util
import time
from ctypes import (
    POINTER,
    Structure,
    byref,
    c_char_p,
    c_double,
    c_int,
    c_int64,
    c_size_t,
    c_uint,
    c_uint64,
    c_void_p,
)
from functools import cache
from typing import Any

from daq.cameras.camera import Setting
from daq.errors import CameraError, CameraSetupError, SettingRefused

LIBRARY = "libaravis-0.8.so.0"
STATUS_SUCCESS = 0
TIMEOUT_ERROR, NOT_CONTROLLER_ERROR = 5, 10
CHECK_ENABLED = 1
_ERROR = POINTER(c_void_p)


class GError(Structure):
    """GLib's error."""

    _fields_ = (("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p))


class GSList(Structure):
    """GLib's singly linked list."""

    _fields_ = (("data", c_void_p), ("next", c_void_p))


class AravisError(CameraError):
    """An error reported by libaravis, with its code."""

    def __init__(self, code: int, text: str) -> None:
        self.code = code
        super().__init__(text)


# name: (result, arguments); a last argument of _ERROR is filled in by `call`
PROTOTYPES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_enable_interface": (None, (c_char_p,)),
    "arv_disable_interface": (None, (c_char_p,)),
    "arv_open_device": (c_void_p, (c_char_p, _ERROR)),
    "arv_gv_device_new": (c_void_p, (c_void_p, c_void_p, _ERROR)),
    "arv_gv_device_is_controller": (c_int, (c_void_p,)),
    "arv_gv_device_auto_packet_size": (c_uint, (c_void_p, _ERROR)),
    "arv_gv_device_set_packet_size": (None, (c_void_p, c_int, _ERROR)),
    "arv_gv_device_set_stream_options": (None, (c_void_p, c_int)),
    "arv_device_set_range_check_policy": (None, (c_void_p, c_int)),
    "arv_device_set_access_check_policy": (None, (c_void_p, c_int)),
    "arv_device_get_feature": (c_void_p, (c_void_p, c_char_p)),
    "arv_device_is_feature_available": (c_int, (c_void_p, c_char_p, _ERROR)),
    "arv_device_get_integer_feature_value": (c_int64, (c_void_p, c_char_p, _ERROR)),
    "arv_device_set_integer_feature_value": (None, (c_void_p, c_char_p, c_int64, _ERROR)),
    "arv_device_get_float_feature_value": (c_double, (c_void_p, c_char_p, _ERROR)),
    "arv_device_set_float_feature_value": (None, (c_void_p, c_char_p, c_double, _ERROR)),
    "arv_device_get_boolean_feature_value": (c_int, (c_void_p, c_char_p, _ERROR)),
    "arv_device_set_boolean_feature_value": (None, (c_void_p, c_char_p, c_int, _ERROR)),
    "arv_device_get_string_feature_value": (c_char_p, (c_void_p, c_char_p, _ERROR)),
    "arv_device_set_string_feature_value": (None, (c_void_p, c_char_p, c_char_p, _ERROR)),
    "arv_device_execute_command": (None, (c_void_p, c_char_p, _ERROR)),
    "arv_device_dup_available_enumeration_feature_values_as_strings": (
        POINTER(c_char_p),
        (c_void_p, c_char_p, POINTER(c_uint), _ERROR),
    ),
    "arv_device_create_stream": (c_void_p, (c_void_p, c_void_p, c_void_p, _ERROR)),
    "arv_device_create_chunk_parser": (c_void_p, (c_void_p,)),
    "arv_chunk_parser_get_integer_value": (c_int64, (c_void_p, c_void_p, c_char_p, _ERROR)),
    "arv_chunk_parser_get_float_value": (c_double, (c_void_p, c_void_p, c_char_p, _ERROR)),
    "arv_buffer_has_chunks": (c_int, (c_void_p,)),
    "arv_gc_feature_node_is_locked": (c_int, (c_void_p, _ERROR)),
    "arv_dom_node_get_node_name": (c_char_p, (c_void_p,)),
    "arv_gc_category_get_features": (c_void_p, (c_void_p,)),
    "arv_stream_push_buffer": (None, (c_void_p, c_void_p)),
    "arv_stream_timeout_pop_buffer": (c_void_p, (c_void_p, c_uint64)),
    "arv_stream_get_statistics": (None, (c_void_p, POINTER(c_uint64), POINTER(c_uint64), POINTER(c_uint64))),
    "arv_stream_get_info_uint64_by_name": (c_uint64, (c_void_p, c_char_p)),
    "arv_buffer_new": (c_void_p, (c_size_t, c_void_p)),
    "arv_buffer_get_data": (c_void_p, (c_void_p, POINTER(c_size_t))),
    "arv_buffer_get_status": (c_int, (c_void_p,)),
    "arv_buffer_get_frame_id": (c_uint64, (c_void_p,)),
    "arv_buffer_get_timestamp": (c_uint64, (c_void_p,)),
    "arv_buffer_get_system_timestamp": (c_uint64, (c_void_p,)),
    "arv_buffer_get_image_width": (c_int, (c_void_p,)),
    "arv_buffer_get_image_height": (c_int, (c_void_p,)),
    "arv_buffer_get_image_padding": (None, (c_void_p, POINTER(c_int), POINTER(c_int))),
    "arv_buffer_get_image_pixel_format": (ctypes.c_uint32, (c_void_p,)),
    "g_inet_address_new_from_string": (c_void_p, (c_char_p,)),
    "g_object_unref": (None, (c_void_p,)),
    "g_error_free": (None, (c_void_p,)),
    "g_free": (None, (c_void_p,)),
}


@cache
def functions() -> dict[str, Any]:
    """Load the library once; CameraSetupError if it is not installed."""
    try:
        libraries = [
            ctypes.CDLL(name) for name in (LIBRARY, "libgio-2.0.so.0", "libgobject-2.0.so.0", "libglib-2.0.so.0")
        ]
        found = {}
        for name, (result, arguments) in PROTOTYPES.items():
            function = next(getattr(library, name) for library in libraries if hasattr(library, name))
            function.restype, function.argtypes = result, arguments
            found[name] = function
    except (OSError, StopIteration) as error:
        raise CameraSetupError(f"{LIBRARY} cannot be used ({error}); apt-get install libaravis-0.8-0") from error
    return found


def call(name: str, *arguments: Any) -> Any:  # noqa: ANN401 - a C function's arguments
    """Call a function; what it reports through its GError is raised as AravisError."""
    function = functions()[name]
    if PROTOTYPES[name][1][-1:] != (_ERROR,):
        return function(*arguments)
    slot = c_void_p()
    result = function(*arguments, byref(slot))
    if slot.value:
        error = ctypes.cast(slot, POINTER(GError)).contents
        code, text = error.code, (error.message or b"").decode("utf-8", "replace")
        functions()["g_error_free"](slot)
        raise AravisError(code, text)
    return result


def strings(name: str, *arguments: Any) -> list[str]:  # noqa: ANN401
    """Call a function that returns a new array of constant strings and its length."""
    count = c_uint()
    array = call(name, *arguments, byref(count))
    values = [array[index].decode("utf-8", "replace") for index in range(count.value)] if array else []
    if array:
        call("g_free", ctypes.cast(array, c_void_p))
    return values


SETTLE_S = 0.015
RAW_ATTEMPTS = 4
NO_OPTION, PLAIN_SOCKET = 0, 1  # ArvGvStreamOption


def open_stream(device: int) -> int:
    """Address of a new ArvStream of this ArvGvDevice; no buffer is in it, and no packet was."""
    for _ in range(RAW_ATTEMPTS):
        stream = int(call("arv_device_create_stream", device, None, None))
        time.sleep(SETTLE_S)
        if not call("arv_stream_get_info_uint64_by_name", stream, b"n_received_packets"):
            return stream
        call("g_object_unref", stream)
    call("arv_gv_device_set_stream_options", device, PLAIN_SOCKET)
    try:
        return int(call("arv_device_create_stream", device, None, None))
    finally:
        call("arv_gv_device_set_stream_options", device, NO_OPTION)


def open_plain_stream(device: int) -> int:
    """Address of a new ArvStream of a device that sends no packets over a network."""
    return int(call("arv_device_create_stream", device, None, None))


INTEGERS = {"Integer", "IntReg", "MaskedIntReg", "IntSwissKnife", "IntConverter"}
FLOATS = {"Float", "FloatReg", "SwissKnife", "Converter"}
TEXTS = {"String", "StringReg", "Enumeration"}
MAX_DEPTH = 20


class AravisNodes:
    """Features of one open device.

    Parameters
    ----------
    device : int
        Pointer of the ArvDevice.
    """

    def __init__(self, device: int) -> None:
        self._device = device

    def names(self) -> list[str]:
        """Every feature below Root that has a value."""
        found: list[str] = []
        self._collect("Root", found, MAX_DEPTH)
        return found

    def has(self, name: str) -> bool:
        """Return whether the feature exists and is available now."""
        if self._kind(name) is None:
            return False
        try:
            return bool(call("arv_device_is_feature_available", self._device, name.encode()))
        except AravisError:
            return False

    def get(self, name: str) -> Setting:
        """Value of a feature, read from the camera.

        Raises
        ------
        SettingRefused, AravisError
            It has no value (a command, a category), or cannot be read now.
        """
        kind, key = self._kind(name), name.encode()
        if kind in INTEGERS:
            return int(call("arv_device_get_integer_feature_value", self._device, key))
        if kind in FLOATS:
            return float(call("arv_device_get_float_feature_value", self._device, key))
        if kind == "Boolean":
            return bool(call("arv_device_get_boolean_feature_value", self._device, key))
        if kind in TEXTS:
            text = call("arv_device_get_string_feature_value", self._device, key)
            return text.decode("utf-8", "replace") if text else ""
        raise SettingRefused(f"{name} is a {kind} and has no value")

    def is_float(self, name: str) -> bool:
        """Return whether a feature is a number with a fraction."""
        return self._kind(name) in FLOATS

    def set(self, name: str, value: Setting) -> None:
        """Write a feature; SettingRefused if the camera or its description forbids it."""
        kind, key = self._kind(name), name.encode()
        try:
            if call("arv_gc_feature_node_is_locked", call("arv_device_get_feature", self._device, key)):
                raise SettingRefused(
                    f"{name} = {value!r} is refused: it is locked now"
                )  # libaravis would write it
            if kind in INTEGERS and isinstance(value, int):
                call("arv_device_set_integer_feature_value", self._device, key, value)
            elif kind in FLOATS and isinstance(value, int | float):
                call("arv_device_set_float_feature_value", self._device, key, float(value))
            elif kind == "Boolean" and isinstance(value, bool):
                call("arv_device_set_boolean_feature_value", self._device, key, int(value))
            elif kind in TEXTS and isinstance(value, str):
                call("arv_device_set_string_feature_value", self._device, key, value.encode())
            else:
                raise SettingRefused(f"{name} = {value!r} does not fit a feature of the kind {kind}")
        except (AravisError, ctypes.ArgumentError) as error:
            known = f" (one of {', '.join(self.entries(name))})" if kind == "Enumeration" else ""
            raise SettingRefused(f"{name} = {value!r} is refused{known}: {error}") from error

    def entries(self, name: str) -> list[str]:
        """Available entries of an enumeration."""
        return strings(
            "arv_device_dup_available_enumeration_feature_values_as_strings", self._device, name.encode()
        )

    def can_execute(self, name: str) -> bool:
        """Return whether the command exists and is available now."""
        return self._kind(name) == "Command" and self.has(name)

    def execute(self, name: str) -> None:
        """Execute a command."""
        call("arv_device_execute_command", self._device, name.encode())

    def _kind(self, name: str) -> str | None:
        node = call("arv_device_get_feature", self._device, name.encode())
        return call("arv_dom_node_get_node_name", node).decode() if node else None

    def _collect(self, category: str, found: list[str], depth: int) -> None:
        node = call("arv_device_get_feature", self._device, category.encode())
        item = call("arv_gc_category_get_features", node) if node and depth else None
        while item:
            entry = ctypes.cast(c_void_p(item), POINTER(GSList)).contents
            name = (ctypes.cast(entry.data, c_char_p).value or b"").decode("utf-8", "replace")
            kind = self._kind(name)
            if kind == "Category":
                self._collect(name, found, depth - 1)
            elif kind in INTEGERS | FLOATS | TEXTS | {"Boolean"} and name not in found:
                found.append(name)
            item = entry.next
