"""The few dozen functions of libaravis-0.8 that the Aravis backend needs, by ctypes.

ctypes needs no compiler, no GObject introspection and works on every Python; it also gives Python's lock away
during each call.  The library is LGPL and is loaded as the system installed it
(Debian, Ubuntu: ``apt-get install libaravis-0.8-0``).
"""

import ctypes
import ctypes.util
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

from daq.errors import CameraError, CameraSetupError

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
    """What libaravis reported, with its error code."""

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
